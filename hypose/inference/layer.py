"""The spine: a recipe is a whole method as one value, and one loop runs the layers of them all.

propose -> weigh -> (estimate) -> select. Methods differ only in what they put into the layers: the
annealed, partitioned, layered and detector-driven particle filters, the swarm over depth sensors and the
pruned multiple hypotheses are lists for this loop. Source: Alcoverro 2014, Algorithms 1, 2 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

from hypose.inference.hypotheses import FloatArray, Hypotheses

RngOfLayer = Callable[[int], np.random.Generator]
Memory = Mapping[str, NDArray[Any]]
"""What a method remembers from frame to frame, arrays by name; empty at first."""


class Kernel(Protocol):
    """Moves hypotheses: sees the frame too, for a local optimiser or a detector is a kernel that looks at
    the evidence.
    """

    def __call__(self, h: Hypotheses, frame: Any, rng: np.random.Generator, /) -> Hypotheses:
        """Return the moved set, of the same number of populations."""
        ...


class Weigh(Protocol):
    """Log-likelihoods (*B, N) of the hypotheses; sees the whole population because its mean may place the
    evidence.
    """

    def __call__(self, h: Hypotheses, frame: Any, /) -> FloatArray:
        """Log-likelihoods, up to a constant per population."""
        ...


class Resample(Protocol):
    """Chooses which hypotheses go on, and resets their weights (only ``keep`` does not)."""

    def __call__(self, h: Hypotheses, rng: np.random.Generator, /) -> Hypotheses:
        """Return the set that goes on."""
        ...


class Estimate(Protocol):
    """One state (*B, D) out of a weighted set; ``Hypotheses.mean`` and ``Hypotheses.best`` are the plain
    ones.
    """

    def __call__(self, h: Hypotheses, /) -> FloatArray:
        """Return the state that the set stands for."""
        ...


@dataclass(frozen=True)
class Layer:
    """One turn of the cycle. weigh None: it moves without weighing. needed(h, frame) False: the layer is left out of
    this frame; None: it never is."""

    propagate: Kernel
    weigh: Weigh | None
    resample: Resample
    name: str = ""
    needed: Callable[[Hypotheses, Any], bool] | None = None


def as_given(pose: FloatArray, frame: Any, /) -> FloatArray:
    """Start: the pose that the caller gives."""
    return pose


def stand_still(step: FloatArray, blind: int, /) -> FloatArray:
    """Prediction: the next pose is the last one."""
    return np.zeros_like(step)


@dataclass(frozen=True)
class GoOn:
    """Prediction: the share `gain` of the last step is expected again, less after every frame without evidence.

    For poses that are solved: the step between two means of a set is mostly noise, which it would feed back."""

    gain: float = 0.8

    def __call__(self, step: FloatArray, blind: int, /) -> FloatArray:
        """Return the step (D,) that is expected."""
        return self.gain ** (1 + blind) * step


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """What a recipe does when it may be wrong. find(pose, last, frame): the pose (D,) to go on from when the person is
    lost, out of the estimate and the last pose. rival(pose, frame): by how much another pose, that the evidence may
    mean as well, is better, and that pose (None: none is looked for)."""

    find: Callable[[FloatArray, FloatArray, Any], FloatArray]
    rival: Callable[[FloatArray, Any], tuple[float, FloatArray]] | None = None


@dataclass(frozen=True)
class Recipe:
    """A method as one value; the defaults are a plain particle filter. Raises ValueError without layers.

    name: of the method.
    layers: turns of propagate, weigh, resample, one after the other.
    particles: number of hypotheses N.
    needs: kinds of evidence the layers require: 'silhouettes', 'keypoints', 'detections', 'picture' (one camera).
    start(pose, frame): pose (D,) at which the first frame's search begins, from the given one.
    predict(step, blind): step (D,) expected after the last step and `blind` frames without evidence; None: the layers
        move every hypothesis by itself and keep its limits.
    estimate(h): state (*B, D) of a weighted set.
    uncertainty(pose, h, frame): uncertainty of the estimate; None: the spread of the set.
    lost(pose, h, frame): whether the person is lost; None: decided by the overlap with the masks.
    recover: search after a loss; None: no search.
    rivals: number of hypotheses the last layer hands on, with the column BEFORE, each predicted by its own last step;
        0: the set moves as one.
    smooth(clip): the motion with all frames solved together at the end, and sentences about it; None: no smoothing.
    learn(memory, pose, h, frame): arrays by name that the method keeps from frame to frame in addition to its
        hypotheses, after a frame in which the person was not lost; None: nothing.
    likes: kinds of evidence the layers use where it is available ('colours').
    citation: source of the method.
    """

    name: str
    layers: Sequence[Layer]
    particles: int = 500
    needs: tuple[str, ...] = ()
    start: Callable[[FloatArray, Any], FloatArray] = as_given
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
            raise ValueError(f"recipe '{self.name}' cannot hand on {self.rivals} rivals; 0 is none")


@dataclass(frozen=True)
class SearchResult:
    """Result of a search in one frame.

    estimate: (*B, D) state
    weighted: set of the last layer, from which the estimate was read
    resampled: set to carry to the next frame
    first: (*B, D) estimate after the first layer, of a recipe that keeps rivals; else the estimate
    """

    estimate: FloatArray
    weighted: Hypotheses
    resampled: Hypotheses
    first: FloatArray


def search(h: Hypotheses, recipe: Recipe, frame: Any, rng_of_layer: RngOfLayer) -> SearchResult:
    """Runs the layers of a recipe on one frame.

    ``rng_of_layer(l)`` gives the generator of layer l, for example ``partial(stream, seed, frame.index)``.
    Weighing adds to the log-weights, selectors reset them. Deviation: the thesis starts the cycle at the weighing; here
    it starts at the proposal, so that a frame ends with its own estimate. The estimate is read after the last weighing
    and before its selection, which would only add noise to it.
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


_WORD = 2**64


def stream(seed: int, frame: int, layer: int) -> np.random.Generator:
    """Return the generator of one layer of one frame, counter-based (Philox 4x64, Salmon et al. 2011).

    The key is the hashed seed; the two high words of the 256-bit counter are (frame, layer), so that the streams of
    different layers never overlap and each is reached without drawing any other: a resumed run reads the same numbers.
    The per-particle rule is kept by drawing one (N, D) block per kernel from this stream: it is filled in row order by
    one thread, so that row i is a function of (seed, frame, layer, i) alone, and a larger N does not change it.
    Integers of any sign; frame and layer count modulo 2^64 (layer -1 is free for what happens between two frames).
    """
    counter = np.array([0, 0, layer % _WORD, frame % _WORD], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(_key(seed % 2**128), counter=counter))


class _Key(ISeedSequence):
    """A key as a generator asks for it: given as such, numpy first asks the system for chance that it then leaves."""

    def __init__(self, seed: int) -> None:
        self._words = np.random.SeedSequence(seed).generate_state(2, np.uint64)

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        """Return the key, two words of 64 bits."""
        return self._words


@lru_cache(16)
def _key(seed: int) -> Any:  # numpy takes a sequence of one's own, its stubs do not say so
    return _Key(seed)
