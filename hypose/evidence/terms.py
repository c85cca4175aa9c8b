"""Evidence: a cue of one frame, prepared once for all its uses, and the terms that solvers take.

A solver takes any number of terms; a search computes the energy of poses. A user's own cue is a `PointTerm`, a
`RowTerm`, or both with an energy (hypose.evidence.cues.OwnEvidence).
Source: two-way contour distances with a robust weight as in the silhouette trackers of Alcoverro 2014, chapter 4, and
    Gall et al. 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.compute.arrays import (
    DEPTH_WEIGHT,
    OUTLINE_POINTS,
    SPACING_OF_HEIGHT,
    ContourTerm,
    DepthTerm,
    KeypointTerm,
    PointArrays,
    Standing,
)
from hypose.errors import EvidenceError, InputError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Silhouettes
from hypose.evidence.outlines import SMALLEST, WORKING_HEIGHT, shrunk_projection
from hypose.geometry import Array

SCALE_OF_HEIGHT = 2.5 / 260


class Limb(NamedTuple):
    """Description of poses that differ in one limb only; all other joints are as in the last pose.

    moving: (J,) true for the joints that turn.
    rest: silhouettes of the parts that stay, where they are drawn already.
    """

    moving: NDArray[np.bool_]
    rest: Standing | None = None


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
class PointTerm:
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
class RowTerm:
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


Term = ContourTerm | KeypointTerm | PointTerm | DepthTerm | RowTerm
"""Residuals of one cue in one frame, for solvers."""


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
    outline_count: int = OUTLINE_POINTS,
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
    kept = (outline_count, working_height) == (OUTLINE_POINTS, WORKING_HEIGHT)
    made = silhouettes.outlines if kept else silhouettes.outlined(outline_count, working_height)
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
    height = float(median(made.extent[usable].tolist()))
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


BODY_SD = 0.012
"""m: usual distance of a person's surface from that of a body of the right size: clothes, folds, flesh"""
_MAP_SIDE = 160
"""px: largest side of the maps in which the body is looked up; more is not needed"""


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
