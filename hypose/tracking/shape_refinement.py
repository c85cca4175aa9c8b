"""Shape and poses of one person from the contours of several frames at once: joint Gauss-Newton.

Unknowns are the log shape factors of the entities (hypose.body.anthropometry), shared by all frames, and one pose per
frame. Rows are the two-way contour distances of the pose solver (outline of the body against the mask's distance
transform, outline of the mask against the nearest outline of the body), with a Geman-McClure weight; rows of
anthropometry hold what the views do not show. Poses are eliminated per frame (Schur complement), so the cost of a step
grows linearly with the frames, and a segment's length and the bends at its ends move together, which an alternation of
shape and pose steps does only slowly. Several different poses are needed: a straight limb does not show its joint.
Source: entities and statistics of Alcoverro 2014, section 2.3; the joint gradient solution in place of the layered
filter is an addition (compare Gall et al. 2009 for contours, Carranza et al. 2003 for fitting limb by limb).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from hypose.body.anthropometry import body_of, entity, length_rows, prior_covariance, prior_mean
from hypose.body.body import Body, Landmarks, Mesh
from hypose.compute import (
    OutlineRows,
    SharedEquations,
    geman_mcclure,
    joined_rows,
    outline_rows,
    weighted_squares,
)
from hypose.errors import EvidenceError
from hypose.fitting import DepthTerm
from hypose.fitting.articulated import ContourTerm
from hypose.fitting.least_squares import Rule, descend
from hypose.geometry import Array
from hypose.tracking.depth_shape_rows import ShapeRows, depth_shape_rows
from hypose.tracking.refinement import anatomical_prior

EFFECTIVE = 9.0
"""Rows per independent observation: neighbours err together, and so do all rows where the template is another person.
Measured on the subjects of the anthropometry benchmark, where the errors are about three times the formal ones."""
CONTOUR_WEIGHT = 0.05
"""of a contour row in the pose solver"""
DENSITY = 1000.0
"""kg/m^3 of a person with air in the lungs, with the mesh's volume"""


BONES = (
    *("torso length", "upper arm length", "forearm length", "thigh length", "shank length"),
    *("shoulder width", "hip width"),
)
"""The entities that key points tell; hips, which no detector shows, are as wide as the trunk is long."""


@dataclass(frozen=True)
class Known:
    """What is known of the subject: height m (sd 1 cm), mass kg (sd 6 %: the mesh is not the body); bones: the BONES of
    the body given, by what share they may differ (1 sd). None = unknown."""

    height: float | None = None
    mass: float | None = None
    bones: float | None = None


@dataclass(frozen=True)
class ShapeSettings:
    """iterations: Gauss-Newton steps; coarse: factors of the contour scale, one stage each; weight: of a contour row at
    the reference density, as for the pose solver (rows of one frame err together, so it is far below 1); pose_sd: how
    far poses may move from where they start, rad; normals: rows whose outlines point more than 60 degrees apart are
    left out; prior: factor on the anthropometric prior's weight."""

    iterations: tuple[int, ...] = (4, 5, 8)
    coarse: tuple[float, ...] = (4.0, 2.0, 1.0)
    weight: float = 1.0
    pose_sd: float = 0.5
    normals: float = 0.5
    prior: float = 1.0
    row_spacing_px: float = 4.0


@dataclass(frozen=True)
class ShapeFit:
    """body; log_factors (K,) of SHAPE_FACTORS relative to the body given, covariance (K, K) of them (poses
    marginalised; see EFFECTIVE); poses (F, D); cost before and after."""

    body: Body
    log_factors: Array
    covariance: Array
    poses: Array
    cost_before: float
    cost: float


class _Rows(NamedTuple):
    """Linearised rows of one frame: jacobian (R, D + K) over pose and shape, weight (R,), residual (R,) px or m."""

    jacobian: Array
    weight: Array
    residual: Array


def refine_shape(
    body: Body,
    poses: Array,
    contours: Sequence[ContourTerm],
    *,
    known: Known | None = None,
    options: ShapeSettings | None = None,
    start: Array | None = None,
    depths: Sequence[DepthTerm | None] | None = None,
) -> ShapeFit:
    """Shape of `body` and poses that explain the contours of F frames best.

    body: the template, whose log factors are 0; start (K,): log factors to begin with (default 0, and the prior is
    about 0 except for the scale). poses (F, D), contours F terms; depths: F terms of depth
    cameras, if any. An EvidenceError when there is no frame.
    """
    if len(poses) == 0 or len(poses) != len(contours):
        raise EvidenceError("The subject's shape needs at least one frame with silhouettes and its pose.")
    options, known = options or ShapeSettings(), known or Known()
    marks = Landmarks((), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    light = replace(body, fine=body.coarse, landmarks=marks)  # nothing but the scoring mesh is needed
    light.coarse.edges  # noqa: B018 - built once, shared by all deformed copies
    ratio = body.stature / float(np.ptp(body.coarse.vertices[:, 2]))  # decimation cuts the crown
    anchor = np.asarray(poses, dtype=np.float64)
    problem = _ShapeProblem(light, list(contours), known, options, anchor, ratio, depths or [None] * len(poses))
    x = prior_mean() if start is None else np.array(start, dtype=np.float64)
    q = np.array(poses, dtype=np.float64)
    before = problem.linearise(x, q, options.coarse[-1]).cost
    for n, factor in zip(options.iterations, options.coarse, strict=True):
        x, q = problem.solve(x, q, n, factor)
    system = problem.linearise(x, q, options.coarse[-1])
    hessian, prior = problem.equations(system, q).reduced().hessian, system.prior()[0]
    covariance = np.asarray(np.linalg.inv((hessian - prior) / EFFECTIVE + prior), dtype=np.float64)
    return ShapeFit(body_of(body, x), x, covariance, q, before, system.cost)


@dataclass(frozen=True)
class _System:
    """Rows of the frames, and Hessian (K, K) and gradient (K,) of the priors, made when they are wanted: a step that is
    refused needs but its cost."""

    rows: Callable[[], list[_Rows]]
    prior: Callable[[], tuple[Array, Array]]
    cost: float


class _Place:
    """A shape (K,) and poses (F, D), and what follows from them alone: where one stage ends the next one begins."""

    STEP = 0.01

    def __init__(self, problem: _ShapeProblem, x: Array, q: Array) -> None:
        self.x, self.q, self._problem = x, q, problem
        self.body = problem.deformed(x)
        self.vertices = self.body.skin(q)
        terms = problem.contours
        self.outlines = [problem.outlines(self.body, v, term) for v, term in zip(self.vertices, terms, strict=True)]

    @cached_property
    def twists(self) -> Array:
        """(F, D, 6) in the world."""
        return self.body.skeleton.world_twists(self.q)

    @cached_property
    def varied(self) -> list[Body]:
        """The body with each factor changed by STEP."""
        return [self._problem.deformed(self.x + self.STEP * e) for e in np.eye(len(self.x))]

    @cached_property
    def slopes(self) -> Array:
        """(F, V, K, 3) of the vertices by the shape."""
        skins = np.stack([b.skin(self.q) for b in self.varied], 2)
        return (skins - self.vertices[:, :, None]) / self.STEP

    @cached_property
    def jacobians(self) -> list[Array]:
        """(R, D + K) of the outlines' rows of each frame, by pose and shape."""
        about = zip(self.outlines, self.vertices, self.twists, self.slopes, strict=True)
        return [made.jacobian(v, twists, self._problem.moves, slopes) for made, v, twists, slopes in about]


class _ShapeProblem:
    """Evidence and priors of one fit."""

    def __init__(
        self,
        body: Body,
        contours: list[ContourTerm],
        known: Known,
        options: ShapeSettings,
        anchor: Array,
        height_ratio: float,
        depths: Sequence[DepthTerm | None],
    ) -> None:
        self.depths = depths
        self.body, self.contours, self.known, self.options, self.anchor = body, contours, known, options, anchor
        # (V, D) share of a dof's motion at a vertex
        self.moves = body.coarse.dense_weights(len(body.skeleton.joint_names)) @ body.skeleton.moves.T.astype(
            np.float64
        )
        self.precision = np.linalg.inv(prior_covariance()) * options.prior
        self.mean = prior_mean()
        if known.bones is not None:
            sure = np.zeros((len(BONES), len(self.mean)))
            sure[:, entity("scale")] = sure[np.arange(len(BONES)), [entity(n) for n in BONES]] = 1 / known.bones
            self.precision = self.precision + sure.T @ sure
        self.height_ratio = height_ratio
        rows, _, sd = length_rows(body)
        self.precision = self.precision + options.prior * (rows / sd[:, None]).T @ (rows / sd[:, None])
        # in the same balance with the contours as in the pose solver, whose rows weigh 0.05
        self.pose_weight = anatomical_prior(body.skeleton).weight * options.weight / CONTOUR_WEIGHT
        self.anchor_weight = np.full(body.skeleton.dof, options.pose_sd**-2)
        self.anchor_weight[:6] = 0
        self._places = deque[_Place](maxlen=6)  # no more than the steps of one iteration, and where it began
        # what may be known: its logarithm, the sd of that, and how it is measured
        self._measures: dict[str, tuple[float, float, Callable[[Body], float]]] = {}
        if known.height is not None:
            crown = lambda b: self.height_ratio * float(np.ptp(b.coarse.vertices[:, 2]))  # noqa: E731
            self._measures["height"] = float(np.log(known.height)), 0.01 / known.height, crown
        if known.mass is not None:
            self._measures["mass"] = float(np.log(known.mass)), 0.06, lambda b: DENSITY * b.coarse.volume

    def deformed(self, x: Array) -> Body:
        return body_of(self.body, x)

    def linearise(self, x: Array, q: Array, factor: float) -> _System:
        """Rows of all frames and the priors at shape x (K,) and poses q (F, D)."""
        place = self._place(x, q)
        known = self._known_residuals(place.body)
        cost = 0.5 * (x - self.mean) @ self.precision @ (x - self.mean)
        for r in known.values():
            cost += 0.5 * r * r
        cost += 0.5 * float((self.pose_weight * q**2).sum())
        cost += 0.5 * float((self.anchor_weight * (q - self.anchor) ** 2).sum())
        robust = [self._robust(made, term, factor) for made, term in zip(place.outlines, self.contours, strict=True)]
        deep = [self._depth_rows(place, f, factor) for f in range(len(q))]
        costs = [c if d is None else c + d.cost for (_, c), d in zip(robust, deep, strict=True)]
        rows = partial(self._rows, place, [weight for weight, _ in robust], deep)
        return _System(rows, partial(self._prior, place, known), float(cost) + sum(costs))

    def _place(self, x: Array, q: Array) -> _Place:
        found = next((p for p in self._places if np.array_equal(p.x, x) and np.array_equal(p.q, q)), None)
        if found is None:
            found = _Place(self, x, q)
            self._places.append(found)
        return found

    def _prior(self, place: _Place, known: Mapping[str, float]) -> tuple[Array, Array]:
        """Hessian (K, K) and gradient (K,) of what is known of the shape without the views."""
        h, g = self.precision.copy(), self.precision @ (place.x - self.mean)
        for name, r in known.items():
            _, sd, of = self._measures[name]
            value = float(np.log(of(place.body)))
            gradient = np.array([(float(np.log(of(b))) - value) / place.STEP for b in place.varied])
            h += np.outer(gradient, gradient) / sd**2
            g += gradient * r / sd
        return np.asarray(h, dtype=np.float64), g

    def _known_residuals(self, shaped: Body) -> dict[str, float]:
        """By how many standard deviations what is known is missed."""
        return {name: (float(np.log(of(shaped))) - at) / sd for name, (at, sd, of) in self._measures.items()}

    def equations(self, system: _System, q: Array) -> SharedEquations:
        """Of the shape (K,), shared by the frames' poses (F, D)."""
        hessian, gradient = system.prior()
        (n, dof), shape = q.shape, len(gradient)
        own, own_gradient, cross = np.empty((n, dof, dof)), np.empty((n, dof)), np.empty((n, dof, shape))
        for f, r in enumerate(system.rows()):
            h, g = weighted_squares(*r)
            own[f], cross[f] = h[:dof, :dof] + np.diag(self.pose_weight + self.anchor_weight), h[:dof, dof:]
            own_gradient[f] = g[:dof] + self.pose_weight * q[f] + self.anchor_weight * (q[f] - self.anchor[f])
            hessian += h[dof:, dof:]
            gradient += g[dof:]
        return SharedEquations(hessian, gradient, own, own_gradient, cross)

    def solve(self, x: Array, q: Array, iterations: int, factor: float) -> tuple[Array, Array]:
        """One stage of damped Gauss-Newton; returns shape and poses."""

        def evaluate(state: tuple[Array, Array]) -> tuple[float, Callable[[], SharedEquations]]:
            system = self.linearise(*state, factor)
            return system.cost, partial(self.equations, system, state[1])

        return descend((x, q), evaluate, self.propose, iterations, Rule(slack=1.002, moved=5e-4)).state

    def propose(
        self, state: tuple[Array, Array], equations: SharedEquations, damping: float
    ) -> tuple[tuple[Array, Array], float] | None:
        reduced = equations.reduced(damping)
        dx = reduced.step()
        if dx is None:
            return None
        dx *= min(1.0, 0.08 / max(float(np.abs(dx).max()), 1e-9))
        dq = reduced.own_steps(dx)
        dq *= np.minimum(1, 0.3 / np.maximum(np.abs(dq[:, 3:]).max(1, keepdims=True), 1e-9))
        x, q = state
        return (x + dx, self.body.skeleton.clamp(q + dq)), float(np.abs(dx).max())

    def _depth_rows(self, place: _Place, frame: int, factor: float) -> ShapeRows | None:
        term = self.depths[frame]
        if term is None:
            return None
        gain = self.options.weight / CONTOUR_WEIGHT
        about = place.vertices[frame], place.slopes[frame], place.twists[frame], self.moves
        return depth_shape_rows(place.body.coarse, *about, term, factor, gain)

    def outlines(self, shaped: Body, vertices: Array, term: ContourTerm) -> OutlineRows:
        """The rows of all views of one frame, with the body's vertices (V, 3)."""
        views = np.flatnonzero(term.usable).tolist()
        spacing, normals = self.options.row_spacing_px, self.options.normals
        parts = [outlines_of(shaped.coarse, vertices, term, c, spacing, normals) for c in views]
        return joined_rows([p for p in parts if p is not None])

    def _robust(self, made: OutlineRows, term: ContourTerm, factor: float) -> tuple[Array, float]:
        """(R,) what the rows of one frame weigh, and what they cost."""
        scale = term.scale_px * factor
        w0 = self.options.weight * made.weight
        rho, slope, _ = geman_mcclure((made.residual / scale) ** 2, w0 / scale**2)
        return slope, 0.5 * float((w0 * rho).sum())

    def _rows(self, place: _Place, weights: Sequence[Array], deep: Sequence[ShapeRows | None]) -> list[_Rows]:
        out = []
        for made, weight, own, jacobian in zip(place.outlines, weights, deep, place.jacobians, strict=True):
            rows = _Rows(jacobian, weight, made.residual)
            if own is not None:
                rows = _Rows(*(np.concatenate(p) for p in zip(rows, own[:3], strict=True)))
            out.append(rows)
        return out


def outlines_of(
    mesh: Mesh, vertices: Array, term: ContourTerm, view: int, spacing_px: float, least_cosine: float
) -> OutlineRows | None:
    """`hypose.compute.outline_rows` of one view with the body's vertices (V, 3) m."""
    seen = term.projections[view], term.sizes[view].tolist(), term.sdf[view], term.outline[view], term.height_px
    return outline_rows(vertices, mesh.faces, mesh.edges, *seen, spacing_px, least_cosine)
