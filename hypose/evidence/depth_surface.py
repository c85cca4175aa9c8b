"""Build the solver's term of depth maps: points on the body's surface, and space that is empty.

Source: points drawn to the surface as in articulated ICP (Knoop et al. 2006; Ganapathi et al. 2012, who also keep the
    body out of space seen to be empty). Deviation: the nearest place is searched on all of the body that faces the
    sensor and has a similar normal, instead of drawing the body in every iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute.arrays import DepthArrays
from hypose.errors import InputError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.terms import Term
from hypose.geometry import Array

BODY_SD = 0.012
"""m: usual distance of a person's surface from that of a body of the right size: clothes, folds, flesh"""
WEIGHT, SCALE_M = 0.1, 0.025
"""Weight of one point, and robust scale of its distance, m. Chosen on simulated recordings of the seeds 0 to 9
(benchmark `depth`)."""
FREE_SHARE, FREE_SCALE_M, SLACK_M = 0.5, 0.06, 0.02
_MAP_SIDE = 160
"""px: largest side of the maps in which the body is looked up; more is not needed"""


@dataclass(frozen=True)
class DepthTerm(Term):
    """Term of depth in the solver; built by `depth_term`.

    points, normals: (M, 3) in the world, m; weight: (M,); first: (C + 1,) ranges of each sensor's points.
    eyes: (C, 3) positions of the sensors, m.
    maps: (C, h, w) float32 m, 0: unknown; sizes: (C, 2) width, height; projections: (C, 3, 4).
    scale_m: Geman-McClure scale of a point's distance.
    free_share: weight, per point, of body in front of what was seen; free_scale_m: its scale; slack_m: m in front that
        cost nothing.
    Raises: InputError where the shapes do not fit or a scale is not positive.
    """

    points: Array
    normals: Array
    weight: Array
    first: NDArray[np.int64]
    eyes: Array
    maps: NDArray[np.float32]
    sizes: NDArray[np.int64]
    projections: Array
    scale_m: float = SCALE_M
    free_share: float = FREE_SHARE * WEIGHT
    free_scale_m: float = FREE_SCALE_M
    slack_m: float = SLACK_M

    def __post_init__(self) -> None:
        m, c = len(self.points), len(self.eyes)
        shapes = self.points.shape, self.normals.shape, self.weight.shape, self.first.shape, self.projections.shape
        if shapes != ((m, 3), (m, 3), (m,), (c + 1,), (c, 3, 4)) or len(self.maps) != c:
            raise InputError(
                f"DepthTerm of {c} sensors needs points and normals (M, 3), weight (M,), first ({c + 1},), projections "
                f"({c}, 3, 4) and {c} maps, got {shapes} and {len(self.maps)} maps."
            )
        if not (self.scale_m > 0 and self.free_scale_m > 0):
            raise InputError("DepthTerm.scale_m and free_scale_m must be positive.")

    def arrays(self, body: Body) -> DepthArrays | None:
        """Build the solver's arrays; None where there are no points."""
        scales = float(self.scale_m), float(self.free_share), float(self.free_scale_m), float(self.slack_m)
        return DepthArrays._make((*self._flat, *body.coarse.rings, *scales)) if len(self.points) else None

    @cached_property
    def _flat(self) -> tuple[NDArray, ...]:
        """The arrays in the solver's order, built once for all solves of a frame."""
        given: list[tuple[NDArray, type]] = [(self.points, np.float64), (self.normals, np.float64)]
        given += [(self.weight, np.float64), (self.first, np.int64), (self.eyes, np.float64), (self.maps, np.float32)]
        given += [(self.sizes, np.int64), (self.projections, np.float64)]
        return tuple(np.require(a, kind, ["C", "W"]) for a, kind in given)


def depth_term(depth: Depth, weight: float = WEIGHT, scale_m: float = SCALE_M) -> DepthTerm | None:
    """Build the depth term of a frame; None where no sensor shows a surface of the person.

    weight: of a point whose noise is far below BODY_SD; noisier points weigh less.
    """
    surface = depth.surface
    if len(surface.points) == 0:
        return None
    sure = BODY_SD**2 / (BODY_SD**2 + surface.sd**2)
    rig = depth.rig
    step = max(1, -(-int(rig.sizes.max()) // _MAP_SIDE))
    maps = np.ascontiguousarray(depth.maps[:, ::step, ::step])
    return DepthTerm(
        surface.points,
        surface.normals,
        weight * sure,
        surface.first,
        rig.positions,
        maps,
        -(-rig.sizes // step),
        shrunk(rig.projections, step),
        scale_m,
        FREE_SHARE * weight,
    )


def shrunk(projections: Array, step: int) -> Array:
    """Scale projections (C, 3, 4) for pictures of which every step-th pixel is kept, the first one included."""
    out = np.array(projections, dtype=np.float64)
    out[:, :2] /= step
    return out
