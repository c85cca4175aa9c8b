"""The way into the compiled kernels: a module of them by name, and arrays as they take them."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Arrays = TypeVar("_Arrays", bound=NamedTuple)


@cache
def native(name: str) -> ModuleType:
    """The module of kernels called name: "solver.rows" is solver/cpu_rows.py; the first of them imports numba."""
    room, _, stem = f"compute.{name}".rpartition(".")
    return import_module(f"hypose.{room}.cpu_{stem}")


def plain(a: ArrayLike, dtype: type) -> NDArray:
    """The array, contiguous and writable: numba compiles a kernel again for every layout and for read-only arrays."""
    if type(a) is np.ndarray and a.dtype == dtype and a.flags.carray:  # as nearly always
        return a
    return np.require(a, dtype, ["C", "W", "A"])


def tidy(arrays: _Arrays) -> _Arrays:
    """The same for all arrays of a tuple."""
    for a in arrays:
        if type(a) is np.ndarray and not a.flags.carray:
            break
    else:
        return arrays
    return type(arrays)(*(np.require(a, None, ["C", "W", "A"]) if isinstance(a, np.ndarray) else a for a in arrays))
