"""Cost of a pose in one picture as a `Problem` of rows: contours, flow, a mask, key points, the floor, priors.

The prior against interpenetration puts spheres inside the body's parts and defines which of them must stay apart: limbs
from the trunk and from each other.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import BONE_END, Body, Landmarks
from hypose.cameras.camera import Camera
from hypose.compute.linear import weighted_squares
from hypose.compute.losses import lorentzian
from hypose.compute.solver import bounded_step
from hypose.errors import EvidenceError, InputError
from hypose.evidence.edges_flow import Flow, edge_field
from hypose.evidence.frame import Frame, Picture
from hypose.evidence.terms import ContourTerm, KeypointTerm, contour_term
from hypose.fitting.problem import Posed, Problem, Quadratic, Rows, Rule
from hypose.fitting.rows import rows_of_contours, rows_of_keypoints
from hypose.geometry import Array
from hypose.tracking.monocular.picture_rows import FlowTargets, edge_rows, flow_rows, flow_targets, view_of
from hypose.tracking.monocular.settings import MonoSettings
from hypose.tracking.smoothing import soles_of

SMALLEST_MASK = 50
"""px: a silhouette of fewer pixels shows no person"""
_NORMALS = 0.0
"""least cosine between the normals of the body's and the mask's outline"""
MASK_SCALE = 2.0
"""factor on the robust scale of a mask's contours: with one view poses are farther off than with several"""
TOLERANCE = 0.02
"""m: two parts that overlap by this much have cost one half (at weight 1)"""
FIRM = 0.85
"""share of the sum of two radii that must stay apart: skin is soft, and spheres are rounder than limbs"""
LONGEST_STEP = 2.0
"""longest Newton step, in units of the expected error of a prediction"""
LEAST_GAIN = 0.02
"""A descent ends when no step is expected to lower the cost by more."""
_DAMPING = Rule(1e-2, easier=6.0)
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
    (w, h), image = picture.camera.size, picture.image
    if image.shape != (h, w, 3) or image.dtype != np.uint8:
        raise InputError(
            f"Frame {frame.index}: a picture of camera {picture.camera.name} must be ({h}, {w}, 3) uint8, got "
            f"{image.shape} {image.dtype}; convert it to 8-bit BGR, resize it or use camera.scaled((width, height))."
        )
    for silhouettes in picture.silhouettes:
        mask = silhouettes.masks[0]
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


def mask_contours(picture: Picture, settings: MonoSettings) -> ContourTerm | None:
    """Build the term of the outer contour against the picture's mask; None without a mask, or where it has no outline.

    settings: settings of the cost; with mask weight 0 the term is left out.
    """
    for silhouettes in picture.silhouettes if settings.mask_weight > 0 else ():
        with contextlib.suppress(EvidenceError):  # foreground from border to border
            return contour_term(silhouettes, settings.mask_weight)
    return None


def moving_edges(field: NDArray[np.float32], flow: Flow | None, floor: float) -> NDArray[np.float32]:
    """Weight the edges (h, w, 2) of a picture by motion boundaries.

    flow: optical flow with its motion boundaries; None: the edges are not weighted.
    floor: weight of an edge where nothing moves.
    """
    if flow is None:
        return field
    share = np.full(field.shape[:2], floor, np.float32)
    (x, y), (h, w) = flow.corner, flow.boundaries.shape
    share[y : y + h, x : x + w] += np.float32(1 - floor) * flow.boundaries
    return share[..., None] * field


class Spheres(NamedTuple):
    """Spheres in the parts of the body that must not intersect.

    joint: (S,) joint of each sphere.
    offset: (S, 3) m, centre in the joint's frame.
    pairs: (P, 2) spheres of parts that can meet.
    apart: (P,) m, distance of their centres below which the prior acts.
    weight: weight of the prior, 1 / m^2.
    """

    joint: NDArray[np.int64]
    offset: Array
    pairs: NDArray[np.int64]
    apart: Array
    weight: float


def sphere_rows(at: Posed, spheres: Spheres) -> Rows:
    """Compute the residuals with derivatives (rows) of the prior against interpenetration: 1/2 weight (apart -
    distance)^2 for pairs of spheres that are too near.

    at: the posed body.
    """
    centre = at.body.skeleton.points(spheres.joint, spheres.offset, at.pose)
    away = centre[spheres.pairs[:, 0]] - centre[spheres.pairs[:, 1]]
    distance = np.linalg.norm(away, axis=1)
    near = np.flatnonzero((distance < spheres.apart) & (distance > 1e-4))
    carrier = len(at.vertices) + spheres.joint[spheres.pairs[near][:, [0, 1, 1]]]
    # the line between the centres is the direction of both, so one wrench serves them, with opposite signs
    share = np.tile([1.0, -1.0, 0.0], (len(near), 1))
    residual, slope = (distance - spheres.apart)[near], away[near] / distance[near, None]
    weight, view = np.full(len(near), spheres.weight), np.zeros(len(near), np.int64)
    cost = 0.5 * spheres.weight * float((residual**2).sum())
    return Rows(carrier, share, centre[spheres.pairs[near, 0]], slope, residual, weight, view, cost)


class Floor(NamedTuple):
    """Level floor on which the person stands.

    soles: points of the body that touch it.
    height: m, in the world.
    sd: m, usual distance of the lower sole from it.
    """

    soles: Landmarks
    height: float
    sd: float


def floor_of(body: Body, height: float | None, settings: MonoSettings) -> Floor | None:
    """Make the floor of a body at a height in the world, m; None: unknown."""
    return None if height is None else Floor(soles_of(body), float(height), settings.floor_sd_m)


def floor_rows(at: Posed, floor: Floor) -> Rows:
    """Compute the residuals with derivatives (rows) of the floor: the lowest point of the soles stands on it, and no
    point lies under it.

    at: the posed body.
    Returns: one row per point of the soles, with weight 0 for points that nothing holds. The loss is that of a key
        point, so that a jump costs little more than a step.
    """
    point = at.body.skeleton.points(floor.soles.joint, floor.soles.offset, at.pose)
    above, n = point[:, 2] - floor.height, len(point)
    on = (above < 0) | (np.arange(n) == above.argmin())
    rho, pull, _ = lorentzian((above / (2 * floor.sd)) ** 2, on / floor.sd**2)
    carrier, share = len(at.vertices) + np.repeat(floor.soles.joint[:, None], 3, 1), np.tile([1.0, 0, 0], (n, 1))
    slope, view = np.tile([0, 0, 1.0], (n, 1)), np.zeros(n, np.int64)
    return Rows(carrier, share, point, slope, above, pull, view, 2 * float((on * rho).sum()))


def part_spheres(body: Body, weight: float) -> Spheres:
    """Place spheres in the trunk, forearms, hands and legs of the body at rest, and list the pairs that must stay
    apart.

    Limb spheres lie on the bones and have the median distance of the skin as radius. Trunk spheres lie side by side and
    have half the trunk's depth as radius. Pairs: arms with trunk, with thighs and with each other; one leg with the
    other. The distance that two parts keep is at most 0.95 of that at rest.
    weight: weight of the prior.
    """
    parts: list[tuple[str, int, Array, float]] = []
    for j, name in enumerate(body.skeleton.joint_names):
        skin = body.coarse.vertices[body.coarse.main_joint == j] - body.skeleton.rest_joints[j]
        if len(skin) >= 4 and (name in _TRUNK or name.split("_")[-1] in _ARM + _LEG):
            parts += [(name, j, centre, r) for centre, r in _spheres(body, name, skin)]
    names, joint, offset, radius = zip(*parts, strict=True)
    index = np.array(joint, dtype=np.int64)
    at = body.skeleton.rest_joints[index] + np.array(offset)
    pairs = np.array([(a, b) for a in range(len(parts)) for b in range(a) if _may_meet(names[a], names[b])])
    pairs = pairs.astype(np.int64).reshape(-1, 2)
    rest = np.linalg.norm(at[pairs[:, 0]] - at[pairs[:, 1]], axis=1)
    apart = np.minimum(FIRM * np.array(radius)[pairs].sum(1), 0.95 * rest)
    return Spheres(index, np.array(offset), pairs, apart, weight / TOLERANCE**2)


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
    kinds = {a.split("_")[-1], b.split("_")[-1]}
    if kinds & {*_TRUNK}:
        return bool(kinds & {*_ARM})
    if kinds <= {*_ARM} or kinds <= {*_LEG}:
        return a.split("_")[0] != b.split("_")[0]
    return "hip" in kinds


class Fixed:
    """Parts of the problem that do not change from frame to frame.

    body: body of the person; its coarse mesh is compared with the pictures.
    camera: pinhole camera of the pictures.
    active: (A,) ascending indices of the dof to estimate.
    settings: settings of the cost.
    floor: height of the floor in the world, m; None: unknown or none.
    Attributes: those above (`floor` as a Floor), and
    moving: (V,) vertices of the coarse mesh of which the active dof carry more than half of the weight.
    moves: (V + J, A) share of each active dof's motion that each vertex of the coarse mesh, and each joint, follows.
    spheres: prior against interpenetration.
    lower, upper: (A,) joint limits.
    spread: (A,) usual error of the prediction of each active dof.
    posture: (A,) weight of the weak pull to the rest posture.
    Raises: InputError where the active dof are not dof of the body.
    """

    def __init__(
        self,
        body: Body,
        camera: Camera,
        active: NDArray[np.int64],
        settings: MonoSettings,
        floor: float | None = None,
    ) -> None:
        s = body.skeleton
        if active.ndim != 1 or len(active) == 0 or (np.diff(active) <= 0).any() or active[0] < 0 or active[-1] >= s.dof:
            raise InputError(f"The dof to estimate must be ascending indices between 0 and {s.dof - 1}, got {active}.")
        self.body, self.camera, self.active, self.settings = body, camera, active, settings
        moves = s.moves[active].T.astype(np.float64)
        weights = body.coarse.dense_weights(len(moves))
        self.moving: NDArray[np.bool_] = weights @ s.moves[active].any(0) > 0.5
        self.moves = np.concatenate([weights @ moves, moves])
        self.spheres, self.floor = part_spheres(body, settings.interpenetration), floor_of(body, floor, settings)
        self.lower, self.upper = s.lower[active], s.upper[active]
        self.spread = settings.motion_scale * s.sigma[active] * (25.0 / settings.frame_rate)
        self.posture = (settings.motion_scale / (settings.posture_scale * self.spread)) ** 2
        self.posture[active < 6] = 0.0  # place and heading of the body have no usual value


class MonoSolution(NamedTuple):
    """Pose at a minimum of the cost.

    pose: (D,) pose vector, rad and m.
    evidence: cost without flow, by which hypotheses are ranked.
    gradient: (A,) gradient of the full cost.
    hessian: (A, A) of evidence, flow and rest posture.
    counts: (3,) numbers of contour nodes that are seen, of those with an edge, and of inner nodes with flow.
    """

    pose: Array
    evidence: float
    gradient: Array
    hessian: Array
    counts: NDArray[np.int64]


class PictureEvidence(NamedTuple):
    """Evidence and priors of one hypothesis in one picture.

    fixed: parts of the problem that do not change from frame to frame.
    field: (h, w, 2) edges of the picture, weighted by motion boundaries.
    flow: optical flow from the previous picture; None: there is none.
    contours: outline of the mask, where there is one.
    points: key points or clicked joints; None: there are none.
    prediction: pull of the active dof to their prediction; None: none.
    """

    fixed: Fixed
    field: NDArray[np.float32]
    flow: Flow | None
    contours: ContourTerm | None
    points: KeypointTerm | None
    prediction: Quadratic | None = None

    def predicted(self, pose: Array) -> PictureEvidence:
        """Add a pull to a predicted pose (D,)."""
        return self._replace(prediction=Quadratic(pose[self.fixed.active], self.fixed.spread**-2))

    def targets(self, before: Array) -> FlowTargets | None:
        """Place the inner nodes of the flow on the body at its pose (D,) in the previous picture; None without flow."""
        if self.flow is None:
            return None
        body, camera = self.fixed.body, self.fixed.camera
        view = view_of(Posed(body, before, body.skin(before)), camera)
        return flow_targets(view, self.fixed.moving, self.flow, self.fixed.settings.flow)


class PictureProblem(Problem[Array, tuple[Array, Array]]):
    """Least-squares problem of one hypothesis in one picture: a pose (D,) within the limits.

    evidence: evidence and priors.
    sigma: scale of the edges, px; None: the fine one.
    targets: inner nodes; None: without flow.
    Attributes: counts, (2,) numbers of contour nodes of the last evaluation that are seen, and of those with an edge.
    Source: Sminchisescu & Triggs 2001, equation (10), and equation (11): (H + lambda W) step = -g, W the diagonal of H
        (at least 1), with an active set of limits (section 4.1). Deviations: 2D points, interpenetration and the floor
        are added to the cost; a step is cut to a trusted reach (1: LONGEST_STEP), which is smaller after steps that
        were rejected.
    """

    def __init__(
        self, evidence: PictureEvidence, sigma: float | None = None, targets: FlowTargets | None = None
    ) -> None:
        self.evidence, self.targets, self.counts = evidence, targets, (0, 0)
        self.sigma = evidence.fixed.settings.edge.sigma_px if sigma is None else sigma
        self._reach, self._length = 1.0, 1.0
        self._from: Array | None = None

    def evaluate(self, state: Array) -> tuple[float, Callable[[], tuple[Array, Array]]]:
        """Compute the cost of a pose, with Hessian (A, A) and gradient (A,) by the active dof; see `Problem`."""
        fixed, prediction = self.evidence.fixed, self.evidence.prediction
        parts, at = list(self._rows(state)), state[fixed.active]
        pulls = [Quadratic(np.zeros(len(at)), fixed.posture)]
        if prediction is not None:
            pulls.append(prediction)
        cost = sum(r.cost for r in parts) + sum(0.5 * float(p.weight @ (at - p.centre) ** 2) for p in pulls)

        def equations() -> tuple[Array, Array]:
            rows, twists = Rows.joined(parts), fixed.body.skeleton.world_twists(state)
            jacobian = rows.by_pose(twists[fixed.active], fixed.moves)
            hessian, gradient = weighted_squares(jacobian, rows.weight, rows.residual)
            for p in pulls:
                hessian[np.diag_indices(len(at))] += p.weight
                gradient += p.weight * (at - p.centre)
            return hessian, gradient

        return float(cost), equations

    def _rows(self, pose: Array) -> Iterator[Rows]:
        """Compute the rows of all evidence, spheres and floor."""
        fixed, field, _, contours, points, _ = self.evidence
        posed, settings = Posed(fixed.body, pose, fixed.body.skin(pose)), fixed.settings
        if settings.edges:
            view = view_of(posed, fixed.camera)
            rows, self.counts = edge_rows(view, fixed.moving, field, settings.edge, self.sigma)
            yield rows
        if self.targets is not None:
            yield flow_rows(posed, fixed.camera.projection, self.targets, settings.flow)
        if contours is not None:
            yield from rows_of_contours(posed, contours, MASK_SCALE, contours.weight, contours.row_spacing_px, _NORMALS)
        if points is not None:
            yield rows_of_keypoints(posed, points, points.projections)
        yield sphere_rows(posed, fixed.spheres)
        if fixed.floor is not None:
            yield floor_rows(posed, fixed.floor)

    def propose(self, state: Array, equations: tuple[Array, Array], damping: float) -> tuple[Array, float] | None:
        """Propose the next pose from a state (pose) and its normal equations.

        Returns: pose (D,), and its distance from the state as a multiple of the longest allowed step; None where no
            step is expected to lower the cost by LEAST_GAIN.
        """
        (hessian, gradient), fixed = equations, self.evidence.fixed
        rejected = state is self._from
        self._reach = 0.35 * min(self._reach, self._length) if rejected else min(1.0, 2 * self._reach)
        self._from, at = state, state[fixed.active]
        step = bounded_step(hessian, gradient, at, fixed.lower, fixed.upper, damping)
        if step is None:
            return None
        self._length = max(1e-12, float(np.abs(step / fixed.spread).max()) / LONGEST_STEP)
        step *= min(1.0, self._reach / self._length)
        if -(gradient @ step) - 0.5 * (step @ hessian @ step) < LEAST_GAIN:
            return None
        trial = state.copy()
        trial[fixed.active] = np.clip(at + step, fixed.lower, fixed.upper)
        return trial, self._length


def score(pose: Array, evidence: PictureEvidence) -> float:
    """Compute the cost by which hypotheses are ranked: all but flow, whose targets differ between hypotheses.

    pose: (D,) pose vector, rad and m.
    Source: Sminchisescu & Triggs 2001, section 3.2. Deviation: the printed cost is the edge term alone; here priors,
        interpenetration and, where given, masks, 2D points and the floor are included.
    """
    return PictureProblem(evidence).evaluate(pose)[0]


def newton_descent(
    start: Array, before: Array, evidence: PictureEvidence, coarse: int, iterations: int
) -> MonoSolution:
    """Search for the pose of least cost by damped Newton steps.

    start: (D,) pose.
    before: (D,) pose in the previous picture, from which the inner nodes of the flow come.
    evidence: evidence and priors.
    coarse, iterations: number of iterations with the coarse and with the fine scale of the edges.
    Raises: SolverError where the cost at the start is not finite.
    """
    q, fixed, targets = np.array(start), evidence.fixed, evidence.targets(before)
    edge = fixed.settings.edge
    q[fixed.active] = np.clip(q[fixed.active], fixed.lower, fixed.upper)
    if coarse:
        q = PictureProblem(evidence, edge.sigma_px * edge.coarse_factor, targets).solve(q, coarse, _DAMPING).state
    found = PictureProblem(evidence, None, targets).solve(q, iterations, _DAMPING)
    hessian, gradient = found.equations
    if evidence.prediction is not None:
        hessian = hessian - np.diag(evidence.prediction.weight)
    still = PictureProblem(evidence)
    cost = still.evaluate(found.state)[0]
    counts = np.array([*still.counts, 0 if targets is None else len(targets.target)])
    return MonoSolution(found.state, cost, gradient, hessian, counts)


def frame_evidence(
    fixed: Fixed, picture: Picture, points: KeypointTerm | None, flow: Flow | None = None
) -> PictureEvidence:
    """Build the evidence of one frame, with the pull to the rest posture but without a prediction.

    fixed: parts of the problem that do not change from frame to frame.
    picture: picture of the frame.
    points, flow: key points or clicked joints, and optical flow from the previous picture; None where there are
        none.
    """
    settings, edge = fixed.settings, fixed.settings.edge
    field = np.zeros((*picture.image.shape[:2], 2), np.float32)
    if settings.edges:
        field = edge_field(picture.image, edge.smoothing_px, edge.strength)
    moving = moving_edges(field, flow, edge.boundary_floor)
    return PictureEvidence(fixed, moving, flow, mask_contours(picture, settings), points)
