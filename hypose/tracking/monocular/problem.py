"""Build the cost function of one search (the body's moving parts, a frame's evidence, the priors), and minimise it.

The prior against interpenetration puts spheres inside the body's parts and defines which of them must stay apart: limbs
from the trunk and from each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import BONE_END, Body, Mesh
from hypose.body.skeleton import Skeleton
from hypose.cameras.camera import Camera
from hypose.compute import mono
from hypose.compute.arrays import plain
from hypose.compute.mask_distance import signed_distance
from hypose.compute.mono_terms import (
    EdgeArrays,
    FloorArrays,
    FlowArrays,
    MarkArrays,
    MaskArrays,
    MonoModel,
    MonoPriors,
    MonoProblem,
    MonoWorkspace,
    SphereArrays,
)
from hypose.compute.rows import outline_points
from hypose.compute.solver import bounded_step
from hypose.errors import EvidenceError, InputError
from hypose.evidence.edges_flow import Flow, edge_field
from hypose.evidence.frame import Frame, Picture
from hypose.fitting.problem import Problem, Rule
from hypose.geometry import Array
from hypose.tracking.contacts import soles_of
from hypose.tracking.monocular.points import MonoPoints
from hypose.tracking.monocular.settings import CueSettings, EdgeSettings, FlowSettings, MonoSettings

SMALLEST_MASK = 50
"""px: a silhouette of fewer pixels shows no person"""
OUTLINE = 130
"""number of points sampled on a silhouette's outline"""
TOLERANCE = 0.02
"""m: two parts that overlap by this much have cost one half (at weight 1)"""
FIRM = 0.85
"""share of the sum of two radii that must stay apart: skin is soft, and spheres are rounder than limbs"""
_TRUNK = ("pelvis", "spine", "chest", "head")
_ARM, _LEG = ("elbow", "wrist"), ("hip", "knee", "ankle")


def checked_picture(frame: Frame) -> Picture:
    """Check and return the picture of a frame.

    Raises: InputError where the frame has no picture, or where picture or mask do not have the camera's size;
        EvidenceError where the mask is empty. Both name the frame.
    """
    picture = frame.picture
    if picture is None:
        raise InputError(f"Frame {frame.index} has no picture, which tracking with one camera needs; give its video.")
    (w, h), image, mask = picture.camera.size, picture.image, picture.mask
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            f"Frame {frame.index}: a picture must be (h, w, 3) uint8, got {image.shape} {image.dtype}; convert it to "
            "8-bit BGR."
        )
    if image.shape[:2] != (h, w):
        raise InputError(
            f"Frame {frame.index} is {image.shape[1]} x {image.shape[0]} px, camera {picture.camera.name} {w} x {h}; "
            "resize the picture or use camera.scaled((width, height))."
        )
    if mask is not None:
        if mask.shape != (h, w):
            raise InputError(
                f"Frame {frame.index}: the mask is {mask.shape[1]} x {mask.shape[0]} px, the picture {w} x {h}; resize "
                "the mask."
            )
        if np.count_nonzero(mask) < SMALLEST_MASK:
            raise EvidenceError(
                f"Frame {frame.index}: the mask is empty; leave the mask out of this frame (mask=None)."
            )
    return picture


def grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert a BGR image (h, w, 3) to grey values (h, w)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def edge_arrays(field: NDArray[np.float32], flow: Flow | None, settings: EdgeSettings, *, use: bool) -> EdgeArrays:
    """Build the arrays of the edge term.

    field: (h, w, 2) edges of a picture, from `edge_field`.
    flow: optical flow, whose motion boundaries weight the edges; None: no weighting.
    settings: of the term.
    use: False leaves the term out.
    """
    if settings.motion_boundaries and flow is not None:
        share = np.full(field.shape[:2], settings.boundary_floor, np.float32)
        (x, y), (h, w) = flow.corner, flow.boundaries.shape
        share[y : y + h, x : x + w] += np.float32(1 - settings.boundary_floor) * flow.boundaries
        field = share[..., None] * field
    return EdgeArrays(field, use, settings)


def flow_arrays(flow: Flow | None, settings: FlowSettings) -> FlowArrays:
    """Build the arrays of the flow term; without flow (None) the term has no nodes."""
    if flow is None or not settings.use:
        none = np.zeros((0, 0), np.float32)
        flow = Flow(np.zeros((0, 0, 2), np.float32), none, none, (0, 0))
    return FlowArrays(flow.flow, flow.error, np.array(flow.corner, dtype=np.int64), settings)


def mask_arrays(mask: NDArray[np.uint8] | None, settings: CueSettings, sample_px: float) -> MaskArrays:
    """Build the arrays of the silhouette term; without a mask, or with height 0, the term is left out.

    mask: (h, w), not 0 on the person.
    settings: of the cues.
    sample_px: px of contour per independent sample.
    """
    if mask is None or settings.silhouette_height <= 0:
        return MaskArrays(np.zeros((0, 0), np.float32), np.zeros((0, 2), np.float32), 0.0, sample_px)
    h, w = mask.shape
    distance = signed_distance((mask != 0).astype(np.uint8)[None], np.array([[w, h]]))[0]
    outline, found = outline_points(distance, (w, h), OUTLINE)
    return MaskArrays(np.ascontiguousarray(distance), outline if found else outline[:0], found / OUTLINE, sample_px)


def mark_arrays(points: MonoPoints | None, settings: CueSettings) -> MarkArrays:
    """Build the arrays of the term of 2D points; without points, or with weight 0, the term is left out."""
    if points is None or settings.point_weight <= 0:
        none = np.zeros(0)
        return MarkArrays(np.zeros((0, 2)), none, np.zeros(0, np.int64), np.zeros((0, 3)), none)
    seen = np.asarray(points.confidence) > 0
    return MarkArrays(
        plain(points.pixels[seen], np.float64),
        plain(points.confidence[seen], np.float64) * settings.point_weight,
        plain(points.joint[seen], np.int64),
        plain(points.offset[seen], np.float64),
        plain(points.scale_px[seen], np.float64),
    )


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
    """List the spheres of one part: (centre in the joint's rest frame, radius), m; skin (V, 3) in the same frame.

    body: at rest.
    name: joint of the part.
    """
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

    body, mesh: the body, and its mesh that is compared.
    camera: of the pictures.
    settings: of the cost.
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

    fixed: parts of the problem that stay.
    picture: of the frame.
    settings: of the cost.
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
        settings.cues,
        priors,
        settings.second_order,
    )


def field_of(image: NDArray[np.uint8], settings: MonoSettings) -> NDArray[np.float32]:
    """Compute the edges (h, w, 2) of a picture; all 0 where edges are not used.

    image: (h, w, 3) BGR.
    settings: of the cost.
    """
    if not settings.edges:
        return np.zeros((*image.shape[:2], 2), np.float32)
    return edge_field(image, settings.edge.smoothing_px, settings.edge.strength)


def with_prediction(problem: MonoProblem, prediction: Array, spread: Array) -> MonoProblem:
    """Add a pull to the predicted pose (D,) to the problem; spread (A,): its standard deviations."""
    centre, weight = problem.priors.centre.copy(), problem.priors.weight.copy()
    centre[0], weight[0] = prediction[problem.model.active], 1 / spread**2
    return problem._replace(priors=problem.priors._replace(centre=centre, weight=weight))


class MonoSolution(NamedTuple):
    """Pose at a minimum of the cost.

    pose: (D,).
    evidence: cost without flow, by which hypotheses are ranked.
    gradient: (A,) of the full cost.
    hessian: (A, A) of evidence, flow and rest posture.
    counts: (7,) numbers of nodes, as in MonoWorkspace.
    """

    pose: Array
    evidence: float
    gradient: Array
    hessian: Array
    counts: NDArray[np.int64]


class PictureProblem(Problem[Array, tuple[Array, Array]]):
    """Least-squares problem of one hypothesis in one picture: a pose (D,) within the limits.

    problem: evidence and priors.
    ws: scratch memory, prepared by `mono.prepare_terms`.
    sigma: scale of the edges, px.
    n_flow: number of inner nodes.
    Source: Sminchisescu & Triggs 2001, equation (11): (H + lambda W) step = -g, W the diagonal of H (at least 1), with
        an active set of limits (section 4.1). Deviation: a step is cut to a trusted reach (1: priors.longest), which is
        smaller after steps that were rejected.
    """

    def __init__(self, problem: MonoProblem, ws: MonoWorkspace, sigma: float, n_flow: int) -> None:
        self._problem, self._ws, self._scale = problem, ws, (sigma, n_flow)
        self._reach, self._length = 1.0, 1.0
        self._from: Array | None = None

    def evaluate(self, state: Array) -> tuple[float, Callable[[], tuple[Array, Array]]]:
        """Compute the cost of a pose, with Hessian (A, A) and gradient (A,); see `Problem`."""
        a = len(self._problem.model.active)
        hessian, gradient = np.empty((a, a)), np.empty(a)
        cost = mono.full_cost(state, self._problem, *self._scale, self._ws, hessian, gradient)
        return float(cost), lambda: (hessian, gradient)

    def propose(self, state: Array, equations: tuple[Array, Array], damping: float) -> tuple[Array, float] | None:
        """Propose the next pose, and its distance in longest steps; None: no step is expected to lower the cost by
        LEAST_GAIN.
        """
        (hessian, gradient), priors, active = equations, self._problem.priors, self._problem.model.active
        rejected = state is self._from
        self._reach = 0.35 * min(self._reach, self._length) if rejected else min(1.0, 2 * self._reach)
        self._from, at = state, state[active]
        step = bounded_step(hessian, gradient, at, priors.lower, priors.upper, damping)
        if step is None:
            return None
        self._length = max(1e-12, float(np.abs(step / priors.longest).max()))
        step *= min(1.0, self._reach / self._length)
        if -(gradient @ step) - 0.5 * (step @ hessian @ step) < LEAST_GAIN:
            return None
        trial = state.copy()
        trial[active] = np.clip(at + step, priors.lower, priors.upper)
        return trial, self._length


def newton_descent(
    start: Array, before: Array, problem: MonoProblem, coarse: int, iterations: int, ws: MonoWorkspace
) -> MonoSolution:
    """Search for the pose of least cost by damped Newton steps.

    start: (D,) pose.
    before: (D,) pose in the previous picture, from which the inner nodes of the flow come.
    problem: evidence and priors.
    coarse, iterations: number of iterations with the coarse and with the fine scale of the edges.
    ws: scratch memory.
    Raises: SolverError where the cost at the start is not finite.
    """
    q, edge, priors, active = np.array(start), problem.edges.settings, problem.priors, problem.model.active
    q[active] = np.clip(q[active], priors.lower, priors.upper)
    n_flow = mono.prepare_terms(plain(before, np.float64), q, problem, ws)
    if coarse:
        wide = edge.sigma_px * edge.coarse_factor
        q = PictureProblem(problem, ws, wide, n_flow).solve(q, coarse, _DAMPING).state
    found = PictureProblem(problem, ws, edge.sigma_px, n_flow).solve(q, iterations, _DAMPING)
    hessian, gradient = found.equations
    evidence, counts = float(mono.score(found.state[None], problem, ws)[0]), ws.counts.copy()
    counts[5] = n_flow
    return MonoSolution(found.state, evidence, gradient, hessian - np.diag(priors.weight[0]), counts)


LEAST_GAIN = 0.02
"""A descent ends when no step is expected to lower the cost by more."""
_DAMPING = Rule(1e-2, easier=6.0)
