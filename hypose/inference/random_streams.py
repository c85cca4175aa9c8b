"""Random numbers that depend on (seed, frame, layer, particle) only: not on threads, nor on where a run was
resumed.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence

_WORD = 2**64


def stream(seed: int, frame: int, layer: int) -> np.random.Generator:
    """The generator of one layer of one frame, counter-based (Philox 4x64, Salmon et al. 2011).

    The key is the hashed seed; the two high words of the 256-bit counter are (frame, layer), so that the
    streams of different layers never overlap and each is reached without drawing any other: a resumed run
    reads the same numbers. The per-particle rule is kept by drawing one (N, D) block per kernel from this
    stream: it is filled in row order by one thread, so that row i is a function of (seed, frame, layer, i)
    alone, and a larger N does not change it. Integers of any sign; frame and layer count modulo 2^64
    (layer -1 is free for what happens between two frames).
    """
    counter = np.array([0, 0, layer % _WORD, frame % _WORD], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(_key(seed % 2**128), counter=counter))


class _Key(ISeedSequence):
    """A key as a generator asks for it: given as such, numpy first asks the system for chance that it then leaves."""

    def __init__(self, seed: int) -> None:
        self._words = np.random.SeedSequence(seed).generate_state(2, np.uint64)

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        """The key, two words of 64 bits."""
        return self._words


@lru_cache(16)
def _key(seed: int) -> Any:  # numpy takes a sequence of one's own, its stubs do not say so
    return _Key(seed)
