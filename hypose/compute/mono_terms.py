"""The flat arrays of monocular tracking, as NamedTuples that numba takes; made by hypose.tracking.monocular."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute.arrays import MeshArrays, TreeArrays

GAUSSIAN, LORENTZIAN, LECLERC = 0, 1, 2


class MonoModel(NamedTuple):
    """What moves: the body's tree and mesh, and which dof are estimated."""

    tree: TreeArrays
    mesh: MeshArrays
    active: NDArray[np.int64]
    """(A,) dof that are estimated"""
    slot: NDArray[np.int64]
    """(D,) place of a dof among them, -1 for the others"""
    moving_faces: NDArray[np.int32]
    """faces that they move"""
    still_faces: NDArray[np.int32]
    """the others, drawn once per search"""
    moving_vertices: NDArray[np.bool_]
    """(V,) vertices of which they carry more than half"""
    projection: NDArray[np.float64]
    """(3, 4) pinhole"""


class EdgeArrays(NamedTuple):
    """Contour nodes against edges. See hypose.tracking.monocular.settings.EdgeSettings."""

    field: NDArray[np.float32]
    """(h, w, 2) image gradient in units of a full edge, weighted by the motion boundaries"""
    weight: float
    """0: the term is left out"""
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
    """Inner nodes against flow. See hypose.tracking.monocular.settings.FlowSettings."""

    flow: NDArray[np.float32]
    """(h, w, 2) px from the previous picture to this one, of a part of the image; (0, 0, 2) where there is none"""
    error: NDArray[np.float32]
    """(h, w) px, forward-backward"""
    corner: NDArray[np.int64]
    """(2,) x, y of the part's first pixel"""
    form: int
    sigma: float
    height: float
    area: float
    spacing: float
    consistency: float


class MaskArrays(NamedTuple):
    """Outer contour against a silhouette, both ways."""

    distance: NDArray[np.float32]
    """(h, w) signed distance to the mask's edge, px, negative inside; (0, 0) where there is none"""
    outline: NDArray[np.float32]
    """(K, 2) px"""
    outline_share: float
    """px of outline that one of these points stands for"""
    height: float
    """0: the term is left out"""
    form: int
    sigma: float
    sample: float


class MarkArrays(NamedTuple):
    """2D points: key points and clicked joints."""

    pixels: NDArray[np.float64]
    """(P, 2)"""
    weight: NDArray[np.float64]
    """(P,) 0: not seen"""
    joint: NDArray[np.int64]
    """(P,)"""
    offset: NDArray[np.float64]
    """(P, 3) m"""
    scale: NDArray[np.float64]
    """(P,) px"""
    form: int


class SphereArrays(NamedTuple):
    """Spheres in the body's parts that must not run into each other."""

    joint: NDArray[np.int64]
    """(S,)"""
    offset: NDArray[np.float64]
    """(S, 3) m"""
    pairs: NDArray[np.int64]
    """(P, 2) spheres of parts that can meet"""
    apart: NDArray[np.float64]
    """(P,) m, distance of their centres below which the prior acts"""
    weight: float
    """1 / m^2"""


class FloorArrays(NamedTuple):
    """Points of the soles against a level floor."""

    joint: NDArray[np.int64]
    """(F,)"""
    offset: NDArray[np.float64]
    """(F, 3) m"""
    height: float
    """m, in the world"""
    scale: float
    """m, 1 sd"""
    weight: float
    """0: there is no floor"""


class MonoPriors(NamedTuple):
    """Quadratics 1/2 weight (q - centre)^2 over the active dof, and the limits."""

    centre: NDArray[np.float64]
    """(2, A): the prediction, the rest posture"""
    weight: NDArray[np.float64]
    """(2, A)"""
    lower: NDArray[np.float64]
    """(A,)"""
    upper: NDArray[np.float64]
    """(A,)"""
    longest: NDArray[np.float64]
    """(A,) longest Newton step"""


class MonoProblem(NamedTuple):
    """Everything that one search for a pose looks at."""

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
    """Scratch memory of one thread; contents mean nothing between calls."""

    rotations: NDArray[np.float64]
    centres: NDArray[np.float64]
    twists: NDArray[np.float64]
    vertices: NDArray[np.float32]
    """(V, 3) about the root"""
    uvz: NDArray[np.float32]
    """(V, 3) pixel and depth"""
    inverse: NDArray[np.float32]
    """(V,) 1 / depth, 0 where that is too near"""
    front: NDArray[np.uint8]
    """(F,)"""
    depth: NDArray[np.float32]
    """(h, w) z-buffer, 1/m, 0 = nothing"""
    still: NDArray[np.float32]
    """(h, w) the same of what does not move"""
    node_ends: NDArray[np.int32]
    """(N, 2) vertices that a contour node lies between"""
    nodes: NDArray[np.float64]
    """(N, 8): place 0..1, u, v, normal u, v, length px, seen, outer"""
    flow_faces: NDArray[np.int32]
    """(M, 3) vertices around an inner node"""
    flow_nodes: NDArray[np.float64]
    """(M, 5): weights of the second and third vertex, target u, v, weight"""
    row_vertices: NDArray[np.int32]
    """(R, 3) vertices, -1 where fewer"""
    row_values: NDArray[np.float64]
    """(R, 8): shares of the vertices, direction in the world, first and second derivative along it"""
    wrench: NDArray[np.float64]
    """(J, 6)"""
    marked: NDArray[np.uint8]
    """(J,)"""
    counts: NDArray[np.int64]
    """(8,): contour nodes seen, of these with an edge, edges, occluded, facing away, flow nodes, rows, evaluations"""
