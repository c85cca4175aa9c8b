"""Evidence: a cue of one frame, prepared once for all its uses, and the terms that solvers take.

A solver takes any number of terms; a search computes the energy of poses. A user's own cue is a `PointTerm`, a
`RowTerm`, or both with an energy (hypose.evidence.cues.OwnEvidence).
Source: two-way contour distances with a robust weight as in the silhouette trackers of Alcoverro 2014, chapter 4, and
    Gall et al. 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.compute.arrays import ContourArrays, DepthArrays, KeypointArrays, PointArrays, Standing
from hypose.errors import EvidenceError, InputError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Silhouettes
from hypose.evidence.outlines import OUTLINE_POINTS as REFERENCE_OUTLINE
from hypose.evidence.outlines import SMALLEST, shrunk_projection
from hypose.evidence.prefetch import outlines
from hypose.geometry import Array

# Reference density of the contour rows, for a person `height` px tall: weights are per arc length, so changing the
# spacing or the number of points does not change the balance with key points and priors.
SPACING_OF_HEIGHT = 6 / 260
SCALE_OF_HEIGHT = 2.5 / 260


class Limb(NamedTuple):
    """Description of poses that differ in one limb only; all other joints are as in the last pose.

    moving: (J,) true for the joints that turn.
    rest: silhouettes of the parts that stay, where they are drawn already.
    """

    moving: NDArray[np.bool_]
    rest: Standing | None = None


class Term:
    """Base class of the residuals of one cue in one frame, for solvers."""


@dataclass(frozen=True)
class Evidence:
    """Base class of one cue (kind of evidence) of one frame, prepared once for searches and solves.

    views: (C,) views or sensors that carry it; empty where it belongs to none.
    terms: residuals of the cue for solvers.
    """

    views: NDArray[np.bool_]
    terms: tuple[Term, ...]

    @property
    def seen(self) -> bool:
        """Whether any view or sensor carries this cue."""
        return bool(self.views.any())

    def energy(self, body: Body, poses: Array, limb: Limb | None = None) -> Array:
        """Compute the energies (N,) of poses (N, D) of a body for a search; low is good, the silhouettes of one view
        cost 0 to 2.

        limb: the only part of the body that differs between the poses; None: any part may differ. The base class
            returns 0, for cues that a search does not use.
        """
        return np.zeros(len(poses))


class Piece(Protocol):
    """Interface of an additional kind of evidence that a frame carries in `Frame.more`, as it was measured."""

    def prepared(self, body: Body) -> Evidence:
        """Prepare the cue for a search and for solves of a body."""
        ...


@dataclass(frozen=True)
class ContourTerm(Term):
    """Silhouette contours of one frame, in both directions (body outline -> mask, mask outline -> body); see
    `contour_term`.

    sdf: (C, h, w) float32 signed distance, px, negative inside.
    outline: (C, K, 2) float32 points on the mask's edge, px.
    usable: (C,).
    sizes: (C, 2) width, height.
    projections: (C, 3, 4) pinhole.
    weight: weight of one row at the reference density (rows 6 px apart on a person 260 px tall, 130 outline points a
        view).
    scale_px, coarse_scale_px: Geman-McClure scale of the distance, px: the final one, and that of the first
        iterations.
    row_spacing_px: distance of the forward rows along the body's outline, px.
    outline_count: K (at most 1000).
    height_px: height of the person in the picture, px (median over the usable views).
    shrunk: (C,) factor of the larger pixels in which sdf, outline, sizes and projections are; all other lengths are in
        the original pixels.
    corners: (C, 2), sdf_sizes: (C, 2): the part of each image that its sdf covers; rows outside cost as at infinite
        distance.
    """

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
        """The solver's arrays, built once for all solves of a frame."""
        stride = 2 if self.row_spacing_px >= 2 else 1
        return ContourArrays(
            np.require(self.sdf, np.float32, ["C", "W"]),
            np.require(self.outline, np.float32, ["C", "W"]),
            np.require(self.usable, np.bool_, ["C", "W"]),
            np.require(self.sizes, np.int64, ["C", "W"]),
            np.require(self.projections, np.float64, ["C", "W"]),
            float(self.weight * self.row_spacing_px / (SPACING_OF_HEIGHT * self.height_px)),
            float(self.weight * REFERENCE_OUTLINE / self.outline_count),
            float(self.scale_px),
            float(self.coarse_scale_px),
            float(self.row_spacing_px / stride),
            stride,
            np.require(self.shrunk, np.float64, ["C", "W"]),
            np.require(self.corners, np.int64, ["C", "W"]),
            np.require(self.sdf_sizes, np.int64, ["C", "W"]),
        )


@dataclass(frozen=True)
class KeypointTerm(Term):
    """2D key points of one frame, with a Cauchy (Lorentzian) cost of scale 2 sd: 2 w log(1 + (r / 2 sd)^2).

    points: (C, K, 3) u px, v px, confidence (weight w of the row); rows below min_confidence or not finite are left
        out.
    projections: (C, 3, 4) pinhole cameras of these pixels.
    joint: (K,), offset: (K, 3) in the joint's frame, m: where the key point sits on the body.
    scale_px: 1 sd.
    """

    points: Array
    projections: Array
    joint: NDArray[np.int64]
    offset: Array
    scale_px: float
    min_confidence: float = 0.3

    def arrays(self, body: Body) -> KeypointArrays:
        """Build the solver's arrays; rows to leave out get weight 0."""
        points = np.array(self.points, dtype=np.float64)
        seen = np.isfinite(points).all(-1) & (points[..., 2] > max(self.min_confidence, 0.0))
        points[~seen] = 0
        return KeypointArrays(
            points,
            np.require(self.projections, np.float64, ["C", "W"]),
            checked_joints(self, body),
            np.require(self.offset, np.float64, ["C", "W"]),
            float(self.scale_px),
        )


@dataclass(frozen=True)
class PointTerm(Term):
    """3D points of one frame, with a Cauchy (Lorentzian) cost of scale 2 sd, as for key points.

    points_world: (M, 3) m; NaN where missing.
    weight: (M,).
    joint: (M,), offset: (M, 3) in the joint's frame, m: where the point sits on the body.
    scale_m: 1 sd.
    Raises: InputError where the shapes do not fit or the scale is not positive.
    """

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

    def arrays(self, body: Body) -> PointArrays:
        """Build the solver's arrays; missing points get weight 0."""
        points, weight = np.array(self.points_world, dtype=np.float64), np.array(self.weight, dtype=np.float64)
        missing = ~(np.isfinite(points).all(1) & np.isfinite(weight))
        points[missing], weight[missing] = 0, 0
        return PointArrays(
            points,
            weight,
            checked_joints(self, body),
            np.require(self.offset, np.float64, ["C", "W"]),
            np.full(len(points), float(self.scale_m)),
        )


Residuals = Callable[[Array], tuple[ArrayLike, ArrayLike]]


@dataclass(frozen=True)
class RowTerm(Term):
    """Residuals of body points in one frame, with a Cauchy (Lorentzian) cost of each point's residuals together.

    The cost is 2 w log(1 + |r|^2 / 4), with r in standard deviations, as for key points.
    joint: (P,) joint of each point.
    offset: (P, 3) in the joint's frame, m (default: its centre).
    residuals: function of the points (P, 3), m, in the world; returns r (P, R), in sd, and its derivative with respect
        to the point (P, R, 3), in sd per m. NaN leaves a point out.
    weight: (P,) factors w on the points' costs, 0 for one that is not seen (default 1).
    Raises: InputError where the shapes do not fit.
    """

    joint: NDArray[np.int64]
    residuals: Residuals
    offset: Array | None = None
    weight: Array | None = None

    def __post_init__(self) -> None:
        n = np.shape(self.joint)
        given = np.shape(self.offset) if self.offset is not None else (*n, 3)
        weights = np.shape(self.weight) if self.weight is not None else n
        if len(n) != 1 or given != (*n, 3) or weights != n:
            raise InputError(
                f"RowTerm needs joint (P,), offset (P, 3) and weight (P,), got {n}, {given} and {weights}."
            )


def checked_joints(term: KeypointTerm | PointTerm | RowTerm, body: Body) -> NDArray[np.int64]:
    """Check the joints (P,) of a term and return them; InputError where the body does not have one of them."""
    j, count = np.array(term.joint, dtype=np.int64), len(body.skeleton.parents)
    if len(j) and (j.min() < 0 or j.max() >= count):
        raise InputError(
            f"{type(term).__name__}.joint refers to joint {int(j.max() if j.max() >= count else j.min())} of {count}."
        )
    return j


def contour_term(
    silhouettes: Silhouettes,
    weight: float = 0.05,
    *,
    outline_count: int = REFERENCE_OUTLINE,
    working_height: int | None = None,
) -> ContourTerm:
    """Build the contour evidence of a frame's masks.

    weight: weight of one row (residual) at the reference density of rows, see `ContourTerm`.
    outline_count: points per view.
    working_height: px, for tracking: views in which the person is 1.5 times as tall are computed in larger pixels, and
        distances only around the person.
    Raises: EvidenceError where no view is left; views that are not usable, or have no outline away from the image
        border, are left out.
    The Geman-McClure scale is 2.5 px for a person 260 px tall, in proportion (10 px in a 1080p image), in the first
    iterations twice that.
    """
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
    """Compute the median of a few numbers faster than numpy does."""
    v = sorted(values.tolist())
    return 0.5 * (v[(len(v) - 1) // 2] + v[len(v) // 2])


BODY_SD = 0.012
"""m: usual distance of a person's surface from that of a body of the right size: clothes, folds, flesh"""
DEPTH_WEIGHT, DEPTH_SCALE_M = 0.1, 0.025
"""Weight of one point, and robust scale of its distance, m. Chosen on simulated recordings of the seeds 0 to 9
(benchmark `depth`)."""
FREE_SHARE, FREE_SCALE_M, SLACK_M = 0.5, 0.06, 0.02
_MAP_SIDE = 160
"""px: largest side of the maps in which the body is looked up; more is not needed"""


@dataclass(frozen=True)
class DepthTerm(Term):
    """Term of depth in the solver; built by `depth_term`.

    points, normals: (M, 3) in the world, m.
    weight: (M,).
    first: (C + 1,) ranges of each sensor's points.
    eyes: (C, 3) positions of the sensors, m.
    maps: (C, h, w) float32 m, 0: unknown.
    sizes: (C, 2) width, height.
    projections: (C, 3, 4).
    free_share: weight, per point, of body parts in front of the measured surface.
    scale_m: Geman-McClure scale of a point's distance, m.
    A body part up to SLACK_M (m) in front of the measured surface costs nothing; beyond that, its robust scale is
    FREE_SCALE_M (m).
    """

    points: Array
    normals: Array
    weight: Array
    first: NDArray[np.int64]
    eyes: Array
    maps: NDArray[np.float32]
    sizes: NDArray[np.int64]
    projections: Array
    free_share: float = FREE_SHARE * DEPTH_WEIGHT
    scale_m: float = DEPTH_SCALE_M

    def arrays(self, body: Body) -> DepthArrays | None:
        """Build the solver's arrays; None where there are no points."""
        scales = float(self.scale_m), self.free_share, FREE_SCALE_M, SLACK_M
        return DepthArrays._make((*self._flat, *body.coarse.rings, *scales)) if len(self.points) else None

    @cached_property
    def _flat(self) -> tuple[NDArray, ...]:
        """The arrays in the solver's order, built once for all solves of a frame."""
        given: list[tuple[NDArray, type]] = [(self.points, np.float64), (self.normals, np.float64)]
        given += [(self.weight, np.float64), (self.first, np.int64), (self.eyes, np.float64), (self.maps, np.float32)]
        given += [(self.sizes, np.int64), (self.projections, np.float64)]
        return tuple(np.require(a, kind, ["C", "W"]) for a, kind in given)


def depth_term(depth: Depth) -> DepthTerm | None:
    """Build the depth term of a frame; None where no sensor shows a surface of the person.

    A point weighs DEPTH_WEIGHT where its noise is far below BODY_SD, and less where it is noisier.
    Source: points drawn to the surface as in articulated ICP (Knoop et al. 2006; Ganapathi et al. 2012, who also keep
        the body out of space seen to be empty). Deviation: the nearest place is searched on all of the body that faces
        the sensor and has a similar normal, instead of drawing the body in every iteration.
    """
    surface, rig = depth.surface, depth.rig
    if len(surface.points) == 0:
        return None
    weight = DEPTH_WEIGHT * (BODY_SD**2 / (BODY_SD**2 + surface.sd**2))
    step = max(1, -(-int(rig.sizes.max()) // _MAP_SIDE))
    maps = np.ascontiguousarray(depth.maps[:, ::step, ::step])
    seen = surface.points, surface.normals, weight, surface.first
    return DepthTerm(*seen, rig.positions, maps, -(-rig.sizes // step), shrunk(rig.projections, step))


def shrunk(projections: Array, step: int) -> Array:
    """Scale projections (C, 3, 4) for pictures of which every step-th pixel is kept, the first one included."""
    out = np.array(projections, dtype=np.float64)
    out[:, :2] /= step
    return out
