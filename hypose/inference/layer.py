"""Recipes and the loop that runs them: a recipe describes a whole method as a list of layers, and `search` runs the
layers on one frame (propagate, weigh, estimate, resample).

The annealed, partitioned, layered and detector-driven particle filters, the swarm of several depth sensors and the
pruned multiple hypotheses differ only in what they put into the layers.
Source: Alcoverro 2014, Algorithms 1, 2 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.inference.hypotheses import FloatArray, Hypotheses

RngOfLayer = Callable[[int], np.random.Generator]
Memory = Mapping[str, NDArray[Any]]
"""Arrays by name that a method keeps from frame to frame; empty at first."""


Kernel = Callable[[Hypotheses, Any, np.random.Generator], Hypotheses]
"""Function (hypotheses, frame, random generator) that returns the moved set, with the same number of populations. It
gets the frame, because a local optimiser or a detector uses the evidence."""


Weigh = Callable[[Hypotheses, Any], FloatArray]
"""Function (hypotheses, frame) that computes the log-likelihoods (*B, N) of a set, up to a constant per population. It
gets the whole set, because its mean may define where the evidence is measured."""


Resample = Callable[[Hypotheses, np.random.Generator], Hypotheses]
"""Function (hypotheses, random generator) that draws the hypotheses that go on, and resets their weights (only
`resampling.keep` does not)."""


Estimate = Callable[[Hypotheses], FloatArray]
"""Function that computes one state (*B, D) from a weighted set, for example `Hypotheses.mean` or `Hypotheses.best`."""


@dataclass(frozen=True)
class Layer:
    """One turn of propagate, weigh and resample.

    propagate: kernel that moves the hypotheses.
    weigh: computes log-likelihoods; None: the layer moves without weighing.
    resample: draws the hypotheses that go on.
    name: name of the layer.
    needed(h, frame): False: the layer is skipped in this frame; None: it is never skipped.
    """

    propagate: Kernel
    weigh: Weigh | None
    resample: Resample
    name: str = ""
    needed: Callable[[Hypotheses, Any], bool] | None = None


def stand_still(step: FloatArray, blind: int, /) -> FloatArray:
    """Predict no motion: the next pose is the last one (default of `Recipe.predict`).

    step: (D,) last step; blind: number of frames without evidence.
    Returns: (D,) zeros.
    """
    return np.zeros_like(step)


def go_on(step: FloatArray, blind: int, /) -> FloatArray:
    """Predict the last step (D,) again: VELOCITY_GAIN times it, less after every frame without evidence.

    blind: number of frames without evidence.
    Use it for poses that are solved: the step between two means of a set is mostly noise, which the prediction would
    feed back.
    """
    return VELOCITY_GAIN ** (1 + blind) * step


VELOCITY_GAIN = 0.8
"""Share of the last step that `go_on` predicts again."""


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """Functions of a recipe that find another pose when the current one may be wrong.

    find(pose, last, frame): pose (D,) from which to continue when the person is lost; `pose` is the estimate, `last`
        the pose of the frame before.
    rival(pose, frame): another pose that the evidence supports as well, and by how much it is better, as (improvement,
        pose); None: no other pose is searched.
    """

    find: Callable[[FloatArray, FloatArray, Any], FloatArray]
    rival: Callable[[FloatArray, Any], tuple[float, FloatArray]] | None = None


@dataclass(frozen=True)
class Recipe:
    """Whole method as one value; the defaults describe a plain particle filter.

    name: name of the method.
    layers: turns of propagate, weigh, resample, one after the other.
    particles: number of hypotheses N.
    needs: kinds of evidence that the layers require: 'silhouettes', 'keypoints', 'detections', 'picture' (one camera).
    start(pose, frame): pose (D,) at which the search of the first frame begins, from the given one (default: that).
    predict(step, blind): step (D,) expected after the last step and `blind` frames without evidence; None: the layers
        move every hypothesis themselves and apply its limits.
    estimate(h): state (*B, D) of a weighted set.
    uncertainty(pose, h, frame): uncertainty of the estimate; None: the spread of the set.
    lost(pose, h, frame): whether the person is lost; None: decided by the overlap with the masks.
    recover: search after a loss; None: no search.
    rivals: number of hypotheses that the last layer hands on with the column BEFORE, each predicted by its own last
        step; 0: the set moves as one.
    smooth(clip): solves all frames together at the end; returns the motion and sentences about it; None: no smoothing.
    learn(memory, pose, h, frame): arrays by name that the method keeps from frame to frame, updated after every frame
        in which the person was not lost; None: nothing is kept.
    likes: kinds of evidence that the layers use where available ('colours').
    citation: source of the method.
    Raises: ValueError where there is no layer, particles is below 1, or rivals is negative.
    """

    name: str
    layers: Sequence[Layer]
    particles: int = 500
    needs: tuple[str, ...] = ()
    start: Callable[[FloatArray, Any], FloatArray] = lambda pose, frame: pose
    predict: Callable[[FloatArray, int], FloatArray] | None = stand_still
    estimate: Estimate = Hypotheses.mean
    uncertainty: Callable[[FloatArray, Hypotheses, Any], Any] | None = None
    lost: Callable[[FloatArray, Hypotheses, Any], bool] | None = None
    recover: Recovery | None = None
    rivals: int = 0
    smooth: Callable[[Any], tuple[Any, tuple[str, ...]]] | None = None
    learn: Callable[[Memory, FloatArray, Hypotheses, Any], Memory] | None = None
    likes: tuple[str, ...] = ()
    citation: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        if not self.layers:
            raise ValueError(f"recipe '{self.name}' has no layers; give it at least one")
        if self.particles < 1:
            raise ValueError(f"recipe '{self.name}' needs at least one particle, got {self.particles}")
        if self.rivals < 0:
            raise ValueError(f"recipe '{self.name}' needs a number of rivals of 0 or more, got {self.rivals}")


@dataclass(frozen=True)
class SearchResult:
    """Result of `search` on one frame.

    estimate: (*B, D) state, read from `weighted`.
    weighted: set of the last layer after weighing.
    resampled: set of the last layer after resampling, to be carried to the next frame.
    first: (*B, D) estimate after the first layer, of a recipe that keeps rivals; else the estimate.
    """

    estimate: FloatArray
    weighted: Hypotheses
    resampled: Hypotheses
    first: FloatArray


def search(h: Hypotheses, recipe: Recipe, frame: Any, rng_of_layer: RngOfLayer) -> SearchResult:
    """Run the layers of a recipe on one frame.

    h: set of hypotheses from the last frame.
    frame: evidence, passed on to the layers.
    rng_of_layer(l): random generator of layer l, for example `partial(stream, seed, frame.index)`.

    Weighing adds to the log-weights, resampling resets them. The estimate is read after the last weighing and before
    its resampling, which would only add noise.
    Deviation: the cycle of the thesis starts at the weighing; here it starts at the propagation, so that a frame ends
    with its own estimate.
    """
    weighted, first = h, None
    for index, layer in enumerate(recipe.layers):
        if layer.needed is not None and not layer.needed(h, frame):
            continue
        rng = rng_of_layer(index)
        weighted = layer.propagate(h, frame, rng)
        if layer.weigh is not None:
            weighted = weighted.reweighted(layer.weigh(weighted, frame))
        h = layer.resample(weighted, rng)
        if first is None and recipe.rivals:
            first = recipe.estimate(weighted)
    estimate = recipe.estimate(weighted)
    return SearchResult(estimate, weighted, h, estimate if first is None else first)


def follow(recipe: Recipe, particles: Hypotheses, frames: Iterable[Any], seed: int = 0) -> Iterator[SearchResult]:
    """Run a recipe's layers on one frame after the other: a whole particle filter, without tracking of people.

    particles: set before the first frame.
    frames: evidence of each frame, passed on to the layers.
    Returns: the result of each frame, which begins with the set that the frame before has resampled.
    Source: Alcoverro 2014, Algorithms 1, 2 and 5 over time. `Tracker` predicts, judges and recovers between two
        searches, which this does not.
    """
    for index, frame in enumerate(frames):
        result = search(particles, recipe, frame, partial(stream, seed, index))
        particles = result.resampled
        yield result


_WORD = 2**64


def stream(seed: int, frame: int, layer: int) -> np.random.Generator:
    """Make the random generator of one layer of one frame, independent of all others (Philox 4x64, Salmon et al. 2011).

    seed, frame, layer: any integers; frame and layer count modulo 2^64 (layer -1 is free for use between two frames).

    The key is the hashed seed and the two high words of the 256-bit counter are (frame, layer). Streams therefore never
    overlap, and each is reached without drawing any other: a resumed run reads the same numbers. A kernel draws one (N,
    D) block, filled in row order, so that row i depends on (seed, frame, layer, i) alone and does not change when N
    grows.
    """
    counter = np.array([0, 0, layer % _WORD, frame % _WORD], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=_key(seed % 2**128), counter=counter))


@lru_cache(16)
def _key(seed: int) -> NDArray[np.unsignedinteger]:
    """Hash a seed to the key (2,) of a generator."""
    return np.random.SeedSequence(seed).generate_state(2, np.uint64)
