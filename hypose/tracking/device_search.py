"""A particle filter's search on a device, where all its layers are of a kind that the device knows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import GaussianDiffusion
from hypose.inference.layer import Layer, LayerReport, Recipe, RngOfLayer, SearchResult, search
from hypose.inference.selectivity import Annealed, FixedSelectivity, SurvivalRate
from hypose.inference.selectors import LayeredSystematic, systematic
from hypose.tracking.costs import SilhouetteXor
from hypose.tracking.frame_evidence import PreparedFrame


class _Known(NamedTuple):
    """A layer in numbers: steps and limits (D,), coordinates that are selected (D,), and its selectivity."""

    sigma: Array
    lower: Array
    upper: Array
    filtered: NDArray[np.bool_]
    survival: float
    beta: float


def search_frame(h: Hypotheses, recipe: Recipe, frame: PreparedFrame, rng_of_layer: RngOfLayer) -> SearchResult:
    """`inference.layer.search`, on the device where that is chosen and knows all layers, with the same random numbers:
    Gaussian steps weighed by eq. 2.8 and selected systematically, whole or by layers (sir, partitioned, hpf)."""
    masks = frame.masks
    if not compute.on_device() or masks is None or masks.hidden.size or frame.depth is not None or frame.own:
        return search(h, recipe, frame, rng_of_layer)
    known = [_known(layer, h.dimension) for layer in recipe.layers]
    layers = [k for k in known if k is not None]
    plain = not h.columns and h.covariance is None and h.values.ndim == 2 and np.ptp(h.log_weights) == 0
    if not plain or len(layers) < len(known) or any(not _same_limits(k, layers[0]) for k in layers):
        return search(h, recipe, frame, rng_of_layer)
    noise, starts = [], []
    for n, layer in enumerate(layers):  # as GaussianDiffusion and systematic draw them
        rng = rng_of_layer(n)
        noise.append(rng.standard_normal((h.count, int((layer.sigma > 0).sum()))))
        starts.append(float(rng.random()))
    told = compute.SearchLayers(
        np.stack([k.sigma for k in layers]),
        tuple(noise),
        layers[0].lower,
        layers[0].upper,
        np.stack([k.filtered for k in layers]),
        np.array([k.survival for k in layers]),
        np.array([k.beta for k in layers]),
        np.array(starts),
    )
    body = frame.body
    found = compute.layered_search(h.values, body.skeleton.tree, body.coarse.arrays, masks, told)
    reports, weighted, selected = [], h, h
    for n, layer in enumerate(layers):
        weighted = selected.at(found.values[n]).equal().reweighted(found.log_weights[n])
        reports.append(LayerReport(recipe.layers[n].name, weighted, found.betas[n]))
        taken = weighted.take(found.ancestors[n])
        selected = taken.equal(np.where(layer.filtered, taken.values, weighted.values))
    return SearchResult(recipe.estimate(weighted), weighted, selected, tuple(reports))


def _known(layer: Layer, dof: int) -> _Known | None:
    """The layer in numbers; None where it is of another kind."""
    step, weigh, select = layer.propose, layer.weigh, layer.select
    if layer.needed is not None or not isinstance(step, GaussianDiffusion) or step.heavy_tail is not None:
        return None
    if not isinstance(weigh, Annealed) or type(weigh.energy) is not SilhouetteXor:
        return None
    if isinstance(weigh.selectivity, SurvivalRate):
        survival, beta = weigh.selectivity.target, 0.0
    elif isinstance(weigh.selectivity, FixedSelectivity):
        survival, beta = float("nan"), weigh.selectivity.beta
    else:
        return None
    if isinstance(select, LayeredSystematic):
        filtered = select.filtered
    elif select is systematic:
        filtered = np.ones(dof, np.bool_)
    else:
        return None
    lower = np.full(dof, -np.inf) if step.lower is None else np.asarray(step.lower, np.float64)
    upper = np.full(dof, np.inf) if step.upper is None else np.asarray(step.upper, np.float64)
    return _Known(step.sigma, lower, upper, filtered, survival, beta)


def _same_limits(one: _Known, other: _Known) -> bool:
    return np.array_equal(one.lower, other.lower) and np.array_equal(one.upper, other.upper)
