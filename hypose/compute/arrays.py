"""Flat arrays that kernels work on, as NamedTuples: joint tree, mesh, masks, evidence of the solver.

Every field is always present, with zero rows where a cue is absent, so that one compiled solver serves all.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FIXED, BALL, HINGES = 0, 1, 2


class TreeArrays(NamedTuple):
    """Joint tree of J joints in parent-before-child order, with D degrees of freedom.

    parents: (J,) index of the parent, -1 for the root.
    kind: (J,) FIXED, BALL (three dof, rotation vector in the parent's frame) or HINGES (product of exponentials).
    dof_start: (J,) first dof of the joint (undefined for FIXED).
    dof_count: (J,) number of rotational dof.
    axes: (D, 3) unit rotation axis of each dof in the model frame at rest (direction of translation for the first
        three).
    joints: (J, 3) m, rest joint centres in the model frame; the root at the origin.
    joint_of_dof: (D,) joint that a dof moves (the root for the first six).

    In a pose q (D,), q[0:3] is the root's position; the root's rotation vector is its ball joint (dof_start 3).
    """

    parents: NDArray[np.int64]
    kind: NDArray[np.int64]
    dof_start: NDArray[np.int64]
    dof_count: NDArray[np.int64]
    axes: NDArray[np.float64]
    joints: NDArray[np.float64]
    joint_of_dof: NDArray[np.int64]


class MeshArrays(NamedTuple):
    """Closed skinned triangle mesh in the model frame at rest.

    vertices: (V, 3) m.
    faces: (F, 3) counter-clockwise seen from outside.
    edges: (E, 4) vertices a, b, and the faces left (with a->b) and right (with b->a).
    skin_index: (V, 4) joints that carry the vertex.
    skin_weight: (V, 4) weights, descending, sum 1.
    skin_count: (V,) number of non-zero weights, 1-4.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    skin_index: NDArray[np.int32]
    skin_weight: NDArray[np.float32]
    skin_count: NDArray[np.int32]


NOT_KNOWN = 1e5
"""px, value in a signed distance where the distance to the mask's edge is unknown; rows there are omitted."""

RIM = 2032
"""Largest number of outline points of the body in one view (their numbers must fit into 11 bits)."""


class PreparedMasks(NamedTuple):
    """Masks of one frame of C views, ready for `silhouette_xor`.

    masks: (C, h, w) 1 = person; smaller views are padded at the right and bottom.
    areas: (C,) number of foreground pixels.
    usable: (C,) False: the view is omitted.
    sizes: (C, 2) width and height of each view inside the padded array.
    projections: (C, 3, 4) pinhole projections of these masks' pixels.
    bits: (C, h, ceil(w / 8) + 16) packed masks, lowest bit first, zeros after the last column.
    norm: (C,) number of pixels of the whole person: the areas, or the expected areas where another person hides a part.
    hidden: (C, h, B) packed like the bits: ignored pixels, which give no information (the masks are 0 there); (0, 0,
        0): none.
    """

    masks: NDArray[np.uint8]
    areas: NDArray[np.int64]
    usable: NDArray[np.bool_]
    sizes: NDArray[np.int64]
    projections: NDArray[np.float64]
    bits: NDArray[np.uint8]
    norm: NDArray[np.float64]
    hidden: NDArray[np.uint8]


class Standing(NamedTuple):
    """Parts of a body that stand still while a limb is searched, drawn once per frame.

    bits: (C, h, B) silhouette of these parts in each of C views, one bit per pixel, packed as in
        `PreparedMasks.bits`.
    counts: (C, 2) number of pixels of this silhouette, and number of those that lie in the mask.
    """

    bits: NDArray[np.uint8]
    counts: NDArray[np.int64]


SPACING_OF_HEIGHT, OUTLINE_POINTS = 6 / 260, 130
"""Reference density of contour rows: distance of rows along the body's outline relative to the person's height in the
picture, and number of points of a mask's outline per view. Weights are per arc length, so that changing the spacing or
the number of points does not change the balance with key points and priors.
"""


class ContourTerm(NamedTuple):
    """Silhouette contours of one frame of C views, in both directions: forward rows compare points of the body's
    outline with the signed distance of the mask; reverse rows compare points of the mask's outline with the nearest
    outline point of the body. Geman-McClure cost of the distance in px.

    sdf: (C, h, w) signed distance to the mask's edge around the person, px, negative inside; NOT_KNOWN where it depends
        on ignored pixels.
    outline: (C, K, 2) points on the mask's edge, px; below -1e5: omitted.
    usable: (C,) False: the view is omitted.
    sizes: (C, 2) width, height.
    projections: (C, 3, 4) pinhole projections.
    weight: weight of one row at the reference density.
    scale_px, coarse_scale_px: scale of the distance, px: the final one, and that of the first iterations.
    row_spacing_px: distance of the forward rows along the body's outline, px.
    outline_count: K (at most 1000).
    height_px: height of the person in the picture, px (median over the usable views).
    shrunk: (C,) factor of the larger pixels in which sdf, outline, sizes and projections are; all other lengths are in
        the original pixels.
    corners: (C, 2) pixel of the image at which each view's sdf begins.
    sdf_sizes: (C, 2) width and height of the part that sdf covers; outside of this part the distance counts as
        infinite.
    """

    sdf: NDArray[np.float32]
    outline: NDArray[np.float32]
    usable: NDArray[np.bool_]
    sizes: NDArray[np.int64]
    projections: NDArray[np.float64]
    weight: float
    scale_px: float
    coarse_scale_px: float
    row_spacing_px: float
    outline_count: int
    height_px: float
    shrunk: NDArray[np.float64]
    corners: NDArray[np.int64]
    sdf_sizes: NDArray[np.int64]


class KeypointTerm(NamedTuple):
    """2D key points of one frame, with a Cauchy (Lorentzian) cost of scale 2 sd: 2 w log(1 + (r / 2 sd)^2).

    points: (C, K, 3) u px, v px, confidence (weight w of the row); points of a confidence up to min_confidence or not
        finite are omitted.
    projections: (C, 3, 4) pinhole projections of these pixels.
    joint: (K,) joint to which the point belongs.
    offset: (K, 3) position of the point on the body, m, in the joint's frame.
    scale_px: standard deviation of a point, px.
    """

    points: NDArray[np.float64]
    projections: NDArray[np.float64]
    joint: NDArray[np.int64]
    offset: NDArray[np.float64]
    scale_px: float
    min_confidence: float = 0.3


class PointArrays(NamedTuple):
    """3D points of one frame for the solver, with a Cauchy cost of their distance in m.

    points_world: (M, 3) measured points, m, world.
    weight: (M,) 0 = not seen.
    joint: (M,) joint to which the point belongs.
    offset: (M, 3) position of the point on the body, m, in the joint's frame.
    scale: (M,) standard deviation of each point, m.
    """

    points_world: NDArray[np.float64]
    weight: NDArray[np.float64]
    joint: NDArray[np.int64]
    offset: NDArray[np.float64]
    scale: NDArray[np.float64]


DEPTH_WEIGHT, DEPTH_SCALE_M, FREE_SHARE = 0.1, 0.025, 0.5
"""Weight of one point, robust scale of its distance, m, and weight of body in front of the measured surface per point,
relative to that of a point. Chosen on simulated recordings of the seeds 0 to 9 (benchmark `depth`).
"""


class DepthTerm(NamedTuple):
    """Depth maps of C sensors: points of the person's surface, and how far each sensor sees; Geman-McClure cost of the
    distance in m.

    points: (M, 3) m, world.
    normals: (M, 3) unit, outward.
    weight: (M,) weight of each point.
    first: (C + 1,) points first[c] to first[c + 1] are those of sensor c.
    eyes: (C, 3) m, positions of the sensors in the world.
    maps: (C, h, w) depth maps, m along the optical axis; 0: not known.
    sizes: (C, 2) width and height of each map, px.
    projections: (C, 3, 4) projections of the maps' pixels; the last row has unit length, so that it gives metres.
    free_weight: weight of the residuals of body parts that lie in front of the measured surface: the sum over all of
        them, per point of the sensor.
    scale_m: robust scale of the points, m.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    weight: NDArray[np.float64]
    first: NDArray[np.int64]
    eyes: NDArray[np.float64]
    maps: NDArray[np.float32]
    sizes: NDArray[np.int64]
    projections: NDArray[np.float64]
    free_weight: float = FREE_SHARE * DEPTH_WEIGHT
    scale_m: float = DEPTH_SCALE_M


class DepthArrays(NamedTuple):
    """Depth of one frame for the solve of a body.

    seen: the depth maps.
    ring_first: (V + 1,) the faces around vertex v are ring[ring_first[v]] to ring[ring_first[v + 1]].
    ring: (3 F, 3) the other two corners of such a face, in the face's order, and the row of the face at the edge to the
        first.
    """

    seen: DepthTerm
    ring_first: NDArray[np.int64]
    ring: NDArray[np.int32]


_NONE, _NO_CAMERA, _NO_PAIR = np.zeros(0, np.int64), np.zeros((0, 3, 4)), np.zeros((0, 2), np.int64)
_NO_OUTLINE = np.zeros((0, 2, 2), np.float32), np.zeros((0, 0, 2), np.float32), np.zeros(0, np.bool_)
NO_CONTOURS = ContourTerm(
    *_NO_OUTLINE, _NO_PAIR, _NO_CAMERA, 0.0, 1.0, 1.0, 1.0, 1, 1.0, np.ones(0), _NO_PAIR, _NO_PAIR
)
"""Contours of a frame without silhouettes; shared by all, because without rows nothing can be changed."""
NO_KEYPOINTS = KeypointTerm(np.zeros((0, 0, 3)), _NO_CAMERA, _NONE, np.zeros((0, 3)), 1.0)
NO_POINTS = PointArrays(np.zeros((0, 3)), np.zeros(0), _NONE, np.zeros((0, 3)), np.zeros(0))


class Cues(NamedTuple):
    """Evidence of one frame for the solver.

    contours, keypoints, points: outlines, 2D key points and 3D points; arrays of length 0 where the frame has none.
    depth: depth maps; None: there are none, and the solver is compiled without the code for depth.
    """

    contours: ContourTerm
    keypoints: KeypointTerm
    points: PointArrays
    depth: DepthArrays | None


class PriorArrays(NamedTuple):
    """Prior of a pose q: the sum of P quadratic costs 1/2 weight (q - centre)^2, and the limits of the pose.

    centre: (P, D) pose of least cost of each term, rad and m.
    weight: (P, D) inverse variances.
    lower, upper: (D,) limits of the pose.
    """

    centre: NDArray[np.float64]
    weight: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


class SolveSettings(NamedTuple):
    """Settings of the solve of one pose.

    iterations: number of iterations, coarse and fine together.
    coarse_iterations: number of them, at the start, with the coarse scale of the contours.
    tolerance: stop when no degree of freedom moves further (rad; for metres half as much).
    damping: initial damping, relative to the diagonal of the Hessian.
    tries: number of attempts at a step, each with more damping, before the solve ends (a coarse solve: goes on to the
        fine one).
    """

    iterations: int = 8
    coarse_iterations: int = 4
    tolerance: float = 1e-3
    damping: float = 1e-2
    tries: int = 4


class Workspace(NamedTuple):
    """Scratch memory of one thread for one body and one image size; the contents are undefined between calls.

    vertices, turned, uv, bounds, front, union, start, end: the arrays that the functions of coverage.py fill
    (`project_views`, `front_views`, `contours_of_any`, `contours_of_view`); uv is (V, 2, VIEWS) px.
    lines: (5, E) the edges start, end in one view: u, v, u, v, and their lengths, px.
    difference: (h + 1, B) zero between calls.
    own: flat packed silhouette of the body, B bits per row.
    rim: (3, R) points of the body's outline in one view: share of the edge, u, v px.
    rim_edge: (R,) their edges.
    work: flat, values of LANES points at a time, computed in vector lanes.
    spot: (LANES,) indices for the points in the lanes.
    sorted: (2, R) the same points sorted into bands of rows: u, v px.
    sorted_number, bands: their numbers, and where each band begins.
    rotations, centres, twists: joint frames of the pose.
    wrench_hessian: (J, 21) lower triangle of the 6 x 6 sum of each joint.
    wrench_gradient: (J, 6).
    ends: (2, M) vertices of the mesh edges on which outline points were found.
    found: (5, M) values of these points, see contours.contour_rows.
    rows: (M, 8) rows of contours and depth that wait to be summed.
    row_joints: (M,) their joints.
    lanes: (9, M + 24) the same rows in the order of their joints, one number of a row per line; the last line is
        scratch.
    place: (J + 1,) where each joint's rows begin.
    """

    vertices: NDArray[np.float32]
    turned: NDArray[np.float32]
    uv: NDArray[np.float32]
    bounds: NDArray[np.float32]
    front: NDArray[np.uint8]
    union: NDArray[np.int32]
    start: NDArray[np.int32]
    end: NDArray[np.int32]
    lines: NDArray[np.float32]
    difference: NDArray[np.int8]
    own: NDArray[np.uint8]
    rim: NDArray[np.float32]
    rim_edge: NDArray[np.int32]
    work: NDArray[np.float32]
    spot: NDArray[np.int32]
    sorted: NDArray[np.float32]
    sorted_number: NDArray[np.int32]
    bands: NDArray[np.int64]
    rotations: NDArray[np.float64]
    centres: NDArray[np.float64]
    twists: NDArray[np.float64]
    wrench_hessian: NDArray[np.float64]
    wrench_gradient: NDArray[np.float64]
    ends: NDArray[np.int32]
    found: NDArray[np.float32]
    rows: NDArray[np.float64]
    row_joints: NDArray[np.int32]
    lanes: NDArray[np.float64]
    place: NDArray[np.int64]


_Arrays = TypeVar("_Arrays", bound=NamedTuple)


def plain(a: ArrayLike, dtype: type) -> NDArray:
    """Convert an array to a type, contiguous and writable, because numba compiles a kernel again for every layout
    and for read-only arrays.
    """
    if type(a) is np.ndarray and a.dtype == dtype and a.flags.carray:  # the usual case
        return a
    return np.require(a, dtype, ["C", "W", "A"])


def tidy(arrays: _Arrays) -> _Arrays:
    """Make all arrays of a NamedTuple contiguous and writable, because numba compiles a kernel again for every other
    layout.
    """
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
    """Prepare masks for the scorer.

    masks: (C, h, w) non-zero = person.
    usable: (C,) False: the view is omitted.
    sizes: (C, 2) width and height of each view.
    projections: (C, 3, 4) pinhole projections.
    ignored: (C, h, w) 1 at pixels that give no information, neither for nor against a body there; None: none.
    norm: (C,) number of pixels of the whole person; None, and where NaN: the masks' areas.
    """
    m = np.ascontiguousarray(masks)
    if m.dtype != np.uint8:
        m = (m != 0).view(np.uint8)
    hidden = _NO_BITS
    if ignored is not None:
        m, hidden = np.greater(m, ignored).view(np.uint8), _packed(ignored)
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
    )


_NO_BITS = np.zeros((0, 0, 0), dtype=np.uint8)


def _packed(masks: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pack masks (C, h, w) of 0 and 1 as PreparedMasks.bits: lowest bit first, 16 bytes of zeros after each row."""
    packed = np.packbits(masks, axis=2, bitorder="little")
    bits = np.zeros((*packed.shape[:2], packed.shape[2] + 16), dtype=np.uint8)
    bits[:, :, : packed.shape[2]] = packed
    return bits
