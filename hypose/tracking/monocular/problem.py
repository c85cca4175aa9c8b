"""Build the cost function of one search: the body's moving parts, a frame's evidence, the priors.

The prior against interpenetration puts spheres inside the body's parts and defines which of them must stay apart: limbs
from the trunk and from each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import BONE_END, Body, Mesh
from hypose.body.skeleton import Skeleton
from hypose.cameras.camera import Camera
from hypose.compute import mono
from hypose.compute.mono_terms import FloorArrays, MonoModel, MonoPriors, MonoProblem, SphereArrays
from hypose.errors import InputError
from hypose.evidence.edges_flow import Flow, edge_field
from hypose.evidence.frame import Picture
from hypose.geometry import Array
from hypose.tracking.contacts import soles_of
from hypose.tracking.monocular.evidence import edge_arrays, flow_arrays, mark_arrays, mask_arrays
from hypose.tracking.monocular.points import MonoPoints
from hypose.tracking.monocular.settings import CueSettings, MonoSettings

TOLERANCE = 0.02
"""m: two parts that overlap by this much have cost one half (at weight 1)"""
FIRM = 0.85
"""share of the sum of two radii that must stay apart: skin is soft, and spheres are rounder than limbs"""
_TRUNK = ("pelvis", "spine", "chest", "head")
_ARM, _LEG = ("elbow", "wrist"), ("hip", "knee", "ankle")


def part_spheres(body: Body, weight: float) -> SphereArrays:
    """Place spheres in the trunk, forearms, hands and legs of the body at rest, and list the pairs that must stay
    apart.

    Limb spheres lie on the bones and have the median distance of the skin as radius. Trunk spheres lie side by side and
    have half the trunk's depth as radius. Pairs: arms with trunk, with thighs and with each other; one leg with the
    other. The distance that two parts keep is at most 0.95 of that at rest.
    weight: of the prior.
    """
    names = body.skeleton.joint_names
    parts: list[str] = []
    joint: list[int] = []
    offset: list[Array] = []
    radius: list[float] = []
    for j, name in enumerate(names):
        skin = body.coarse.vertices[body.coarse.main_joint == j] - body.skeleton.rest_joints[j]
        if len(skin) < 4 or not (name in _TRUNK or name.split("_")[-1] in _ARM + _LEG):
            continue
        for centre, r in _spheres(body, name, skin):
            parts.append(name)
            joint.append(j)
            offset.append(centre)
            radius.append(r)
    at = body.skeleton.rest_joints[joint] + np.array(offset).reshape(-1, 3)
    pairs, apart = [], []
    for a in range(len(parts)):
        for b in range(a):
            if not _may_meet(parts[a], parts[b]):
                continue
            rest = float(np.linalg.norm(at[a] - at[b]))
            pairs.append((a, b))
            apart.append(min(FIRM * (radius[a] + radius[b]), 0.95 * rest))
    return SphereArrays(
        np.array(joint, dtype=np.int64),
        np.array(offset, dtype=np.float64).reshape(-1, 3),
        np.array(pairs, dtype=np.int64).reshape(-1, 2),
        np.array(apart, dtype=np.float64),
        weight / TOLERANCE**2,
    )


def _spheres(body: Body, name: str, skin: Array) -> list[tuple[Array, float]]:
    """List the spheres of one part: (centre in the joint's rest frame, radius), m; skin (V, 3) in the same frame."""
    end = BONE_END.get(name)
    if end is not None:
        s = body.skeleton
        bone = s.rest_joints[s.joint(end)] - s.rest_joints[s.joint(name)]
        along = bone / np.linalg.norm(bone)
        r = float(np.median(np.linalg.norm(skin - (skin @ along)[:, None] * along, axis=1)))
        return [(k * bone, r) for k in (0.25, 0.5, 0.75, 1.0)]
    low, high = skin.min(0), skin.max(0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if name in ("pelvis", "spine", "chest"):
        r = float(half[1])
        side = max(float(half[0]) - r, 0.0)
        return [(middle + [k * side, 0, 0], r) for k in (-1.0, 0.0, 1.0)]
    return [(middle, float(np.median(half)))]


def _may_meet(a: str, b: str) -> bool:
    """Decide whether two parts can run into each other and are not neighbours."""
    kind_a, kind_b = a.split("_")[-1], b.split("_")[-1]
    if a in _TRUNK:
        a, b, kind_a, kind_b = b, a, kind_b, kind_a
    if b in _TRUNK:
        return kind_a in _ARM
    same_side = a.split("_")[0] == b.split("_")[0]
    if kind_a in _ARM and kind_b in _ARM or kind_a in _LEG and kind_b in _LEG:
        return not same_side
    return {kind_a, kind_b} in ({"wrist", "hip"}, {"elbow", "hip"})


LONGEST_STEP = 2.0
"""longest Newton step, in units of the expected error of a prediction"""


@dataclass(frozen=True)
class Fixed:
    """Parts of the problem that do not change from frame to frame.

    model: the body in the camera.
    spheres: prior against interpenetration.
    floor: soles and the floor they stand on.
    lower, upper: (A,) joint limits; infinite where limits are off.
    spread: (A,) usual error of the prediction of each active dof.
    """

    model: MonoModel
    spheres: SphereArrays
    floor: FloorArrays
    lower: Array
    upper: Array
    spread: Array


def fixed_parts(
    body: Body,
    mesh: Mesh,
    camera: Camera,
    active: NDArray[np.int64],
    settings: MonoSettings,
    floor: float | None = None,
) -> Fixed:
    """Build the parts of the problem that do not change from frame to frame.

    active: (A,) ascending indices of the dof to estimate.
    floor: its height in the world, m; None: unknown or none.
    Raises: InputError where the active dof are not dof of the body.
    """
    s = body.skeleton
    if active.ndim != 1 or len(active) == 0 or (np.diff(active) <= 0).any() or active[0] < 0 or active[-1] >= s.dof:
        raise InputError(f"The dof to estimate must be ascending indices between 0 and {s.dof - 1}, got {active}.")
    unbounded = np.full(len(active), np.inf)
    return Fixed(
        mono.model(s.tree, mesh.arrays, s.moves, active, camera.projection),
        part_spheres(body, settings.interpenetration),
        floor_arrays(body, floor, settings.cues),
        np.array(s.lower[active]) if settings.limits else -unbounded,
        np.array(s.upper[active]) if settings.limits else unbounded,
        prediction_spread(s, settings)[active],
    )


def floor_arrays(body: Body, height: float | None, settings: CueSettings) -> FloorArrays:
    """Build the floor term: the soles of a body on a floor at a height in the world, m; None: the term is left out."""
    if height is None:
        return FloorArrays(np.zeros(0, np.int64), np.zeros((0, 3)), 0.0, 1.0, 0.0)
    soles = soles_of(body)
    return FloorArrays(soles.joint, soles.offset, float(height), float(settings.floor_sd_m), 1.0)


def prediction_spread(skeleton: Skeleton, settings: MonoSettings) -> Array:
    """Compute the usual error (D,) of a predicted pose, one standard deviation, at the settings' frame rate."""
    return settings.motion_scale * skeleton.sigma * (25.0 / settings.frame_rate)


def frame_problem(
    fixed: Fixed,
    picture: Picture,
    points: MonoPoints | None,
    field: NDArray[np.float32],
    flow: Flow | None,
    settings: MonoSettings,
) -> MonoProblem:
    """Build the problem of one frame, with the pull to the rest posture but without a prediction.

    field: (h, w, 2) edges of the picture, from `field_of`.
    points, flow: None where there are none.
    """
    edge = settings.edge
    a = len(fixed.model.active)
    posture = np.zeros(a)
    angles = fixed.model.active >= 6  # place and heading of the body have no usual value
    posture[angles] = (settings.motion_scale / (settings.posture_scale * fixed.spread[angles])) ** 2
    priors = MonoPriors(
        np.zeros((2, a)),
        np.stack([np.zeros(a), posture]),
        fixed.lower,
        fixed.upper,
        LONGEST_STEP * fixed.spread,
    )
    return MonoProblem(
        fixed.model,
        edge_arrays(field, flow, edge, use=settings.edges),
        flow_arrays(flow, settings.flow),
        mask_arrays(picture.mask, settings.cues, edge.sample_px),
        mark_arrays(points, settings.cues),
        fixed.spheres,
        fixed.floor,
        priors,
        settings.second_order,
    )


def field_of(image: NDArray[np.uint8], settings: MonoSettings) -> NDArray[np.float32]:
    """Compute the edges (h, w, 2) of a picture; all 0 where edges are not used."""
    if not settings.edges:
        return np.zeros((*image.shape[:2], 2), np.float32)
    return edge_field(image, settings.edge.smoothing_px, settings.edge.strength)


def with_prediction(problem: MonoProblem, prediction: Array, spread: Array) -> MonoProblem:
    """Add a pull to the predicted pose (D,) to the problem; spread (A,): its standard deviations."""
    centre, weight = problem.priors.centre.copy(), problem.priors.weight.copy()
    centre[0], weight[0] = prediction[problem.model.active], 1 / spread**2
    return problem._replace(priors=problem.priors._replace(centre=centre, weight=weight))
