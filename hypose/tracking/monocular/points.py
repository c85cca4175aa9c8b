"""Key points and clicked joints of one picture as terms of the solver, and the poses and proportions that fit them
(stage 1 of the start).

One picture cannot tell a short limb from one that points at the camera; in further pictures the limb has another
direction.
Source: Sminchisescu & Triggs 2001, section 5 (points, prior intervals, joint limits, mirrored sides). Deviation: more
    than one picture can be used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.anthropometry import body_of
from hypose.body.body import Body, Mesh
from hypose.cameras.camera import Camera
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import person_size
from hypose.evidence.terms import KeypointTerm
from hypose.fitting.problem import Cue, Posed, PoseProblem, Quadratic, Rows, Rule
from hypose.fitting.rows import rows_of_keypoints
from hypose.geometry import Array
from hypose.tracking.frame_evidence import keypoint_term
from hypose.tracking.monocular.problem import Floor, floor_rows
from hypose.tracking.monocular.proportions import INTERNAL, Proportions
from hypose.tracking.refinement import anatomical_prior

PointsOn = Callable[[Body], KeypointTerm]
"""Function that places the points of one picture on a body; for example `keypoints_on` with the key points given."""
HELD = 1e6
"""1/rad^2: weight that fixes a dof which is not estimated."""
_STEP = 0.01
"""Step of a factor's logarithm for its numeric derivative."""
_KEYPOINT_SHARE = 0.016
"""Standard deviation of a detector's point, as a share of the person's size in the picture."""
FEWEST_PX = 1.0


def clicked_joints(
    body: Body, clicks: Mapping[str, tuple[float, float]], camera: Camera, scale_px: float = 4.0
) -> KeypointTerm:
    """Convert clicked joints of a picture to the term of key points with confidence 1.

    clicks: joint name -> (u, v) px.
    camera: pinhole camera of the picture.
    scale_px: standard deviation of a click, px.
    Raises: InputError, listing the joints, where a name is not a joint of the body.
    """
    joint = np.array([body.skeleton.joint(name) for name in clicks], dtype=np.int64)
    pixels, n = np.array(list(clicks.values()), dtype=np.float64).reshape(-1, 2), len(joint)
    seen = np.column_stack([pixels, np.ones(n)])[None]
    return KeypointTerm(seen, camera.projection[None], joint, np.zeros((n, 3)), scale_px, min_confidence=0.0)


def keypoints_on(keypoints: Keypoints, body: Body) -> KeypointTerm:
    """Build the term of the key points of one view, with the error that detectors usually have at that size of the
    person.

    Returns: the term; without points where no key point is confident and known to the body.
    """
    found = keypoint_term(keypoints, body, scale_px=max(FEWEST_PX, _KEYPOINT_SHARE * person_size(keypoints.points[0])))
    none = np.zeros((1, 0, 3)), keypoints.rig.projections, np.zeros(0, np.int64), np.zeros((0, 3))
    return found or KeypointTerm(*none, FEWEST_PX)


def seen_points(points: KeypointTerm) -> int:
    """Count the points of one view that are seen."""
    return int((points.points[0, :, 2] > 0).sum())


def held_dofs(dof: int, active: NDArray[np.int64]) -> Array:
    """Compute the weights (D,) of a quadratic prior that holds all dof at its centre, except the active ones.

    dof: number D of dof.
    active: (A,) indices of the dof that stay free.
    """
    held = np.full(dof, HELD)
    held[active] = 0.0
    return held


def fit_proportions(
    template: Body,
    pictures: Sequence[PointsOn],
    poses: Sequence[Array],
    factors: Array,
    prior: Proportions,
    active: NDArray[np.int64],
    floor: Floor | None = None,
) -> tuple[Array, Array, float]:
    """Fit one body to all M pictures: poses and proportions together.

    template: body that is deformed.
    pictures: M functions that place the points of a picture on a body.
    poses: M start poses (D,).
    factors: (K,) start values of the proportions, logarithms; only those that move joints change.
    prior: prior of the proportions.
    active: (A,) dof of every pose that may change.
    floor: floor on which the person stands in every picture; None: unknown. Why: without it one view cannot tell
        long legs that point away from shorter ones that do not.
    Returns: poses (M, D); factors (K,), logarithms; cost of the fit.
    """
    start, held = np.array(poses, dtype=np.float64), held_dofs(template.skeleton.dof, active)
    problem = _PointsProblem(template, pictures, factors, prior, [Quadratic(start, held)], floor)
    found = problem.solve((factors[INTERNAL], start), 30, Rule(1e-3, easier=9, least=1e-9, gain=1e-5))
    q = np.where(held > 0, start, found.state[1])
    return q, problem.all_factors(found.state[0]), found.cost


class _PointsProblem(PoseProblem[Array]):
    """Problem of all pictures' poses with the shared unknowns: logarithms of the proportions that move joints."""

    largest = 0.1

    def __init__(
        self,
        template: Body,
        pictures: Sequence[PointsOn],
        factors: Array,
        prior: Proportions,
        priors: Sequence[Quadratic],
        floor: Floor | None,
    ) -> None:
        def cue(points_on: PointsOn) -> Cue[Array]:
            def rows(at: Posed, _: Array, __: float) -> list[Rows]:
                term = points_on(at.body)
                found = [rows_of_keypoints(at, term, term.projections)]
                return found if floor is None else [*found, floor_rows(at, floor)]

            return rows

        nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 4), np.int32), np.zeros((0, 4)))
        bare = replace(template, coarse=nothing, fine=nothing)  # fast to deform
        super().__init__(bare, [[cue(one)] for one in pictures], [anatomical_prior(template.skeleton), *priors])
        self.template, self.factors, self.prior = bare, factors, prior
        self.free = np.ones(len(INTERNAL), dtype=np.bool_)

    def all_factors(self, shared: Array) -> Array:
        """Put the unknown factors into the (K,) logarithms of all proportions."""
        out = self.factors.copy()
        out[INTERNAL] = shared
        return out

    def body(self, shared: Array) -> Body:
        return body_of(self.template, self.all_factors(shared))

    def shared_cost(self, shared: Array, body: Body) -> float:
        return 0.5 * float((((shared - self.prior.centre[INTERNAL]) / self.prior.sd[INTERNAL]) ** 2).sum())

    def shared_moved(self, shared: Array, step: Array) -> Array:
        return np.clip(shared + step, *self.prior.interval[:, INTERNAL])

    def shared_rows(
        self, shared: Array, posed: Sequence[Posed], rows: Sequence[Rows]
    ) -> tuple[Array, Array, Sequence[Array]]:
        weight, slopes = self.prior.sd[INTERNAL] ** -2, []
        varied = [self.body(shared + _STEP * e) for e in np.eye(len(shared))]
        for at, cues, r in zip(posed, self.frames, rows, strict=True):
            moved = [Posed(b, at.pose, at.vertices) for b in varied]
            residuals = [Rows.joined(found for cue in cues for found in cue(b, shared, 1.0)).residual for b in moved]
            slopes.append((np.stack(residuals, 1) - r.residual[:, None]) / _STEP)
        return np.diag(weight), weight * (shared - self.prior.centre[INTERNAL]), slopes
