"""Refine shape and poses of one person from the contours of several frames at once: joint Gauss-Newton.

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.body.anthropometry import body_of, entity, length_rows, prior_covariance, prior_mean
from hypose.body.body import Body
from hypose.errors import EvidenceError
from hypose.evidence.terms import ContourTerm, DepthTerm, Term
from hypose.fitting.problem import Cue, Posed, PoseProblem, Quadratic, Rows
from hypose.fitting.rows import rows_of_contours, rows_of_depth
from hypose.geometry import Array
from hypose.tracking.refinement import anatomical_prior

EFFECTIVE = 9.0
"""Rows per independent observation: errors of neighbouring rows are correlated, and so are those of all rows where the
template differs from the person. Measured on the subjects of the anthropometry benchmark, where the errors are about
three times the formal ones.
"""
CONTOUR_WEIGHT = 0.05
"""weight of a contour row in the pose solver"""
_DENSITY = 1000.0
"""kg/m^3 of a person with air in the lungs, for the mesh's volume"""


_BONES = (
    *("torso length", "upper arm length", "forearm length", "thigh length", "shank length"),
    *("shoulder width", "hip width"),
)
"""The entities that key points determine; hips, which no detector shows, are scaled like the trunk."""


@dataclass(frozen=True)
class Known:
    """Prior knowledge of the person; None: unknown.

    height: stature, m (sd 1 cm).
    mass: mass, kg (sd 6 %, because the mesh is not exactly the body).
    bones: standard deviation of the bone lengths (_BONES) relative to the given body, as a share.
    """

    height: float | None = None
    mass: float | None = None
    bones: float | None = None


@dataclass(frozen=True)
class ShapeSettings:
    """Settings of the refinement of shape and poses.

    iterations: Gauss-Newton steps of each stage; coarse: factor of the contour scale in each stage.
    weight: weight of a contour row at the reference density, as for the pose solver (errors of one frame's rows are
        correlated).
    pose_sd: how far poses may move from their start, rad.
    normals: rows whose outline directions differ by more than 60 degrees (this cosine) are left out.
    prior: factor on the anthropometric prior's weight.
    row_spacing_px: distance of contour rows, px.
    """

    iterations: tuple[int, ...] = (4, 5, 8)
    coarse: tuple[float, ...] = (4.0, 2.0, 1.0)
    weight: float = 1.0
    pose_sd: float = 0.5
    normals: float = 0.5
    prior: float = 1.0
    row_spacing_px: float = 4.0


@dataclass(frozen=True)
class ShapeFit:
    """Result of the refinement of shape and poses.

    body: the refined body.
    log_factors: (K,) logarithms of the SHAPE_FACTORS relative to the given body; covariance: (K, K) of them (poses
        marginalised; see EFFECTIVE).
    poses: (F, D) refined poses.
    cost: cost after the refinement.
    """

    body: Body
    log_factors: Array
    covariance: Array
    poses: Array
    cost: float


def refine_shape(
    body: Body,
    poses: Array,
    evidence: Sequence[Sequence[Term]],
    *,
    known: Known | None = None,
    options: ShapeSettings | None = None,
    start: Array | None = None,
) -> ShapeFit:
    """Estimate the shape of a body and the poses that best explain outlines and depth of F frames.

    body: the template, whose log factors are 0.
    poses: (F, D) start poses; evidence: terms of each frame.
    known: prior knowledge of the person.
    start: (K,) start values of the log factors (default: the prior's mean).
    Raises: EvidenceError where there is no frame.
    """
    if len(poses) == 0 or len(poses) != len(evidence):
        raise EvidenceError("The subject's shape needs at least one frame with silhouettes and its pose.")
    options, known = options or ShapeSettings(), known or Known()
    ratio = body.stature / float(np.ptp(body.coarse.vertices[:, 2]))  # decimation cuts the crown
    cues = [[_cue(one, options) for one in of] for of in evidence]
    # the same balance with the contours as in the pose solver, whose rows have weight 0.05
    usual = Quadratic(
        np.zeros(body.skeleton.dof), anatomical_prior(body.skeleton).weight * options.weight / CONTOUR_WEIGHT
    )
    anchor = Quadratic(np.array(poses, dtype=np.float64), np.full(body.skeleton.dof, options.pose_sd**-2))
    anchor.weight[:6] = 0
    problem = _ShapeProblem(body, cues, [usual, anchor], known, options.prior, ratio)
    state = prior_mean() if start is None else np.array(start, dtype=np.float64), anchor.centre
    found = problem.stages(state, options.coarse, options.iterations, 5e-4)
    x, q = found.state
    hessian, prior = found.equations.reduced().hessian, problem.prior(x)[0]
    covariance = np.asarray(np.linalg.inv((hessian - prior) / EFFECTIVE + prior), dtype=np.float64)
    return ShapeFit(body_of(body, x), x, covariance, q, found.cost)


def _cue(one: Term, options: ShapeSettings) -> Cue[Array]:
    """Build the function that computes the rows of a term, outlines or depth, for a posed body.

    options: weights and spacing of the rows.
    """

    if isinstance(one, ContourTerm):
        how = options.weight, options.row_spacing_px, options.normals
        return lambda at, _, factor: rows_of_contours(at, one, factor, *how)
    assert isinstance(one, DepthTerm), "a shape is fitted to outlines and depth"
    return lambda at, _, factor: rows_of_depth(at, one, factor, options.weight / CONTOUR_WEIGHT)


class _ShapeProblem(PoseProblem[Array]):
    """Problem of all frames' poses with the shared unknowns: log factors (K,) of the body's shape."""

    largest, _STEP = 0.08, 0.01

    def __init__(
        self,
        body: Body,
        frames: Sequence[Sequence[Cue[Array]]],
        priors: Sequence[Quadratic],
        known: Known,
        prior: float,
        height_ratio: float,
    ) -> None:
        super().__init__(body, frames, priors)
        self.mean, rows, sd = prior_mean(), *length_rows(body)[::2]
        self.precision = prior * (np.linalg.inv(prior_covariance()) + (rows / sd[:, None]).T @ (rows / sd[:, None]))
        if known.bones is not None:
            sure = np.zeros((len(_BONES), len(self.mean)))
            sure[:, entity("scale")] = sure[np.arange(len(_BONES)), [entity(n) for n in _BONES]] = 1 / known.bones
            self.precision += sure.T @ sure
        self.free = np.ones(len(self.mean), dtype=np.bool_)
        # what may be known: its logarithm, the sd of that, and how it is measured
        self._measures = list[tuple[float, float, Callable[[Body], float]]]()
        if known.height is not None:
            crown = lambda b: height_ratio * float(np.ptp(b.coarse.vertices[:, 2]))  # noqa: E731
            self._measures.append((float(np.log(known.height)), 0.01 / known.height, crown))
        if known.mass is not None:
            self._measures.append((float(np.log(known.mass)), 0.06, lambda b: _DENSITY * b.coarse.volume))

    def body(self, shared: Array) -> Body:
        return body_of(self.template, shared)

    def shared_cost(self, shared: Array, body: Body) -> float:
        off = shared - self.mean
        missed = sum(((np.log(of(body)) - at) / sd) ** 2 for at, sd, of in self._measures)
        return 0.5 * float(off @ self.precision @ off + missed)

    def shared_moved(self, shared: Array, step: Array) -> Array:
        return shared + step

    def prior(self, x: Array) -> tuple[Array, Array, list[Body]]:
        """Compute matrix (K, K) and gradient (K,) of the prior on the shape, and the K bodies with one factor
        changed by a step.
        """
        varied = [self.body(x + self._STEP * e) for e in np.eye(len(x))]
        hessian, gradient = self.precision.copy(), self.precision @ (x - self.mean)
        for at, sd, of in self._measures:
            value = float(np.log(of(self.body(x))))
            slope = np.array([(float(np.log(of(b))) - value) / self._STEP for b in varied])
            hessian += np.outer(slope, slope) / sd**2
            gradient += slope * (value - at) / sd**2
        return np.asarray(hessian, dtype=np.float64), gradient, varied

    def shared_rows(
        self, shared: Array, posed: Sequence[Posed], rows: Sequence[Rows]
    ) -> tuple[Array, Array, Sequence[Array]]:
        hessian, gradient, varied = self.prior(shared)
        poses, vertices = np.stack([at.pose for at in posed]), np.stack([at.vertices for at in posed])
        slopes = (np.stack([b.skin(poses) for b in varied], 3) - vertices[..., None]) / self._STEP
        return hessian, gradient, [r.by_vertices(by) for r, by in zip(rows, slopes, strict=True)]
