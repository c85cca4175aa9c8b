"""From clicked joints to a pose: in one view with the rivals that look the same, in several by triangulation.

The start of a track, and the correction of a frame of a tracked one (then what is not clicked stays near its pose).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.app.studio.asked import choice, number
from hypose.body.body import Body
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import InputError
from hypose.fitting.articulated import KeypointTerm, PoseFit, Quadratic, SolveSettings, fit_pose
from hypose.geometry import Array, quaternion_from_matrix
from hypose.tracking.monocular.flips import CHAINS
from hypose.tracking.monocular.initialise import rival_poses
from hypose.tracking.monocular.points import MonoPoints
from hypose.tracking.monocular.settings import body_dofs
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.starts import start_from_keypoints
from hypose.tracking.subject import scaled_to_height

CLICK_JOINTS: Mapping[str, str] = {
    "head_top": "Top of the head",
    "neck": "Base of the neck",
    "right_shoulder": "Right shoulder",
    "right_elbow": "Right elbow",
    "right_wrist": "Right wrist",
    "left_shoulder": "Left shoulder",
    "left_elbow": "Left elbow",
    "left_wrist": "Left wrist",
    "right_hip": "Right hip",
    "right_knee": "Right knee",
    "right_ankle": "Right ankle",
    "right_big_toe": "Tip of the right foot",
    "left_hip": "Left hip",
    "left_knee": "Left knee",
    "left_ankle": "Left ankle",
    "left_big_toe": "Tip of the left foot",
}
"""What can be clicked, in the order in which the page asks for it."""
LEAST = 4
_SD_OF_DIAGONAL = 0.004
"""How exactly people click, 1 sd as a share of the picture's diagonal (3.2 px at 640 x 480)."""
_OCCLUDED = 0.3
"""Weight of a joint that is guessed behind something."""
_HEIGHT_SHARE = 0.04
"""1 sd of adults' statures as a share of the mean: with one view, distance is as uncertain as the height."""
_STAY, _TRUNK_STAY, _LIMBS_STAY = 0.02, 0.07, 0.35
"""A correction leaves the root's place (m), the turns of the trunk (rad) and of the limbs (rad) as they were to these
standard deviations: who moves a wrist means the arm."""
_RIVALS = 4


@dataclass(frozen=True)
class Clicks:
    """uv (C, K, 2) px of the rig's pinhole cameras, weight (C, K), 0 = not clicked; names (K,)."""

    rig: CameraRig
    names: tuple[str, ...]
    uv: Array
    weight: Array


@dataclass(frozen=True)
class ClickFit:
    """pose (D,); covariance (J, 3, 3) m^2 of the joints; expected (C, K, 2) px; residual (C, K) px, NaN where nothing
    was clicked; depth_sd m with one view; rivals: other poses (D,) that look the same with their costs."""

    pose: Array
    covariance: Array
    expected: Array
    residual: Array
    depth_sd: float | None
    rivals: tuple[tuple[Array, float], ...]


def clicks_of(views: Any, rig: CameraRig) -> Clicks:
    """The clicks of a request (docs/studio-protocol.md), for the cameras that have any."""
    if not isinstance(views, list) or not all(isinstance(v, dict) for v in views):
        raise InputError("The clicks must be a list of views.")
    found: dict[str, dict[str, tuple[float, float, float]]] = {}
    for view in views:
        name, points = view.get("camera"), view.get("points")
        name = choice(name, "camera", rig.names)
        if not isinstance(points, list) or not all(isinstance(p, dict) for p in points):
            raise InputError(f"The clicks of {name} must be a list of points.")
        for p in points:
            joint = choice(p.get("joint"), "joint to click", tuple(CLICK_JOINTS))
            x, y = (number(p.get(k), f"{k} of the click on {joint} (px)", -1e5, 1e5) for k in ("x", "y"))
            found.setdefault(name, {})[joint] = (x, y, _OCCLUDED if p.get("occluded") else 1.0)
    cameras = [n for n in rig.names if n in found]
    if not cameras:
        raise InputError("Nothing is clicked yet.")
    names = tuple(n for n in CLICK_JOINTS if any(n in found[c] for c in cameras))
    table = np.array([[found[c].get(n, (0.0, 0.0, 0.0)) for n in names] for c in cameras])
    return Clicks(rig.select(cameras).pinhole(), names, table[..., :2], table[..., 2])


def fit_clicks(
    body: Body, clicks: Clicks, start: Array | None, known_height: bool, *, correct: bool = False
) -> ClickFit:
    """The pose of a body that explains clicks best. start (D,): solve from there only (while a joint is dragged);
    correct: and stay near it. An InputError when there are too few clicks."""
    seen = int((clicks.weight > 0).any(0).sum())
    if seen < LEAST and not correct:
        raise InputError(f"{seen} joints are clicked; click at least {LEAST}, hips and shoulders first.")
    joint, offset = _places(body, clicks.names)
    scale = _SD_OF_DIAGONAL * float(np.median(np.linalg.norm(clicks.rig.sizes, axis=1)))
    points = np.concatenate([clicks.uv, clicks.weight[..., None]], 2)
    term = KeypointTerm(points, clicks.rig.projections, joint, offset, scale, min_confidence=1e-6)
    pull = anatomical_prior(body.skeleton)
    if correct and start is not None:
        trunk = body.skeleton.dofs_of("pelvis", "spine", "neck", "left_clavicle", "right_clavicle")
        sd = np.full(body.skeleton.dof, _LIMBS_STAY)
        sd[trunk], sd[:3] = _TRUNK_STAY, _STAY
        pull = Quadratic(start, sd**-2.0)

    def solve(pose: Array) -> PoseFit:
        options = SolveSettings(iterations=40, coarse_iterations=10)
        return fit_pose(body, pose, keypoints=term, priors=(pull,), options=options)

    single = len(clicks.rig) == 1
    starts = [start] if start is not None else _starts(body, clicks, joint, offset, scale)
    fits = sorted((solve(q) for q in starts), key=lambda f: f.cost)
    best = fits[0]
    covariance = compute.joint_covariances(best.pose, body.skeleton.tree, best.information, 1e-6)
    rivals = tuple((f.pose, float(f.cost - best.cost)) for f in fits[1:]) if single and start is None else ()
    expected, residual = _residuals(body, best.pose, clicks, joint, offset)
    depth_sd = None
    if single:
        camera = clicks.rig[0]
        sight = body.joints(best.pose)[0] - camera.position
        distance = float(np.linalg.norm(sight))
        sight /= distance
        far = 0.0 if known_height or correct else _HEIGHT_SHARE * distance
        covariance = covariance + far**2 * np.outer(sight, sight)
        depth_sd = float(np.sqrt(sight @ covariance[0] @ sight))
    return ClickFit(best.pose, covariance, expected, residual, depth_sd, rivals)


def shown(body: Body, clicks: Clicks, fit: ClickFit) -> dict[str, Any]:
    """A fit as the page gets it."""
    rows, columns = np.triu_indices(3)
    clicked = np.isfinite(fit.residual)
    worst = np.unravel_index(int(np.nanargmax(fit.residual)), fit.residual.shape)
    notes = []
    if fit.depth_sd is not None:
        notes.append(f"One view: the distance from the camera is uncertain by about {100 * fit.depth_sd:.0f} cm.")
        if fit.rivals:
            notes.append("Limbs may point towards the camera or away from it; choose among the alternatives.")
    return {
        **_placed(body, fit.pose),
        "joint_sd": np.sqrt(np.trace(fit.covariance, axis1=1, axis2=2) / 3),
        "covariance": fit.covariance[:, rows, columns],
        "pixels": {
            c: {n: fit.expected[i, k] for k, n in enumerate(clicks.names)} for i, c in enumerate(clicks.rig.names)
        },
        "rms_px": float(np.sqrt((fit.residual[clicked] ** 2).mean())),
        "worst": {
            "camera": clicks.rig.names[worst[0]],
            "joint": clicks.names[worst[1]],
            "px": float(fit.residual[worst]),
        },
        "depth_sd": fit.depth_sd,
        "notes": notes,
        "alternatives": [
            {**_placed(body, q), "cost": cost, "flipped": _flipped(body, clicks, fit.pose, q)} for q, cost in fit.rivals
        ],
    }


def _placed(body: Body, pose: Array) -> dict[str, Array]:
    """A pose (D,) with its joint centres and their rotations (x y z w), as the page moves the body."""
    rotations, centres = body.skeleton.forward(pose)
    return {"pose": pose, "joints": centres, "rotations": np.roll(quaternion_from_matrix(rotations), -1, axis=-1)}


def _places(body: Body, names: Sequence[str]) -> tuple[NDArray[np.int64], Array]:
    """Where the clicked points sit: joint (K,), offset (K, 3)."""
    s, marks = body.skeleton, body.landmarks
    joint, offset = np.zeros(len(names), dtype=np.int64), np.zeros((len(names), 3))
    for k, name in enumerate(names):
        if name in s.joint_names:
            joint[k] = s.joint(name)
        else:
            at = marks.index(name)
            joint[k], offset[k] = marks.joint[at], marks.offset[at]
    return joint, offset


def _starts(body: Body, clicks: Clicks, joint: NDArray[np.int64], offset: Array, scale: float) -> list[Array]:
    if len(clicks.rig) > 1:
        world, _ = triangulate(clicks.rig, clicks.uv, clicks.weight)
        if np.isfinite(world).all(1).sum() >= 6:
            return [start_from_keypoints(body, world, joint, offset).pose]
    most = int(np.argmax((clicks.weight > 0).sum(1)))
    n = len(joint)
    points = MonoPoints(clicks.uv[most], clicks.weight[most], joint, offset, np.full(n, scale))
    return list(rival_poses(body, clicks.rig[most], points, body_dofs(body.skeleton), _RIVALS))


def _residuals(body: Body, pose: Array, clicks: Clicks, joint: NDArray[np.int64], offset: Array) -> tuple[Array, Array]:
    rotations, centres = body.skeleton.forward(pose)
    world = centres[joint] + np.einsum("kab,kb->ka", rotations[joint], offset)
    expected = np.stack([camera.project_pinhole(world) for camera in clicks.rig])
    distance = np.linalg.norm(expected - clicks.uv, axis=2)
    return expected, np.where(clicks.weight > 0, distance, np.nan)


def _flipped(body: Body, clicks: Clicks, pose: Array, other: Array) -> list[str]:
    """Joints whose segment points the other way along the line of sight in another pose."""
    s, sight = body.skeleton, clicks.rig[0].camera_from_world[2, :3]
    a, b = body.joints(pose) @ sight, body.joints(other) @ sight
    out = []
    for chain in CHAINS:
        for parent, child in zip(chain, chain[1:], strict=False):
            i, j = s.joint(parent), s.joint(child)
            if (a[j] - a[i]) * (b[j] - b[i]) < 0 and abs(a[j] - a[i] - b[j] + b[i]) > 0.1:
                out.append(child)
    return out


def sized(body: Body, height: float | None) -> Body:
    """The body at a height (m)."""
    if height is None:
        return body
    if not 0.4 <= height <= 2.8:
        raise InputError(f"A height of {height:g} m is implausible; give it in metres (0.4 to 2.8).")
    return replace(scaled_to_height(body, height), name=body.name)
