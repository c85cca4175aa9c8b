"""Compute: the only room whose code numba compiles; every hot function takes and returns arrays.

The functions here choose the back end (`selection.use`), check and tidy arrays, and spread work over threads; the
definitions are in reference.py (numpy), the fast versions in cpu_*.py (numba, imported when first needed). This module
is the room's only door: what is not named here is nobody else's business (checked with the import contracts).
"""

from __future__ import annotations

import sys
import time
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute import reference, selection
from hypose.compute.arrays import BALL, FIXED, HINGES, MeshArrays, TreeArrays
from hypose.compute.cache_place import VARIABLE, cache_folder
from hypose.compute.depth_forests import forest_arrays
from hypose.compute.depth_forests.forest_arrays import (
    Depth,
    GrowingArrays,
    Packed,
    PaddedDepth,
    ScanPlan,
    TreeArraysOffline,
)
from hypose.compute.depth_maps.depth_energy import (
    SeenDepth,
    StandingDepth,
    depth_energy,
    limb_depth_energy,
    limb_shown,
    standing_depth,
)
from hypose.compute.depth_maps.depth_points import (
    before_room,
    extents_of_pieces,
    holes_filled,
    middle,
    middle_of_piece,
    points_of_surface,
    things_before,
)
from hypose.compute.monocular import mono
from hypose.compute.monocular.mono_terms import (
    GAUSSIAN,
    LECLERC,
    LORENTZIAN,
    EdgeArrays,
    FloorArrays,
    FlowArrays,
    MarkArrays,
    MaskArrays,
    MonoModel,
    MonoPriors,
    MonoProblem,
    MonoWorkspace,
    SphereArrays,
)
from hypose.compute.native import native, plain, tidy
from hypose.compute.pictures import mask_runs, picture_to_mask
from hypose.compute.pictures.mask_runs import mask_of
from hypose.compute.pictures.parts import covered, draw_parts, parts_against_mask, projected
from hypose.compute.pictures.picture_to_mask import Box, Lens, make_lens, new_picture, order_statistic, shrink_undistort
from hypose.compute.pictures.pieces import touched_area
from hypose.compute.pictures.shown_parts import colour_sums, rim_edges, shown_parts
from hypose.compute.pictures.visibility import nearest_visible
from hypose.compute.selection import beside, default_threads, over_chunks, use
from hypose.compute.silhouettes import reach
from hypose.compute.silhouettes.glance import Glance, differing_box, glance_at, stored_pixels
from hypose.compute.silhouettes.mask_distance import shrink_mask, signed_distance
from hypose.compute.silhouettes.packed_masks import prepare_masks
from hypose.compute.silhouettes.scorer import limb_energies, silhouette_xor
from hypose.compute.solver.banded import frame_covariances, solve_coupled
from hypose.compute.solver.losses import geman_mcclure, huber, lorentzian, lorentzian_weight
from hypose.compute.solver.normal import SharedEquations, bounded_step, weighted_squares
from hypose.compute.solver.outline_rows import OutlineRows, joined_rows, outline_rows
from hypose.compute.solver.terms import (
    NO_CONTOURS,
    NO_KEYPOINTS,
    NO_POINTS,
    NOT_KNOWN,
    ContourArrays,
    DepthArrays,
    KeypointArrays,
    PointArrays,
    PreparedMasks,
    PriorArrays,
    SolveLimits,
    Standing,
    Workspace,
)
from hypose.errors import SolverError

if TYPE_CHECKING:
    from hypose.compute.pictures.render import blend_shaded, darken, expose, interpolate, rasterize, silhouette

_KERNELS = {
    "depth_sensor": "depth_forests.depth_sensor",
    "fusion": "swarm.cpu_fusion",
    "rays": "depth_forests.cpu_rays",
    "swarm_kernels": "swarm.cpu_swarm",
}
_DRAWING = ("blend_shaded", "darken", "expose", "interpolate", "rasterize", "silhouette")


def __getattr__(name: str) -> Any:
    """Kernels, and modules of them, that are called as they are: the first one asked for imports numba."""
    if name in _KERNELS:
        return import_module(f"hypose.compute.{_KERNELS[name]}")
    if name in _DRAWING:
        return getattr(import_module("hypose.compute.pictures.render"), name)
    raise AttributeError(f"module 'hypose.compute' has no attribute {name!r}")


__all__ = [
    "BALL",
    "Box",
    "ContourArrays",
    "Depth",
    "DepthArrays",
    "EdgeArrays",
    "Evaluation",
    "FIXED",
    "FOLLOWING",
    "FloorArrays",
    "FlowArrays",
    "GAUSSIAN",
    "Glance",
    "GrowingArrays",
    "HINGES",
    "KeypointArrays",
    "LECLERC",
    "LORENTZIAN",
    "Lens",
    "MarkArrays",
    "MaskArrays",
    "MeshArrays",
    "MonoModel",
    "OutlineRows",
    "MonoPriors",
    "MonoProblem",
    "MonoWorkspace",
    "NOT_KNOWN",
    "NO_CONTOURS",
    "NO_KEYPOINTS",
    "NO_POINTS",
    "Packed",
    "PaddedDepth",
    "PointArrays",
    "PreparedMasks",
    "PriorArrays",
    "ScanPlan",
    "SeenDepth",
    "StandingDepth",
    "SharedEquations",
    "Solution",
    "SolveLimits",
    "SphereArrays",
    "Standing",
    "TreeArrays",
    "TreeArraysOffline",
    "VARIABLE",
    "Workspace",
    "before_room",
    "beside",
    "blend_shaded",
    "bounded_step",
    "cache_folder",
    "colour_sums",
    "covered",
    "darken",
    "default_threads",
    "depth_energy",
    "differing_box",
    "draw_parts",
    "evaluate",
    "expose",
    "forest_arrays",
    "forward_kinematics",
    "frame_covariances",
    "geman_mcclure",
    "glance_at",
    "huber",
    "interpolate",
    "joined_rows",
    "joint_covariances",
    "kept",
    "limb_depth_energy",
    "limb_shown",
    "limb_energies",
    "lorentzian",
    "lorentzian_weight",
    "make_lens",
    "mask_of",
    "mask_runs",
    "middle",
    "extents_of_pieces",
    "holes_filled",
    "middle_of_piece",
    "mono",
    "nearest_visible",
    "new_picture",
    "order_statistic",
    "outline_points",
    "outline_rows",
    "over_chunks",
    "parts_against_mask",
    "points_of_surface",
    "picture_to_mask",
    "prepare_masks",
    "projected",
    "rasterize",
    "reach",
    "rim_edges",
    "row_sums",
    "selection",
    "shown_parts",
    "shrink_mask",
    "shrink_undistort",
    "signed_distance",
    "silhouette",
    "silhouette_xor",
    "standing_depth",
    "skin",
    "solve",
    "solve_coupled",
    "stored_pixels",
    "things_before",
    "touched_area",
    "use",
    "warm_up",
    "weighted_squares",
    "workspace",
]

Array = NDArray[np.float64]


MOST_FOUND = 3072
"""contour rows of one view, at most: the body's outline has up to 2032, a mask's up to 1000"""


def forward_kinematics(poses: ArrayLike, tree: TreeArrays) -> tuple[Array, Array]:
    """Poses (N, D) -> rotations world_from_joint (N, J, 3, 3) and joint centres (N, J, 3) m."""
    q = plain(poses, np.float64)
    if selection.backend() == "numpy":
        return reference.forward_kinematics(q, tree)
    n, j = len(q), len(tree.parents)
    rotations, centres = np.empty((n, j, 3, 3)), np.empty((n, j, 3))
    native("kinematics").forward_kinematics(q, tidy(tree), rotations, centres)
    return rotations, centres


def skin(rotations: ArrayLike, centres: ArrayLike, tree: TreeArrays, mesh: MeshArrays) -> Array:
    """Linear blend skinning: rotations (N, J, 3, 3), centres (N, J, 3) -> vertices (N, V, 3) m."""
    r, c = plain(rotations, np.float64), plain(centres, np.float64)
    if selection.backend() == "numpy":
        return reference.skin(r, c, tree, mesh)
    out = np.empty((len(r), len(mesh.vertices), 3))
    native("kinematics").skin_batch(r, c, tidy(tree), tidy(mesh), out)
    return out


def outline_points(sdf: NDArray[np.float32], size: tuple[int, int], k: int) -> tuple[NDArray[np.float32], int]:
    """Up to k points on the zero line of a signed distance (h, w), in the size = (width, height) it really has.

    Returns (k, 2) float32 px (repeated when the outline has fewer pixels, -1e6 when it has none) and the number of
    outline pixels. Three pixels along the image border are left out: there the image cuts the person, not an outline.
    """
    out = np.empty((k, 2), dtype=np.float32)
    n = native("solver.rows").outline_points(plain(sdf, np.float32), int(size[0]), int(size[1]), out)
    return out, int(n)


def workspace(tree: TreeArrays, mesh: MeshArrays, height: int, width: int) -> Workspace:
    """Scratch memory for `solve` and `evaluate` on images up to (height, width); one per thread."""
    v, f, e, j, d = len(mesh.vertices), len(mesh.faces), len(mesh.edges), len(tree.parents), len(tree.axes)
    f4, i4 = np.float32, np.int32
    line = 64 * (-(-width // 64) | 1)  # as cpu_lanes.row_stride
    rows, views, lanes, rim = 2 * mesh.skin_index.shape[1] * MOST_FOUND, 4, 16, 2048
    return Workspace(
        np.zeros((v, 3), f4),
        np.zeros((12, views), f4),
        np.zeros((v, 2, views), f4),
        np.zeros((5, views), f4),
        np.zeros(f, np.uint8),
        np.zeros(e, i4),
        np.zeros(e, i4),
        np.zeros(e, i4),
        np.zeros((5, e), f4),
        np.zeros((height + 1, line), np.int8),
        np.zeros(height * line // 8, np.uint8),
        np.zeros((3, rim), f4),
        np.zeros(rim, i4),
        np.zeros(9 * lanes, f4),
        np.zeros(lanes, i4),
        np.zeros((2, rim), f4),
        np.zeros(rim, i4),
        np.zeros(65, np.int64),
        np.zeros((j, 3, 3)),
        np.zeros((j, 3)),
        np.zeros((d, 6)),
        np.zeros((j, 21)),
        np.zeros((j, 6)),
        np.empty((2, 2 * MOST_FOUND), i4),
        np.empty((5, 2 * MOST_FOUND), f4),
        np.empty((rows, 8)),
        np.empty(rows, i4),
        np.empty((9, rows + 24)),  # else all of a row would fall on the same few places of the cache
        np.empty(j + 1, np.int64),
    )


class Evaluation(NamedTuple):
    """Cost (half the weighted robust squares), its gradient (D,), Gauss-Newton matrix (D, D), rows per cue (C + 3,
    2)."""

    cost: float
    gradient: Array
    hessian: Array
    counts: NDArray[np.int64]


def evaluate(
    pose: Array,
    tree: TreeArrays,
    mesh: MeshArrays,
    contours: ContourArrays,
    keypoints: KeypointArrays,
    points: PointArrays,
    depth: DepthArrays | None,
    priors: PriorArrays,
    ws: Workspace,
    *,
    coarse: bool = False,
) -> Evaluation:
    """Cost and derivatives of all evidence at one pose (D,); the numba kernel, on either back end."""
    evidence = tree, mesh, contours, keypoints, points, depth, priors
    return _solve(np.array(pose, dtype=np.float64), evidence, SolveLimits(0, int(coarse), 0.0, 0.0, 0), ws)[0]


class Solution(NamedTuple):
    """A solved pose (D,) and what `Evaluation` says there."""

    pose: Array
    evaluation: Evaluation
    iterations: int
    evaluations: int
    converged: bool


def solve(
    start: Array,
    tree: TreeArrays,
    mesh: MeshArrays,
    contours: ContourArrays,
    keypoints: KeypointArrays,
    points: PointArrays,
    depth: DepthArrays | None,
    priors: PriorArrays,
    settings: SolveLimits,
    ws: Workspace,
) -> Solution:
    """Bounded damped Gauss-Newton from pose start (D,); the numba kernel, on either back end. Releases the GIL."""
    q = np.minimum(np.maximum(np.asarray(start, dtype=np.float64), priors.lower), priors.upper)  # sooner than np.clip
    evaluation, info = _solve(q, (tree, mesh, contours, keypoints, points, depth, priors), settings, ws)
    if info[2] == 0:
        raise SolverError(
            "The cost at the start pose is not finite; check the start pose, the key points and the masks for NaN."
        )
    return Solution(q, evaluation, int(info[1]), int(info[2]), bool(info[3]))


def _solve(q: Array, evidence: tuple[Any, ...], settings: SolveLimits, ws: Workspace) -> tuple[Evaluation, Array]:
    """What the solver finds from pose q, which it moves, and its info (4,)."""
    d = len(q)
    gradient, hessian, info = np.zeros(d), np.zeros((d, d)), np.zeros(4)
    counts = np.zeros((len(evidence[2].sdf) + 3, 2), dtype=np.int64)
    native("solver.solver").solve(q, *evidence, settings, ws, hessian, gradient, counts, info)
    return Evaluation(float(info[0]), gradient, hessian, counts), info


def row_sums(
    pose: Array,
    tree: TreeArrays,
    joint: NDArray[np.int64],
    offset: ArrayLike,
    weight: ArrayLike,
    residual: ArrayLike,
    slope: ArrayLike,
) -> tuple[Array, Array]:
    """Gradient (D,) and Gauss-Newton matrix (D, D) of rows of any kind at a pose (D,): points on joint (P,) at offset
    (P, 3) m, with weight (P,), residual (P, R) and slope (P, R, 3), its derivative by the point in the world."""
    d = len(pose)
    gradient, hessian = np.empty(d), np.empty((d, d))
    given = (plain(x, np.float64) for x in (offset, weight, residual, slope))
    native("solver.solver").row_sums(
        plain(pose, np.float64), tidy(tree), plain(joint, np.int64), *given, hessian, gradient
    )
    return gradient, hessian


def joint_covariances(pose: Array, tree: TreeArrays, information: Array, ridge: float = 1e-9) -> Array:
    """(J, 3, 3) m^2: covariances of the joint centres when the pose (D,) has the covariance C = (information +
    ridge)^-1, the root's rotation as a small turn in the world: G C G^T with G (3, D) the derivative of the centre; the
    numba kernel, on either back end."""
    out = np.empty((len(tree.parents), 3, 3))
    q, h = plain(pose, np.float64), plain(information, np.float64)
    native("solver.covariance").joint_covariances(q, tidy(tree), h, float(ridge), out)
    return out


FOLLOWING = ("solver", "scorer", "outlines", "shape", "pictures")
"""The parts of the room that following a person in silhouettes needs."""


def warm_up(*parts: str, load: bool = True) -> float:
    """Compile what these parts of the room need (`warming.PARTS`; default: FOLLOWING), in one process per core where
    that is worth it; returns the seconds it took.

    The first time on a machine this takes some tens of seconds; afterwards the compiled code is on disk. load: have it
    in this process as well when it was on disk; without, kernels are read when they are first called.
    """
    from hypose.compute.warming import warm

    began = time.perf_counter()
    warm(sys.modules[__name__], parts or FOLLOWING, load)
    return time.perf_counter() - began


def kept(*parts: str) -> bool:
    """Whether all kernels of these parts of the room are on disk, for later starts."""
    from hypose.compute import warming

    return warming.kept(parts)
