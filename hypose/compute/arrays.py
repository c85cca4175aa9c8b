"""Flat arrays that kernels work on, as NamedTuples that numba takes: joint tree, mesh, masks, evidence of the solver.

Every field is always present, with zero rows when a cue is absent, so that one compiled solver serves all.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FIXED, BALL, HINGES = 0, 1, 2


class TreeArrays(NamedTuple):
    """Joint tree. J joints in parent-before-child order, D degrees of freedom; q[0:3] is the root's position, the
    root's rotation vector is its ball joint (dof_start 3)."""

    parents: NDArray[np.int64]
    """(J,) parent index, -1 for the root."""
    kind: NDArray[np.int64]
    """(J,) FIXED, BALL (three dof, rotation vector in the parent's frame) or HINGES (product of exponentials)."""
    dof_start: NDArray[np.int64]
    """(J,) first dof of the joint (undefined for FIXED)."""
    dof_count: NDArray[np.int64]
    """(J,) number of rotational dof."""
    axes: NDArray[np.float64]
    """(D, 3) unit rotation axis of a dof in the model frame at rest (translation direction for the first three)."""
    joints: NDArray[np.float64]
    """(J, 3) rest joint centres in the model frame, m; the root at the origin."""
    joint_of_dof: NDArray[np.int64]
    """(D,) joint that a dof moves (the root for the first six)."""


class MeshArrays(NamedTuple):
    """Closed skinned triangle mesh in the model frame at rest."""

    vertices: NDArray[np.float32]
    """(V, 3) m."""
    faces: NDArray[np.int32]
    """(F, 3) counter-clockwise seen from outside."""
    edges: NDArray[np.int32]
    """(E, 4): vertices a, b and the faces left (holds a->b) and right (holds b->a)."""
    skin_index: NDArray[np.int32]
    """(V, 4) joints that carry the vertex."""
    skin_weight: NDArray[np.float32]
    """(V, 4) weights, descending, sum 1."""
    skin_count: NDArray[np.int32]
    """(V,) number of non-zero weights, 1-4."""


NOT_KNOWN = 1e5
"""px, in a signed distance: the distance to the mask's edge is unknown there, and rows that fall there are left out"""

RIM = 2032
"""most outline points of the body in one view (their numbers must fit 11 bits)"""


class PreparedMasks(NamedTuple):
    """The masks of one frame, ready for `silhouette_xor`."""

    masks: NDArray[np.uint8]
    """(C, h, w) 1 = person; smaller views are padded at the right and bottom."""
    areas: NDArray[np.int64]
    """(C,) foreground pixels."""
    usable: NDArray[np.bool_]
    """(C,) False: the view is left out."""
    sizes: NDArray[np.int64]
    """(C, 2) each view's own width and height inside the padded array."""
    projections: NDArray[np.float64]
    """(C, 3, 4) pinhole projections of these masks' pixels."""
    bits: NDArray[np.uint8]
    """(C, h, ceil(w / 8) + 16) the masks packed, lowest bit first, zeros after the last column."""
    norm: NDArray[np.float64]
    """(C,) pixels that count as the whole person: the areas, or the expected ones where another person hides a part."""
    hidden: NDArray[np.uint8]
    """(C, h, B) packed like the bits: pixels that say nothing (the masks are 0 there); (0, 0, 0): none."""
    open_masks: NDArray[np.uint8]
    """(C, h, w) the masks, and 1 where pixels say nothing; the masks themselves when there are none."""


class Standing(NamedTuple):
    """What of a body stands still while a limb is searched, drawn once per frame."""

    bits: NDArray[np.uint8]
    """(C, h, B) its silhouettes, packed like the masks' bits."""
    counts: NDArray[np.int64]
    """(C, 2) its pixels, and those of them in the mask."""


class ContourArrays(NamedTuple):
    """Two-way contour distances. Forward rows: points of the body's outline against the signed distance of the mask;
    reverse rows: points of the mask's outline against the nearest outline point of the body."""

    sdf: NDArray[np.float32]
    """(C, h, w) signed distance to the mask's edge, px, negative inside, around the person; NOT_KNOWN where it
    depends on pixels that say nothing."""
    outline: NDArray[np.float32]
    """(C, K, 2) points on the mask's edge, px; beyond -1e5: left out."""
    usable: NDArray[np.bool_]
    """(C,)"""
    sizes: NDArray[np.int64]
    """(C, 2) width, height."""
    projections: NDArray[np.float64]
    """(C, 3, 4)"""
    forward_weight: float
    """weight of one forward row"""
    reverse_weight: float
    """weight of one reverse row"""
    scale: float
    """Geman-McClure scale, px"""
    coarse_scale: float
    """the same for the first iterations"""
    spacing: float
    """px between outline points of the body (candidates for the reverse rows)"""
    stride: int
    """every stride-th of them makes a forward row"""
    shrunk: NDArray[np.float64]
    """(C,) pixels of the lengths above (weights, scales, spacing) per pixel of sdf, outline and projections"""
    corners: NDArray[np.int64]
    """(C, 2) pixel of the image at which each view's sdf begins"""
    sdf_sizes: NDArray[np.int64]
    """(C, 2) its width and height; outside the distance counts as infinite"""


class KeypointArrays(NamedTuple):
    """2D key points; Cauchy cost of the distance in px."""

    points: NDArray[np.float64]
    """(C, K, 3) u, v, weight (0 = not seen)"""
    projections: NDArray[np.float64]
    """(C, 3, 4)"""
    joint: NDArray[np.int64]
    """(K,)"""
    offset: NDArray[np.float64]
    """(K, 3) m in the joint's frame"""
    scale: float
    """px, 1 sd"""


class PointArrays(NamedTuple):
    """3D points; Cauchy cost of the distance in m."""

    points_world: NDArray[np.float64]
    """(M, 3) m"""
    weight: NDArray[np.float64]
    """(M,) 0 = not seen"""
    joint: NDArray[np.int64]
    """(M,)"""
    offset: NDArray[np.float64]
    """(M, 3) m in the joint's frame"""
    scale: NDArray[np.float64]
    """(M,) m, 1 sd"""


class DepthArrays(NamedTuple):
    """Depth maps of sensors C: points of the person's surface, and how far each sensor sees. Geman-McClure cost of the
    distance in m."""

    points: NDArray[np.float64]
    """(M, 3) m, world"""
    normals: NDArray[np.float64]
    """(M, 3) unit, outward"""
    weight: NDArray[np.float64]
    """(M,)"""
    first: NDArray[np.int64]
    """(C + 1,): points first[c] to first[c + 1] are those of sensor c"""
    eyes: NDArray[np.float64]
    """(C, 3) m, world: where the sensors are"""
    maps: NDArray[np.float32]
    """(C, h, w) m along the optical axis; 0: not known"""
    sizes: NDArray[np.int64]
    """(C, 2) width, height"""
    projections: NDArray[np.float64]
    """(C, 3, 4) of the maps' pixels; the last row has unit length, so that it tells metres"""
    ring_first: NDArray[np.int64]
    """(V + 1,): ring[ring_first[v]] and on, to that of v + 1, are the faces around vertex v"""
    ring: NDArray[np.int32]
    """(3 F, 3) their other corners, in the face's order, and the row of the face at the edge to the first"""
    scale: float
    """m, Geman-McClure scale of the points"""
    free_weight: float
    """weight of the rows of body before what was seen, all of them together, per point of the sensor"""
    free_scale: float
    """m"""
    slack: float
    """m before what was seen that cost nothing"""


def _no_contours() -> ContourArrays:
    f4 = np.float32
    empty = np.zeros((0, 2, 2), f4), np.zeros((0, 0, 2), f4), np.zeros(0, np.bool_), np.zeros((0, 2), np.int64)
    return ContourArrays(*empty, np.zeros((0, 3, 4)), 0.0, 0.0, 1.0, 1.0, 1.0, 1, np.ones(0), empty[3], empty[3])


NO_CONTOURS = _no_contours()
"""Of a frame without silhouettes; shared by all, for without a row there is nothing that anybody could change."""
NO_KEYPOINTS = KeypointArrays(np.zeros((0, 0, 3)), np.zeros((0, 3, 4)), np.zeros(0, np.int64), np.zeros((0, 3)), 1.0)
NO_POINTS = PointArrays(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))


class Cues(NamedTuple):
    """What a solve of one frame takes of its evidence. depth: None is compiled by itself."""

    contours: ContourArrays
    keypoints: KeypointArrays
    points: PointArrays
    depth: DepthArrays | None


class PriorArrays(NamedTuple):
    """Sum of quadratics 1/2 weight (q - centre)^2 and the limits."""

    centre: NDArray[np.float64]
    """(P, D)"""
    weight: NDArray[np.float64]
    """(P, D)"""
    lower: NDArray[np.float64]
    """(D,)"""
    upper: NDArray[np.float64]
    """(D,)"""


class SolveLimits(NamedTuple):
    """Settings of one solve."""

    iterations: int
    """all, the coarse ones included"""
    coarse_iterations: int
    tolerance: float
    """stop when no dof moves further (rad; twice the metres)"""
    damping: float
    """initial Levenberg-Marquardt damping relative to the diagonal"""
    tries: int
    """of a step, each with more damping, before the solve is given up (the coarse iterations: before the fine ones)"""


class Workspace(NamedTuple):
    """Scratch memory of one thread for one body and one image size; contents mean nothing between calls."""

    vertices: NDArray[np.float32]
    turned: NDArray[np.float32]
    uv: NDArray[np.float32]
    """(V, 2, VIEWS) px, and so on: see coverage.py"""
    bounds: NDArray[np.float32]
    front: NDArray[np.uint8]
    union: NDArray[np.int32]
    start: NDArray[np.int32]
    end: NDArray[np.int32]
    lines: NDArray[np.float32]
    """(5, E) the edges start, end in one view: u, v, u, v, and their lengths px"""
    difference: NDArray[np.int8]
    """(h + 1, B) zero between calls"""
    own: NDArray[np.uint8]
    """flat, packed, B bits a row"""
    rim: NDArray[np.float32]
    """(3, R) points of the body's outline in one view: share of the edge, u, v px"""
    rim_edge: NDArray[np.int32]
    work: NDArray[np.float32]
    """flat, of LANES points at a time: values computed from them in vector lanes"""
    spot: NDArray[np.int32]
    """(LANES,)"""
    sorted: NDArray[np.float32]
    """(2, R) the same points in bands of rows: u, v px"""
    sorted_number: NDArray[np.int32]
    bands: NDArray[np.int64]
    rotations: NDArray[np.float64]
    centres: NDArray[np.float64]
    twists: NDArray[np.float64]
    wrench_hessian: NDArray[np.float64]
    """(J, 21) lower triangle of the 6 x 6 sum of each joint"""
    wrench_gradient: NDArray[np.float64]
    """(J, 6)"""
    ends: NDArray[np.int32]
    """(2, M) vertices of the mesh edges on which outline points were found"""
    found: NDArray[np.float32]
    """(5, M) what was found there, see contours.contour_rows"""
    rows: NDArray[np.float64]
    """(M, 8) rows of contours and depth that wait to be summed"""
    row_joints: NDArray[np.int32]
    """(M,)"""
    lanes: NDArray[np.float64]
    """(9, M + 24) the same in the order of their joints, a number of a row to a line; the last line is scratch"""
    place: NDArray[np.int64]
    """(J + 1,)"""


_Arrays = TypeVar("_Arrays", bound=NamedTuple)


def plain(a: ArrayLike, dtype: type) -> NDArray:
    """Return the array, contiguous and writable: numba compiles a kernel again for every layout and for read-only
    arrays."""
    if type(a) is np.ndarray and a.dtype == dtype and a.flags.carray:  # as nearly always
        return a
    return np.require(a, dtype, ["C", "W", "A"])


def tidy(arrays: _Arrays) -> _Arrays:
    """Return the same for all arrays of a tuple."""
    for a in arrays:
        if type(a) is np.ndarray and not a.flags.carray:
            break
    else:
        return arrays
    return type(arrays)(*(np.require(a, None, ["C", "W", "A"]) if isinstance(a, np.ndarray) else a for a in arrays))


def prepare_masks(
    masks: ArrayLike,
    usable: ArrayLike,
    sizes: ArrayLike,
    projections: ArrayLike,
    ignored: NDArray[np.uint8] | None = None,
    norm: ArrayLike | None = None,
) -> PreparedMasks:
    """Masks (C, h, w) non-zero = person, usable (C,), sizes (C, 2) width and height, pinhole projections (C, 3, 4).

    ignored (C, h, w) 0 and 1: pixels that say nothing, neither for nor against a body there.
    norm (C,) px: what counts as the whole person (default, and where NaN: the masks' areas).
    """
    m = np.ascontiguousarray(masks)
    if m.dtype != np.uint8:
        m = (m != 0).view(np.uint8)
    seen, hidden = m, _NO_BITS
    if ignored is not None:
        m, seen, hidden = np.greater(m, ignored).view(np.uint8), m | ignored, _packed(ignored)
    areas = np.array([np.count_nonzero(view) for view in m], dtype=np.int64)
    whole = areas.astype(np.float64)
    if norm is not None:
        whole = np.where(np.isnan(norm), whole, norm)
    return PreparedMasks(
        m,
        areas,
        plain(usable, np.bool_),
        plain(sizes, np.int64),
        plain(projections, np.float64),
        _packed(m),
        whole,
        hidden,
        seen,
    )


_NO_BITS = np.zeros((0, 0, 0), dtype=np.uint8)


def _packed(masks: NDArray[np.uint8]) -> NDArray[np.uint8]:
    packed = np.packbits(masks, axis=2, bitorder="little")
    bits = np.zeros((*packed.shape[:2], packed.shape[2] + 16), dtype=np.uint8)
    bits[:, :, : packed.shape[2]] = packed
    return bits
