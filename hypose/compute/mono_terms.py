"""Settings and flat arrays of monocular tracking, as NamedTuples for kernels; hypose.tracking.monocular makes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays

GAUSSIAN, LORENTZIAN, LECLERC = 0, 1, 2
"""Forms of a robust loss."""


class MonoModel(NamedTuple):
    """Body with the degrees of freedom that are estimated.

    tree, mesh: of the body.
    active: (A,) dof that are estimated.
    slot: (D,) place of a dof among them, -1 for the others.
    moving_faces: indices of the faces that they move.
    still_faces: indices of the others, drawn once per search.
    moving_vertices: (V,) vertices of which they carry more than half.
    projection: (3, 4) pinhole.
    """

    tree: TreeArrays
    mesh: MeshArrays
    active: NDArray[np.int64]
    slot: NDArray[np.int64]
    moving_faces: NDArray[np.int32]
    still_faces: NDArray[np.int32]
    moving_vertices: NDArray[np.bool_]
    projection: NDArray[np.float64]


class EdgeSettings(NamedTuple):
    """Settings of the edge term, which compares contours with image edges.

    form: of the loss: GAUSSIAN, LORENTZIAN or LECLERC.
    sigma_px: its scale, px.
    height: nu, the cost of one independent sample that finds no edge.
    sample_px: px of contour per independent sample.
    window_px: px that are searched along the normal on either side.
    spacing_px: distance of the contour's nodes, px.
    strength: quantile of the image gradient that counts as a full edge.
    threshold: weakest edge that counts, as a share of a full one.
    smoothing_px: standard deviation of the smoothing of the image before, px.
    background: expected cost of a node where no body is, as a share of nu, subtracted from each node. Why: a contour
        that fits worse than by chance would cost less the shorter it is, so with too low a value limbs hide.
    occluded: k of equation (5), cost of an occluded node as a share of nu; equal to background, hiding has no effect.
    motion_boundaries: whether edges are weighted by motion boundaries.
    boundary_floor: weight of an edge where nothing moves.
    coarse_factor: factor on sigma in the first iterations.
    """

    form: int = LECLERC
    sigma_px: float = 3.0
    height: float = 5.0
    sample_px: float = 8.0
    window_px: int = 14
    spacing_px: float = 6.0
    strength: float = 0.93
    threshold: float = 0.08
    smoothing_px: float = 1.2
    background: float = 0.8
    occluded: float = 0.8
    motion_boundaries: bool = True
    boundary_floor: float = 0.1
    coarse_factor: float = 2.0


class FlowSettings(NamedTuple):
    """Settings of the flow term, which compares inner nodes with optical flow.

    use: False leaves the term out.
    form, sigma_px, height: of the loss, as for edges.
    area_px: side of the square that makes one independent sample, px.
    spacing_px: distance of the grid's nodes, px.
    consistency_px: nodes with a larger forward-backward error are outliers.
    """

    use: bool = True
    form: int = LORENTZIAN
    sigma_px: float = 1.2
    height: float = 0.1
    area_px: float = 14.0
    spacing_px: float = 8.0
    consistency_px: float = 1.0


class CueSettings(NamedTuple):
    """Settings of silhouettes, 2D points (key points, clicked joints) and the floor.

    silhouette_height, silhouette_form, silhouette_sigma_px: of the loss, as for edges; height 0: not used.
    point_weight: factor on all points; 0: not used. The points carry their own scales.
    point_form: form of the loss of points.
    floor_sd_m: usual distance of the lower sole from a known floor, m.
    """

    silhouette_height: float = 2.0
    silhouette_form: int = LORENTZIAN
    silhouette_sigma_px: float = 4.0
    point_weight: float = 1.0
    point_form: int = LORENTZIAN
    floor_sd_m: float = 0.05


class EdgeArrays(NamedTuple):
    """Evidence of the edge term.

    field: (h, w, 2) image gradient in units of a full edge, weighted by the motion boundaries.
    use: False: the term is omitted.
    settings: of the term.
    """

    field: NDArray[np.float32]
    use: bool
    settings: EdgeSettings


class FlowArrays(NamedTuple):
    """Evidence of the flow term.

    flow: (h, w, 2) px from the previous picture to this one, of a part of the image; (0, 0, 2) where there is none.
    error: (h, w) px, forward-backward.
    corner: (2,) x, y of the part's first pixel.
    settings: of the term.
    """

    flow: NDArray[np.float32]
    error: NDArray[np.float32]
    corner: NDArray[np.int64]
    settings: FlowSettings


class MaskArrays(NamedTuple):
    """Evidence of the outer contour against a silhouette, in both directions.

    distance: (h, w) signed distance to the mask's edge, px, negative inside; (0, 0): the term is omitted.
    outline: (K, 2) px, points of the mask's outline.
    outline_share: px of outline for which one of these points stands.
    sample_px: px of contour that count as one sample.
    """

    distance: NDArray[np.float32]
    outline: NDArray[np.float32]
    outline_share: float
    sample_px: float


class MarkArrays(NamedTuple):
    """Evidence of 2D points: key points and clicked joints.

    pixels: (P, 2).
    weight: (P,) 0: not seen.
    joint: (P,) joint to which the point belongs.
    offset: (P, 3) m in the joint's frame.
    scale: (P,) px, 1 sd.
    """

    pixels: NDArray[np.float64]
    weight: NDArray[np.float64]
    joint: NDArray[np.int64]
    offset: NDArray[np.float64]
    scale: NDArray[np.float64]


class SphereArrays(NamedTuple):
    """Spheres in the parts of the body that must not intersect.

    joint: (S,) joint of each sphere.
    offset: (S, 3) m, centre in the joint's frame.
    pairs: (P, 2) spheres of parts that can meet.
    apart: (P,) m, distance of their centres below which the prior acts.
    weight: 1 / m^2.
    """

    joint: NDArray[np.int64]
    offset: NDArray[np.float64]
    pairs: NDArray[np.int64]
    apart: NDArray[np.float64]
    weight: float


class FloorArrays(NamedTuple):
    """Points of the soles against a level floor.

    joint: (F,) joint of each point.
    offset: (F, 3) m in the joint's frame.
    height: m, of the floor in the world.
    scale: m, 1 sd.
    weight: 0: there is no floor.
    """

    joint: NDArray[np.int64]
    offset: NDArray[np.float64]
    height: float
    scale: float
    weight: float


class MonoPriors(NamedTuple):
    """Quadratics 1/2 weight (q - centre)^2 over the active dof, and the limits.

    centre: (2, A) the prediction, the rest posture.
    weight: (2, A).
    lower, upper: (A,) limits.
    longest: (A,) longest Newton step.
    """

    centre: NDArray[np.float64]
    weight: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    longest: NDArray[np.float64]


class MonoProblem(NamedTuple):
    """Evidence and priors of one search for a pose.

    model: the body.
    edges, flow, mask, marks, spheres, floor: the terms of the evidence.
    cues: settings of silhouettes and points.
    priors: quadratics and limits.
    second_order: whether Newton steps use the second derivative of the losses.
    """

    model: MonoModel
    edges: EdgeArrays
    flow: FlowArrays
    mask: MaskArrays
    marks: MarkArrays
    spheres: SphereArrays
    floor: FloorArrays
    cues: CueSettings
    priors: MonoPriors
    second_order: bool


class MonoWorkspace(NamedTuple):
    """Scratch memory of one thread; the contents are undefined between calls.

    rotations, centres, twists: joint frames of the pose.
    vertices: (V, 3) about the root.
    uvz: (V, 3) pixel and depth.
    inverse: (V,) 1 / depth, 0 where that is too near.
    front: (F,) 1: seen from outside.
    depth: (h, w) z-buffer, 1/m, 0 = nothing.
    still: (h, w) the same of the parts that do not move.
    node_ends: (N, 2) vertices between which a contour node lies.
    nodes: (N, 8): place 0..1, u, v, normal u, v, length px, seen, outer.
    flow_faces: (M, 3) vertices around an inner node.
    flow_nodes: (M, 5): weights of the second and third vertex, target u, v, weight.
    row_vertices: (R, 3) vertices, -1 where fewer.
    row_values: (R, 8): shares of the vertices, direction in the world, first and second derivative along it.
    wrench: (J, 6) sums of a row per joint, zero between rows.
    marked: (J,) 1: the joint's wrench is not zero.
    columns, entries: (A,) active dof of a row, and its derivatives.
    counts: (7,): contour nodes seen, of these with an edge, edges, occluded, facing away, flow nodes, rows.
    """

    rotations: NDArray[np.float64]
    centres: NDArray[np.float64]
    twists: NDArray[np.float64]
    vertices: NDArray[np.float32]
    uvz: NDArray[np.float32]
    inverse: NDArray[np.float32]
    front: NDArray[np.uint8]
    depth: NDArray[np.float32]
    still: NDArray[np.float32]
    node_ends: NDArray[np.int32]
    nodes: NDArray[np.float64]
    flow_faces: NDArray[np.int32]
    flow_nodes: NDArray[np.float64]
    row_vertices: NDArray[np.int32]
    row_values: NDArray[np.float64]
    wrench: NDArray[np.float64]
    marked: NDArray[np.uint8]
    columns: NDArray[np.int64]
    entries: NDArray[np.float64]
    counts: NDArray[np.int64]
