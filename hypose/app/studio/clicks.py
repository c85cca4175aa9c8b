"""Fit poses to clicked joints, for the Click screen and for corrections, and save clicks as a start of tracking.

In one view, other poses that look the same are returned too; in several views joints are triangulated. A correction of
a tracked frame keeps joints that were not clicked near the tracked pose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.app.studio.catalog import Catalog, Item
from hypose.app.studio.http import request_choice, request_number, whole
from hypose.app.studio.job_kinds import is_name, saved_clicks
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.view_bundle import ViewResult, first_frame, view_bundle
from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.motion import Motion, isotropic
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import InputError
from hypose.evidence.keypoints import landmark_of
from hypose.evidence.terms import KeypointTerm
from hypose.fitting.articulated import PoseFit, SolveSettings, fit_pose
from hypose.fitting.problem import Quadratic
from hypose.geometry import Array, quaternion_from_matrix
from hypose.io.files import read_json
from hypose.io.motions.results import load_body, load_motion, write_json
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import frame_size
from hypose.pipeline.one_camera import LEAST_CLICKS
from hypose.tracking.monocular.flips import CHAINS
from hypose.tracking.monocular.initialise import rival_poses
from hypose.tracking.monocular.settings import body_dofs
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.start_search import scaled_to_height, start_from_keypoints

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
"""Joints that can be clicked, with their titles, in the order in which the page asks for them."""
_MIN_CLICKS = 4
_FORMAT = "hypose-clicks"
_SD_OF_DIAGONAL = 0.004
"""Standard deviation of a click as a share of the picture's diagonal (3.2 px at 640 x 480)."""
_OCCLUDED = 0.3
"""Weight of a joint that is clicked where it is hidden."""
_HEIGHT_SHARE = 0.04
"""Standard deviation of adults' statures as a share of the mean: with one view, the distance is as uncertain as the
height.
"""
_STAY, _TRUNK_STAY, _LIMBS_STAY = 0.02, 0.07, 0.35
"""Standard deviations with which a correction keeps the root's place (m), and the rotations of trunk and limbs (rad).
Why: a user who moves a wrist means the arm.
"""
_RIVALS = 4
_View = Mapping[str, Any]


@dataclass(frozen=True)
class _Clicks:
    """Clicks of several cameras as arrays.

    rig: pinhole cameras.
    names: (K,) clicked joints.
    uv: (C, K, 2) px of the pinhole cameras.
    weight: (C, K), 0 = not clicked.
    joint, offset: (K,) and (K, 3) m: places of the clicked points on the body.
    """

    rig: CameraRig
    names: tuple[str, ...]
    uv: Array
    weight: Array
    joint: NDArray[np.int64]
    offset: Array

    @classmethod
    def of(cls, views: Sequence[_View], rig: CameraRig, body: Body) -> _Clicks:
        """Make the arrays from checked views, for the cameras that have clicks.

        views: result of `checked_views`.
        rig: all cameras of the recording.
        body: on which the clicked points lie.
        Raises: InputError where nothing is clicked.
        """
        found = {v["camera"]: {p["joint"]: p for p in v["points"]} for v in views if v["points"]}
        cameras = [n for n in rig.names if n in found]
        if not cameras:
            raise InputError("Nothing is clicked yet.")
        names = tuple(n for n in CLICK_JOINTS if any(n in found[c] for c in cameras))
        table = np.zeros((len(cameras), len(names), 3))
        for k, name in enumerate(names):
            for c, camera in enumerate(cameras):
                if (p := found[camera].get(name)) is not None:
                    table[c, k] = p["x"], p["y"], _OCCLUDED if p.get("occluded") else 1.0
        # key points call the base of the neck so, and the middle between the shoulders neck
        joint, offset, _ = landmark_of(["upper_neck" if n == "neck" else n for n in names], body)
        return cls(rig.select(cameras).pinhole(), names, table[..., :2], table[..., 2], joint, offset)


def checked_views(views: Any, recording: Recording) -> list[_View]:
    """Check the views of a request, and convert their points to undistorted pixels of K.

    Points clicked in the recorded picture ("recorded": true) are undistorted.
    Raises: InputError names the faulty value.
    """
    if not isinstance(views, list) or not all(isinstance(v, dict) for v in views):
        raise InputError("The clicks must be a list of views.")
    out = []
    for view in views:
        name, points = request_choice(view.get("camera"), "camera", recording.rig.names), view.get("points")
        if not isinstance(points, list) or not all(isinstance(p, dict) for p in points):
            raise InputError(f"The clicks of {name} must be a list of points.")
        joints = [request_choice(p.get("joint"), "joint to click", tuple(CLICK_JOINTS)) for p in points]
        uv = [[request_number(p.get(k), f"{k} of a click (px)", -1e5, 1e5) for k in ("x", "y")] for p in points]
        if view.get("recorded") is True and uv:
            k = recording.rig.names.index(name)
            uv = recording.rig[k].undistort_points(np.array(uv) + recording.views[k].image_shift).tolist()
        hidden = [{"occluded": p["occluded"]} if "occluded" in p else {} for p in points]
        clean = [{"joint": j, "x": x, "y": y, **h} for j, (x, y), h in zip(joints, uv, hidden, strict=True)]
        out.append({"camera": name, "points": clean})
    return out


def fit_clicks(value: Mapping[str, Any], catalog: Catalog, recordings: Recordings) -> dict[str, Any]:
    """Fit a pose to the clicks of a request, and return the answer for the page (docs/studio-protocol.md).

    value: the request: views, frame, recording or result, height, start.
    catalog, recordings: catalog and recordings of the studio.
    Raises: InputError names the value that cannot be used, or says that too few joints are clicked.
    """
    item = _recording(value, catalog)
    recording = recordings.load(item)
    views = checked_views(value.get("views"), recording)
    body, pose, known_height = _body(value, item, catalog, recording)
    start = pose
    if value.get("start") is not None:
        start = _pose(value["start"], body)
    return _fit(body, _Clicks.of(views, recording.rig, body), start, known_height, correct=pose is not None)


def _fit(body: Body, clicks: _Clicks, start: Array | None, known_height: bool, correct: bool) -> dict[str, Any]:
    """Fit a body's pose to clicks, and return it in the form of the page.

    start: (D,) solve only from here, e.g. while a joint is dragged.
    known_height: without it the distance in one view is uncertain.
    correct: also keep the pose near `start`.
    Raises: InputError where there are too few clicks.
    """
    seen = int((clicks.weight > 0).any(0).sum())
    if seen < _MIN_CLICKS and not correct:
        raise InputError(f"{seen} joints are clicked; click at least {_MIN_CLICKS}, hips and shoulders first.")
    scale = _SD_OF_DIAGONAL * float(np.median(np.linalg.norm(clicks.rig.sizes, axis=1)))
    points = np.concatenate([clicks.uv, clicks.weight[..., None]], 2)
    term = KeypointTerm(points, clicks.rig.projections, clicks.joint, clicks.offset, scale, min_confidence=1e-6)
    pull = anatomical_prior(body.skeleton)
    if correct and start is not None:
        trunk = body.skeleton.dofs_of("pelvis", "spine", "neck", "left_clavicle", "right_clavicle")
        sd = np.full(body.skeleton.dof, _LIMBS_STAY)
        sd[trunk], sd[:3] = _TRUNK_STAY, _STAY
        pull = Quadratic(start, sd**-2.0)

    def solve(pose: Array) -> PoseFit:
        options = SolveSettings(iterations=40, coarse_iterations=10)
        return fit_pose(body, pose, [term], priors=(pull,), options=options)

    starts = [start] if start is not None else _starts(body, clicks, scale)
    best, *others = sorted((solve(q) for q in starts), key=lambda f: f.cost)
    others = others if len(clicks.rig) == 1 else []
    covariance = body.skeleton.informed_joint_covariances(best.pose, best.information, 1e-6)
    rotations, centres = body.skeleton.forward(best.pose)
    world = centres[clicks.joint] + np.einsum("kab,kb->ka", rotations[clicks.joint], clicks.offset)
    expected = np.stack([camera.project_pinhole(world) for camera in clicks.rig])
    residual = np.where(clicks.weight > 0, np.linalg.norm(expected - clicks.uv, axis=2), np.nan)
    camera, joint = np.unravel_index(int(np.nanargmax(residual)), residual.shape)
    depth_sd, notes = None, []
    if len(clicks.rig) == 1:
        sight = centres[0] - clicks.rig[0].position
        far = 0.0 if known_height or correct else _HEIGHT_SHARE * float(np.linalg.norm(sight))
        sight /= np.linalg.norm(sight)
        covariance = covariance + far**2 * np.outer(sight, sight)
        depth_sd = float(np.sqrt(sight @ covariance[0] @ sight))
        notes.append(f"One view: the distance from the camera is uncertain by about {100 * depth_sd:.0f} cm.")
    if others:
        notes.append("Limbs may point towards the camera or away from it; choose among the alternatives.")
    names, cameras = clicks.names, clicks.rig.names
    return {
        **_placed(body, best.pose),
        "joint_sd": np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3),
        "covariance": covariance[:, *np.triu_indices(3)],
        "pixels": {c: dict(zip(names, expected[i], strict=True)) for i, c in enumerate(cameras)},
        "rms_px": float(np.sqrt(np.nanmean(residual**2))),
        "worst": {"camera": cameras[camera], "joint": names[joint], "px": float(residual[camera, joint])},
        "depth_sd": depth_sd,
        "notes": notes,
        "alternatives": [
            {
                **_placed(body, f.pose),
                "cost": float(f.cost - best.cost),
                "flipped": _flipped(body, clicks, best.pose, f.pose),
            }
            for f in others
        ],
    }


def _placed(body: Body, pose: Array) -> dict[str, Array]:
    """Return a pose (D,) with its joint centres and rotations (x y z w), in the form of the page."""
    rotations, centres = body.skeleton.forward(pose)
    return {"pose": pose, "joints": centres, "rotations": np.roll(quaternion_from_matrix(rotations), -1, axis=-1)}


def _starts(body: Body, clicks: _Clicks, scale: float) -> list[Array]:
    """Find poses from which the fit begins: one by triangulation where at least 6 joints are clicked in several views,
    else the poses that look the same in the view with most clicks.

    body: that is fitted.
    clicks: to which it is fitted.
    scale: standard deviation of a click, px.
    Returns: poses, each (D,).
    """
    if len(clicks.rig) > 1:
        world, _ = triangulate(clicks.rig, clicks.uv, clicks.weight)
        if np.isfinite(world).all(1).sum() >= 6:
            return [start_from_keypoints(body, world, clicks.joint, clicks.offset).pose]
    most = int(np.argmax((clicks.weight > 0).sum(1)))
    seen = np.column_stack([clicks.uv[most], clicks.weight[most]])[None]
    points = KeypointTerm(seen, clicks.rig.projections[[most]], clicks.joint, clicks.offset, scale, 0.0)
    found = rival_poses(body, clicks.rig[most], points, body_dofs(body.skeleton), _RIVALS)
    return list(found)


def _flipped(body: Body, clicks: _Clicks, pose: Array, other: Array) -> list[str]:
    """List the joints whose segment points the other way along the line of sight in another pose.

    body: body of both poses.
    clicks: their first camera gives the line of sight.
    pose, other: (D,).
    Returns: names of the lower joint of each such segment of arms and legs.
    """
    s, sight = body.skeleton, clicks.rig[0].camera_from_world[2, :3]
    a, b = body.joints(pose) @ sight, body.joints(other) @ sight
    out = []
    for parent, child in (pair for chain in CHAINS for pair in pairwise(chain)):
        i, j = s.joint(parent), s.joint(child)
        if (a[j] - a[i]) * (b[j] - b[i]) < 0 and abs(a[j] - a[i] - b[j] + b[i]) > 0.1:
            out.append(child)
    return out


def body_block(asked: dict[str, str], catalog: Catalog, recordings: Recordings) -> bytearray:
    """Build the block (`view_bundle`) of the body that clicks are fitted with, one frame at rest.

    asked: query of the page: recording or result, height.
    catalog, recordings: catalog and recordings of the studio.
    Raises: InputError where the height is no number from 0.4 to 2.8 m.
    """
    item = _recording(asked, catalog)
    try:
        height = float(asked["height"]) if "height" in asked else None
    except ValueError:
        raise InputError("The height must be a number of metres.") from None
    body = _body({**asked, "frame": 0, "height": height}, item, catalog, recordings.load(item))[0]
    rest = np.zeros((1, body.skeleton.dof))
    one, unknown = np.zeros(1, dtype=bool), np.full(1, np.nan)
    around = isotropic(np.full((1, len(body.skeleton.joint_names)), np.nan))
    motion = Motion(body.skeleton, np.zeros(1), body.joints(rest), rest, around, one, one, np.zeros(1, int), unknown)
    return view_bundle(ViewResult(item.path.name, motion, body))


def _recording(value: Mapping[str, Any], catalog: Catalog) -> Item:
    """Return the recording that a request names by its id, or by the id of a result in its folder.

    value: the request.
    Raises: InputError where it names neither.
    """
    if value.get("recording") is not None:
        return catalog.find("recording", value["recording"])
    folder = catalog.recording_of(catalog.find("result", value.get("result")).path)
    if folder is None:
        raise InputError("The result is in no recording's folder, so there are no pictures to click in.")
    return catalog.find("recording", catalog.id_of("recording", folder))


def _body(
    value: Mapping[str, Any], item: Item, catalog: Catalog, recording: Recording
) -> tuple[Body, Array | None, bool]:
    """Choose the body for a request: that of the result, as measured in the recording, or the template.

    value: the request: frame, and result or height (m).
    item, recording: recording of the clicks.
    Returns: the body; the pose (D,) that is corrected, or None; whether the height is known.
    """
    frame = whole(value.get("frame"), "the frame in which the joints were clicked", 0, 10**9)
    measured = item.path / "subject" / "body.npz"
    height = value.get("height")
    if height is not None:
        height = request_number(height, "the height (m)", 0.4, 2.8)
    if isinstance(value.get("result"), str):
        folder = catalog.find("result", value["result"]).path
        changed = (folder / "motion.npz").stat().st_mtime_ns if (folder / "motion.npz").is_file() else 0
        return *_corrected(folder, changed, frame), True
    if measured.is_file():
        return load_body(measured), None, True
    height, body = height or recording.subject_height, human()
    return body if height is None else replace(scaled_to_height(body, height), name=body.name), None, height is not None


@lru_cache(maxsize=4)
def _corrected(folder: Path, changed: int, frame: int) -> tuple[Body, Array | None]:
    """Load a result's body, and its pose in a frame of the recording; None without one. Cached, since it is needed
    repeatedly while a joint is dragged.

    changed: time of the file's last change.
    """
    motion, body = load_motion(folder / "motion.npz"), load_body(folder / "body.npz")
    row = frame - first_frame(motion)
    if motion.poses is None or not 0 <= row < len(motion) or not np.isfinite(motion.poses[row]).all():
        return body, None
    return body, motion.poses[row].copy()


def _pose(value: Any, body: Body) -> Array:
    """Return a pose (D,) of a request, within the limits of the joints; InputError where it is not D numbers."""
    if not isinstance(value, list) or len(value) != body.skeleton.dof:
        raise InputError(f"A pose has {body.skeleton.dof} numbers.")
    return body.skeleton.clamp(np.array([request_number(v, "a number of the pose", -1e6, 1e6) for v in value]))


def save(value: dict[str, Any], item: Item, catalog: Catalog, recordings: Recordings) -> dict[str, Any]:
    """Fit a pose to the clicks of a request, and save clicks and pose in starts/NAME.json of the recording.

    value: the request as for `fit_clicks`, with name, camera, since and until.
    item: the recording.
    catalog, recordings: items and open recordings of the studio.
    Returns: the saved document.
    Raises: InputError where a value cannot be used.
    """
    name, starts = value.get("name") or f"frame-{value.get('frame')}", item.path / "starts"
    if not isinstance(name, str) or not is_name(name):
        raise InputError("Give the start a name of letters, digits, - and _.")
    if not catalog.contains(starts):
        raise InputError(f"The starts of {item.path.name} lie outside the served folder.")
    if isinstance(
        value.get("result"), str
    ):  # a correction never replaces an older one, since a result may have been tracked from that
        numbers = ("", *(f"-{n}" for n in range(2, 10_000)))
        name = next(f"{name}{n}" for n in numbers if not (starts / f"{name}{n}.json").exists())
    recording = recordings.load(item)
    value = {**value, "recording": item.id, "views": checked_views(value.get("views"), recording)}
    found = fit_clicks(value, catalog, recordings)
    keep = {k: value[k] for k in ("frame", "views", "height", "result") if value.get(k) is not None}
    keep |= {k: whole(value[k], f"the frame {k}", 0, 10**9) for k in ("since", "until") if value.get(k) is not None}
    keep |= _for_one_camera(value["views"], value.get("camera"), recording)
    document = {"format": _FORMAT, "version": 1, **keep, **{k: found[k] for k in ("pose", "joint_sd", "rms_px")}}
    write_json(starts / f"{name}.json", document)
    return {"name": name, **document}


def _for_one_camera(views: Sequence[Mapping[str, Any]], wanted: Any, recording: Recording) -> dict[str, Any]:
    """Convert clicks to the form that `hypose track --recipe monocular --start FILE` reads
    (hypose.pipeline.one_camera).

    views: checked views.
    wanted: name of a camera, which is used where enough is clicked there; else the camera with most clicks.
    recording: recording of the clicks.
    Returns: camera, and joints: pixels of the recorded picture by joint name. Hidden joints are used only where there
        are too few others; joints is empty where the view has no pictures.
    """
    view = max(views, key=lambda v: (v["camera"] == wanted and len(v["points"]) >= LEAST_CLICKS, len(v["points"])))
    index = recording.rig.names.index(view["camera"])
    camera, source = recording.rig[index], recording.views[index]
    points = [p for p in view["points"] if p["joint"] in JOINT_NAMES]
    clear = [p for p in points if not p.get("occluded")]
    points = clear if len(clear) >= LEAST_CLICKS else points
    if not points or source.source is None:
        return {"camera": source.name, "joints": {}}
    origin, rays = camera.pinhole().rays(np.array([[p["x"], p["y"]] for p in points], dtype=np.float64))
    seen = camera.project(origin + rays) - np.asarray(source.image_shift)
    stored = (seen + 0.5) * np.array(frame_size(source.source)) / np.array(camera.size) - 0.5
    return {"camera": source.name, "joints": {p["joint"]: stored[k] for k, p in enumerate(points)}}


def read_clicks(item: Item, name: str) -> dict[str, Any]:
    """Load saved clicks by their name.

    Raises: InputError where the name or the file is not valid.
    """
    value = read_json(saved_clicks(item.path, name), "a start")
    if not isinstance(value, dict) or value.get("format") != _FORMAT:
        raise InputError(f"The start {name} was not written by hypose.")
    return value
