"""Fitting a pose to contours, key points and 3D points: bounded damped Gauss-Newton on robust rows.

Every cue is a sum of rows (point, direction, residual, weight, joint); rows become 6 x 6 sums per joint that are folded
up the joint tree (hypose.compute.rows, hypose.compute.solver), so a whole solve is one compiled call without the GIL.
The cost is F(q) = 1/2 sum of weighted robust squares + 1/2 sum of the priors' quadratics; gradient and (Gauss-Newton)
Hessian of the result are those of F. With weights that are inverse variances its inverse is the pose's covariance.

Sources: two-way contour distances with a robust weight as in the silhouette trackers of Alcoverro 2014, chapter 4, and
Gall et al. 2009; Geman & McClure 1985; the spatial (wrench) form of the sums follows Featherstone 2008, chapter 6.
Deviation: outline association is by nearest point of the visible outline, not along normals.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose import compute
from hypose.body.body import Body
from hypose.compute import (
    ContourArrays,
    KeypointArrays,
    PointArrays,
    PriorArrays,
    SolveLimits,
    Workspace,
    over_chunks,
)
from hypose.errors import EvidenceError, InputError, SolverError
from hypose.evidence.ahead import outlines
from hypose.evidence.frame import Silhouettes
from hypose.evidence.outlines import OUTLINE_POINTS as REFERENCE_OUTLINE
from hypose.evidence.outlines import SMALLEST, shrunk_projection
from hypose.fitting.depth_surface import DepthTerm, depth_arrays
from hypose.fitting.own_rows import FrameProblem, RowTerm, row_sums
from hypose.fitting.problem import Quadratic, Rule
from hypose.geometry import Array, nearest_branch, so3_turns

# Reference density of the contour rows, for a person `height` px tall: weights are per arc length, so changing the
# spacing or the number of points does not change the balance with key points and priors.
SPACING_OF_HEIGHT = 6 / 260
SCALE_OF_HEIGHT = 2.5 / 260


@dataclass(frozen=True)
class ContourTerm:
    """Silhouette contours of one frame, both ways (body outline -> mask, mask outline -> body). Built by
    `contour_term`.

    sdf (C, h, w) float32 signed distance px, negative inside; outline (C, K, 2) float32 px points on the mask's edge;
    usable (C,); sizes (C, 2) width, height; projections (C, 3, 4) pinhole; weight: of one row at the reference density
    (rows 6 px apart on a person 260 px tall, 130 outline points a view); scale_px, coarse_scale_px: Geman-McClure scale
    of the distance; row_spacing_px: distance of the forward rows along the body's outline; outline_count: K (at most
    1000); height_px: apparent height of the person (median over the usable views); shrunk (C,): sdf, outline, sizes and
    projections are in pixels that are so many times as large as those of all other lengths here; corners
    (C, 2), sdf_sizes (C, 2): the part of each image that its sdf covers; outside it rows cost what they
    cost at infinite distance."""

    sdf: NDArray[np.float32]
    outline: NDArray[np.float32]
    usable: NDArray[np.bool_]
    sizes: NDArray[np.int64]
    projections: Array
    weight: float
    scale_px: float
    coarse_scale_px: float
    row_spacing_px: float
    outline_count: int
    height_px: float
    shrunk: Array
    corners: NDArray[np.int64]
    sdf_sizes: NDArray[np.int64]

    @cached_property
    def arrays(self) -> ContourArrays:
        """What the solver takes, made once for all solves of a frame."""
        return contour_arrays(self)


@dataclass(frozen=True)
class KeypointTerm:
    """2D key points of one frame. Cauchy (Lorentzian) cost with scale 2 sd: 2 w log(1 + (r / 2 sd)^2).

    points (C, K, 3) = u, v px, confidence (the row's weight; rows below min_confidence or not finite are left out);
    projections (C, 3, 4) pinhole of these pixels; joint (K,), offset (K, 3) m in the joint's frame: where the key point
    sits on the body; scale_px: 1 sd."""

    points: Array
    projections: Array
    joint: NDArray[np.int64]
    offset: Array
    scale_px: float
    min_confidence: float = 0.3


@dataclass(frozen=True)
class PointTerm:
    """3D points of one frame. Cauchy (Lorentzian) cost with scale 2 sd, as for key points.

    points_world (M, 3) m, NaN where missing; weight (M,); joint (M,), offset (M, 3) m in the joint's frame; scale_m: 1
    sd."""

    points_world: Array
    weight: Array
    joint: NDArray[np.int64]
    offset: Array
    scale_m: float

    def __post_init__(self) -> None:
        m = len(self.points_world)
        shapes = (self.points_world.shape, np.shape(self.weight), np.shape(self.joint), np.shape(self.offset))
        if shapes != ((m, 3), (m,), (m,), (m, 3)) or not self.scale_m > 0:
            raise InputError(
                f"PointTerm needs points_world (M, 3), weight (M,), joint (M,), offset (M, 3) and "
                f"scale_m > 0, got {shapes} and {self.scale_m}."
            )


@dataclass(frozen=True)
class SolveSettings:
    """iterations: all, the first coarse_iterations of them with the contours' coarse scale; tolerance: stop when no dof
    moves further than this (rad; twice the metres); damping: initial, relative to the Hessian's diagonal;
    tries: of a step, each with more damping, before the solve ends there (a coarse one: goes on with the fine ones)."""

    iterations: int = 8
    coarse_iterations: int = 4
    tolerance: float = 1e-3
    damping: float = 1e-2
    tries: int = 4


@dataclass(frozen=True)
class PoseFit:
    """Result of one solve.

    pose (D,), the root's rotation vector on the branch of the start; solved (D,): the same pose on the branch on which
    it was solved; cost F; hessian (D, D), Gauss-Newton, and gradient (D,) of F in the coordinates of `solved`;
    iterations; evaluations; converged: the last step was below the tolerance; rows: number of rows of evidence (0: only
    the priors spoke); view_rows (C, 2): contour rows of each view, forward and reverse."""

    pose: Array
    solved: Array
    cost: float
    hessian: Array
    gradient: Array
    iterations: int
    evaluations: int
    converged: bool
    rows: int
    view_rows: NDArray[np.int64]

    @cached_property
    def information(self) -> Array:
        """(D, D) the Hessian by the pose's coordinates, the root's rotation as a small turn in the world: the same for
        every branch of its rotation vector."""
        return by_turns(self.hessian, self.solved)


def by_turns(hessian: Array, pose: Array) -> Array:
    """(D, D): a Hessian taken at a pose (D,) by its coordinates, with the root's rotation vector replaced by a small
    turn in the world. An inverse covariance of poses is kept like this: rotation vectors of one rotation have two
    branches, a turn has none."""
    turns, out = so3_turns(pose[3:6]), hessian.copy()
    out[3:6] = turns.T @ out[3:6]
    out[:, 3:6] = out[:, 3:6] @ turns
    return out


def contour_term(
    silhouettes: Silhouettes,
    weight: float = 0.05,
    *,
    outline_count: int = REFERENCE_OUTLINE,
    working_height: int | None = None,
) -> ContourTerm:
    """The contour evidence of a frame's masks.

    weight: of one row at the reference density. The Geman-McClure scale is 2.5 px for a person 260 px tall, in
    proportion (10 px in a 1080p image), in the first iterations twice that.
    working_height px: for tracking; views in which the person is 1.5 times as tall are worked on in shrunk pixels,
    and distances are made around the person only. Views that are not usable, or whose mask has no outline away from the
    image border, are left out; an EvidenceError when none is left."""
    made = outlines(silhouettes, outline_count, working_height)
    sizes = (silhouettes.rig.sizes // made.shrunk[:, None]).astype(np.int64)
    projections = np.stack(
        [shrunk_projection(p, f) for p, f in zip(silhouettes.rig.projections, made.shrunk, strict=True)]
    )
    usable = np.array(silhouettes.usable, dtype=np.bool_) & (made.extent > SMALLEST) & (made.found >= 20)
    if not usable.any():
        reasons = "; ".join(
            f"{n}: {r or 'no outline'}" for n, r in zip(silhouettes.rig.names, silhouettes.reasons, strict=True)
        )
        raise EvidenceError(f"No view has a usable silhouette ({reasons}); leave the contours out of this frame.")
    height = _median(made.extent[usable])
    scale = max(SCALE_OF_HEIGHT * height, 0.5)
    return ContourTerm(
        made.distance,
        made.points,
        usable,
        sizes,
        projections,
        weight,
        scale,
        2.0 * scale,
        max(SPACING_OF_HEIGHT * height, 1.0),
        outline_count,
        height,
        made.shrunk,
        made.corners,
        made.sizes,
    )


def _median(values: NDArray[np.int64]) -> float:
    """Of a few numbers, for which numpy's takes longer than a limb's kinematics."""
    v = sorted(values.tolist())
    return 0.5 * (v[(len(v) - 1) // 2] + v[len(v) // 2])


def workspace_for(body: Body, contours: ContourTerm | None = None) -> Workspace:
    """Scratch memory for fits of this body to images of this size. Not shared between threads."""
    w, h = (2, 2) if contours is None else contours.sizes.max(0)
    return compute.workspace(body.skeleton.tree, body.coarse.arrays, h, w)


def fit_pose(
    body: Body,
    start: ArrayLike,
    *,
    contours: ContourTerm | None = None,
    keypoints: KeypointTerm | None = None,
    points: PointTerm | None = None,
    priors: Sequence[Quadratic] = (),
    options: SolveSettings | None = None,
    rows: Sequence[RowTerm] = (),
    depth: DepthTerm | None = None,
) -> PoseFit:
    """The pose near start (D,) that explains the evidence best, inside the joint limits. rows: of one's own; they cost
    a call of Python for every evaluation.

    A SolverError when the start has the wrong size or its cost is not finite. A step is taken when its cost is finite
    and at most 0.2 % higher (contour costs jump when the outline changes); no joint turns more than 0.35 rad per
    step."""
    problem = _Problem(body, contours, keypoints, points, priors, options or SolveSettings(), rows, depth)
    return problem.fit(start)


def fit_poses(
    body: Body,
    starts: ArrayLike,
    *,
    contours: ContourTerm | None = None,
    keypoints: KeypointTerm | None = None,
    points: PointTerm | None = None,
    priors: Sequence[Quadratic] = (),
    options: SolveSettings | None = None,
    rows: Sequence[RowTerm] = (),
    depth: DepthTerm | None = None,
) -> list[PoseFit]:
    """Independent solves from starts (N, D) on the same evidence, over threads; the same results for any number of
    them."""
    q = np.asarray(starts, dtype=np.float64)
    problem = _Problem(body, contours, keypoints, points, priors, options or SolveSettings(), rows, depth)
    fits: list[PoseFit | None] = [None] * len(q)

    def work(first: int, last: int) -> None:
        for n in range(first, last):
            fits[n] = problem.fit(q[n])

    over_chunks(work, len(q), None)
    return [f for f in fits if f is not None]


_OWN = threading.local()


def _own_workspace(body: Body, contours: ContourTerm | None) -> Workspace:
    """This thread's scratch memory: made anew, touching its pages takes as long as two evaluations."""
    known: Workspace | None = getattr(_OWN, "workspace", None)
    if known is None or not _fits(known, body, contours):
        known = _OWN.workspace = workspace_for(body, contours)
    return known


class _Problem:
    """Evidence and priors as the flat arrays of the kernel, made once for any number of starts."""

    def __init__(
        self,
        body: Body,
        contours: ContourTerm | None,
        keypoints: KeypointTerm | None,
        points: PointTerm | None,
        priors: Sequence[Quadratic],
        options: SolveSettings,
        rows: Sequence[RowTerm] = (),
        depth: DepthTerm | None = None,
    ) -> None:
        self.body, self.contour_term, self.rows = body, contours, tuple(rows)
        for term in self.rows:
            _joints(term.joint, len(body.skeleton.tree.parents), "RowTerm")
        self.tree, self.mesh = body.skeleton.tree, body.coarse.arrays
        self.contours = contour_arrays(None) if contours is None else contours.arrays
        self.keypoints = keypoint_arrays(keypoints, len(self.tree.parents))
        self.points = point_arrays(points, len(self.tree.parents))
        self.depth = depth_arrays(depth, body)
        self.centre, self.weight = prior_arrays(priors, body.skeleton.dof)
        self.lower = np.ascontiguousarray(body.skeleton.lower, dtype=np.float64)
        self.upper = np.ascontiguousarray(body.skeleton.upper, dtype=np.float64)
        self.settings = SolveLimits(
            int(options.iterations),
            int(options.coarse_iterations),
            float(options.tolerance),
            float(options.damping),
            int(options.tries),
        )

    def start(self, start: ArrayLike) -> Array:
        """The start with its root's rotation vector inside +-pi, where the exponential map is far from singular."""
        q = np.array(start, dtype=np.float64)
        if q.shape != (self.body.skeleton.dof,):
            raise SolverError(f"A start pose of this body has {self.body.skeleton.dof} numbers, got shape {q.shape}.")
        if not np.isfinite(q).all():
            bad = self.body.skeleton.dof_names[int(np.argmin(np.isfinite(q)))]
            raise SolverError(f"The start pose is not finite in {bad}; start from another pose.")
        q[3:6] = nearest_branch(q[3:6], np.zeros(3))
        return q

    def priors(self, start: Array) -> PriorArrays:
        centre = self.centre.copy()
        centre[:, 3:6] = nearest_branch(centre[:, 3:6], start[3:6])
        return PriorArrays(centre, self.weight, self.lower, self.upper)

    def fit(self, start: ArrayLike) -> PoseFit:
        q = self.start(start)
        out = self._solve(q, self.priors(q), _own_workspace(self.body, self.contour_term))
        pose = out.pose.copy()
        pose[3:6] = nearest_branch(pose[3:6], np.asarray(start, dtype=np.float64)[3:6])
        counts = out.evaluation.counts
        return PoseFit(
            pose,
            out.pose,
            out.evaluation.cost,
            out.evaluation.hessian,
            out.evaluation.gradient,
            out.iterations,
            out.evaluations,
            out.converged,
            int(counts.sum()),
            counts[: len(self.contours.sdf)].copy(),
        )

    def _solve(self, q: Array, priors: PriorArrays, ws: Workspace) -> compute.Solution:
        evidence = self.tree, self.mesh, self.contours, self.keypoints, self.points, self.depth, priors
        o = self.settings
        if not self.rows:
            return compute.solve(q, *evidence, o, ws)

        def evaluate(pose: Array, coarse: bool) -> compute.Evaluation:
            known, own = compute.evaluate(pose, *evidence, ws, coarse=coarse), row_sums(pose, self.tree, self.rows)
            return compute.Evaluation(
                known.cost + own.cost,
                known.gradient + own.gradient,
                known.hessian + own.hessian,
                np.concatenate([known.counts, [[own.count, 0]]]),
            )

        coarse = min(o.coarse_iterations, o.iterations) if len(self.contours.sdf) else 0
        rule = Rule(o.damping, slack=1.002, moved=o.tolerance)
        return FrameProblem(evaluate, self.lower, self.upper).solution(q, (coarse, o.iterations - coarse), rule)


def _fits(ws: Workspace, body: Body, contours: ContourTerm | None) -> bool:
    w, h = (0, 0) if contours is None else contours.sizes.max(0)
    mesh, tree = body.coarse.arrays, body.skeleton.tree
    return bool(
        len(ws.vertices) == len(mesh.vertices)
        and len(ws.front) == len(mesh.faces)
        and len(ws.start) == len(mesh.edges)
        and len(ws.centres) == len(tree.parents)
        and len(ws.twists) == len(tree.axes)
        and ws.difference.shape[0] > h
        and ws.difference.shape[1] >= w
    )


def contour_arrays(term: ContourTerm | None) -> ContourArrays:
    """Flat arrays of a contour term (no views when None)."""
    if term is None:
        return compute.NO_CONTOURS
    stride = 2 if term.row_spacing_px >= 2 else 1
    return ContourArrays(
        np.require(term.sdf, np.float32, ["C", "W"]),
        np.require(term.outline, np.float32, ["C", "W"]),
        np.require(term.usable, np.bool_, ["C", "W"]),
        np.require(term.sizes, np.int64, ["C", "W"]),
        np.require(term.projections, np.float64, ["C", "W"]),
        float(term.weight * term.row_spacing_px / (SPACING_OF_HEIGHT * term.height_px)),
        float(term.weight * REFERENCE_OUTLINE / term.outline_count),
        float(term.scale_px),
        float(term.coarse_scale_px),
        float(term.row_spacing_px / stride),
        stride,
        np.require(term.shrunk, np.float64, ["C", "W"]),
        np.require(term.corners, np.int64, ["C", "W"]),
        np.require(term.sdf_sizes, np.int64, ["C", "W"]),
    )


def _joints(joint: ArrayLike, n_joints: int, what: str) -> NDArray[np.int64]:
    j = np.array(joint, dtype=np.int64)
    if len(j) and (j.min() < 0 or j.max() >= n_joints):
        raise InputError(
            f"{what}.joint refers to joint {int(j.max() if j.max() >= n_joints else j.min())} of {n_joints}."
        )
    return j


def keypoint_arrays(term: KeypointTerm | None, n_joints: int) -> KeypointArrays:
    """Flat arrays of a key-point term (none when None); rows to leave out get weight 0."""
    if term is None:
        return compute.NO_KEYPOINTS
    points = np.array(term.points, dtype=np.float64)
    seen = np.isfinite(points).all(-1) & (points[..., 2] > max(term.min_confidence, 0.0))
    points[~seen] = 0
    return KeypointArrays(
        points,
        np.require(term.projections, np.float64, ["C", "W"]),
        _joints(term.joint, n_joints, "KeypointTerm"),
        np.require(term.offset, np.float64, ["C", "W"]),
        float(term.scale_px),
    )


def point_arrays(term: PointTerm | None, n_joints: int) -> PointArrays:
    """Flat arrays of a 3D point term (none when None); missing points get weight 0."""
    if term is None:
        return compute.NO_POINTS
    points, weight = np.array(term.points_world, dtype=np.float64), np.array(term.weight, dtype=np.float64)
    missing = ~(np.isfinite(points).all(1) & np.isfinite(weight))
    points[missing], weight[missing] = 0, 0
    return PointArrays(
        points,
        weight,
        _joints(term.joint, n_joints, "PointTerm"),
        np.require(term.offset, np.float64, ["C", "W"]),
        float(term.scale_m),
    )


def prior_arrays(priors: Sequence[Quadratic], dof: int) -> tuple[Array, Array]:
    """Centres (P, D) and weights (P, D) of the priors."""
    centre, weight = np.zeros((len(priors), dof)), np.zeros((len(priors), dof))
    for i, p in enumerate(priors):
        if np.shape(p.centre) != (dof,) or np.shape(p.weight) != (dof,):
            raise InputError(f"A Quadratic prior needs centre and weight of shape {(dof,)}, got {np.shape(p.centre)}.")
        centre[i], weight[i] = p.centre, p.weight
    if not (weight >= 0).all():
        raise InputError("The weights of a Quadratic prior must not be negative or NaN.")
    return centre, weight
