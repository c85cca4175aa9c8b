"""A particle filter's layers as arrays, for a device that runs them all without asking in between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.compute import selection
from hypose.compute.arrays import MeshArrays, TreeArrays
from hypose.compute.native import plain, tidy
from hypose.compute.silhouettes import lane_mesh
from hypose.compute.solver.terms import PreparedMasks
from hypose.errors import InputError

Array = NDArray[np.float64]


class SearchLayers(NamedTuple):
    """L layers, each of which moves a set by Gaussian steps, weighs it by eq. 2.8 and selects systematically."""

    sigma: Array
    """(L, D) steps; 0: the coordinate stays"""
    noise: tuple[Array, ...]
    """L times (N, d): standard normal numbers for the d coordinates that move"""
    lower: Array
    """(D,) limits, mirrored at once, then clamped; infinite: none"""
    upper: Array
    filtered: NDArray[np.bool_]
    """(L, D) the coordinates that selection takes from the ancestor"""
    survival: Array
    """(L,) share of the set that is to live on; NaN: betas is given"""
    betas: Array
    """(L,) exponents"""
    u: Array
    """(L,) where systematic selection begins, in [0, 1)"""


class WeightedSets(NamedTuple):
    """What the layers leave behind."""

    values: Array
    """(L, N, D) after the steps of each layer"""
    log_weights: Array
    """(L, N) -beta (E - min E)"""
    betas: Array
    """(L,)"""
    ancestors: NDArray[np.intp]
    """(L, N)"""


def on_device() -> bool:
    """Whether silhouettes are scored on a device in this context, where whole searches run as well."""
    return selection.backend() == "cuda"


def layered_search(
    poses: Array, tree: TreeArrays, mesh: MeshArrays, prepared: PreparedMasks, layers: SearchLayers
) -> WeightedSets:
    """Runs the layers on the device, from equally weighted poses (N, D), against masks all of whose pixels tell.

    The same numbers from run to run; those of the processor but for rounding, which now and then counts a pixel of a
    silhouette otherwise, and so chooses other ancestors.
    """
    if not on_device() or prepared.hidden.size:
        raise InputError("Layers run as a whole on a CUDA device only, against whole masks; choose the back end cuda.")
    from hypose.compute.silhouettes import cuda_search

    whole = lane_mesh.prepare(mesh, tree, None)
    return cuda_search.layered_search(
        plain(poses, np.float64), tidy(tree), whole, mesh.vertices, tidy(prepared), layers
    )
