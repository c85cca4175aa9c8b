"""Flat arrays of monocular tracking, as NamedTuples for kernels; they are made by hypose.tracking.monocular."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays

GAUSSIAN, LORENTZIAN, LECLERC = 0, 1, 2


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


class EdgeArrays(NamedTuple):
    """Contour nodes against image edges; settings in tracking.monocular.settings.EdgeSettings.

    field: (h, w, 2) image gradient in units of a full edge, weighted by the motion boundaries.
    weight: 0: the term is omitted.
    form: loss: GAUSSIAN, LORENTZIAN or LECLERC.
    sigma, coarse_sigma: scales of the loss in the fine and the coarse descent, px.
    height: height of the loss.
    sample: px of contour that count as one sample.
    window: px searched along the normal on either side.
    spacing: px between nodes.
    threshold: weakest edge that counts, as a share of a full one.
    background, occluded: expected cost of a place without a body, and cost of an occluded node, as shares of the
        height.
    """

    field: NDArray[np.float32]
    weight: float
    form: int
    sigma: float
    coarse_sigma: float
    height: float
    sample: float
    window: int
    spacing: float
    threshold: float
    background: float
    occluded: float


class FlowArrays(NamedTuple):
    """Inner nodes against optical flow; settings in tracking.monocular.settings.FlowSettings.

    flow: (h, w, 2) px from the previous picture to this one, of a part of the image; (0, 0, 2) where there is none.
    error: (h, w) px, forward-backward.
    corner: (2,) x, y of the part's first pixel.
    form: loss: GAUSSIAN, LORENTZIAN or LECLERC.
    sigma: scale of the loss, px.
    height: height of the loss.
    area: side of the square that counts as one sample, px.
    spacing: px between nodes.
    consistency: px; nodes with a larger error are outliers.
    """

    flow: NDArray[np.float32]
    error: NDArray[np.float32]
    corner: NDArray[np.int64]
    form: int
    sigma: float
    height: float
    area: float
    spacing: float
    consistency: float


class MaskArrays(NamedTuple):
    """Outer contour against a silhouette, in both directions.

    distance: (h, w) signed distance to the mask's edge, px, negative inside; (0, 0) where there is none.
    outline: (K, 2) px, points of the mask's outline.
    outline_share: px of outline for which one of these points stands.
    height: height of the loss; 0: the term is omitted.
    form: loss: GAUSSIAN, LORENTZIAN or LECLERC.
    sigma: scale of the loss, px.
    sample: px of contour that count as one sample.
    """

    distance: NDArray[np.float32]
    outline: NDArray[np.float32]
    outline_share: float
    height: float
    form: int
    sigma: float
    sample: float


class MarkArrays(NamedTuple):
    """2D points: key points and clicked joints.

    pixels: (P, 2).
    weight: (P,) 0: not seen.
    joint: (P,) joint to which the point belongs.
    offset: (P, 3) m in the joint's frame.
    scale: (P,) px, 1 sd.
    form: loss: GAUSSIAN, LORENTZIAN or LECLERC.
    """

    pixels: NDArray[np.float64]
    weight: NDArray[np.float64]
    joint: NDArray[np.int64]
    offset: NDArray[np.float64]
    scale: NDArray[np.float64]
    form: int


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
    wrench: (J, 6).
    marked: (J,).
    counts: (8,): contour nodes seen, of these with an edge, edges, occluded, facing away, flow nodes, rows,
        evaluations.
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
    counts: NDArray[np.int64]
