"""Kernels are compiled with less of numba: what they find is the same, and all memory that they take is given back."""

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python
from numba.core.runtime.nrt import rtsys

from hypose.compute import compiled, lean_numba
from hypose.compute.compiled import kernel


@pytest.fixture(autouse=True)
def nowhere(monkeypatch):
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)


def _middle(a, i):
    total, row = 0.0, a[i, 1:-1]
    for k in range(row.shape[0]):
        total += row[k]
    return total


def _picked(a, which):
    return a[which].sum()


def _moved(a):
    a[1:] = a[:-1]
    return a.sum()


def _turned(a):
    b = np.empty((a.shape[1], a.shape[0]))
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            b[j, i] = 2 * a[i, j]
    return b


def _row(a, i):
    return a[i]


def _all_of_them(pick, middle, picked, moved, turned, row_of):
    def whole(a, which):
        b = turned(a)
        row = row_of(b, pick)
        return middle(a, 1) + middle(b, pick) + picked(row, which) + moved(row) + moved(b.reshape(-1))

    return whole


_INNER = _middle, _picked, _moved, _turned, _row


def test_kernels_find_what_python_finds_and_give_back_all_memory():
    a, which = np.arange(12.0).reshape(3, 4) ** 2, np.array([2, 0])
    made = kernel(_all_of_them(2, *map(kernel, _INNER)))
    expected = _all_of_them(2, *_INNER)(a.copy(), which)
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    for _ in range(20):
        assert made(a, which) == expected
    after = rtsys.get_allocation_stats()
    assert after.alloc - before.alloc >= 20
    assert after.alloc - before.alloc == after.free - before.free
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free
    _nrt_python.memsys_disable_stats()


def test_only_what_makes_arrays_counts_references(monkeypatch):
    counting = {}
    lower = lean_numba.typed_passes.NativeLowering.run_pass

    def looked_at(self, state):
        counting[state.func_id.func_name] = state.targetctx.enable_nrt
        return lower(self, state)

    monkeypatch.setattr(lean_numba.typed_passes.NativeLowering, "run_pass", looked_at)
    kernel(_all_of_them(2, *map(kernel, _INNER)))(np.zeros((3, 4)), np.array([1]))
    assert not counting["_middle"]
    assert counting["_picked"] and counting["_moved"] and counting["_turned"] and counting["_row"]
    assert counting["whole"]


def test_numba_is_as_it_was_outside_of_kernels():
    replaced = {place: getattr(*place) for place in lean_numba._REPLACED}
    with lean_numba.lean(lambda _: False):
        assert all(getattr(*place) is not was for place, was in replaced.items())
        with lean_numba.lean(lambda _: False):
            pass
        assert all(getattr(*place) is not was for place, was in replaced.items())
    kernel(_middle)(np.zeros((3, 4)), 1)
    with pytest.raises(numba.TypingError):
        kernel(lambda a: a.no_such_thing)(1.0)
    assert all(getattr(*place) is was for place, was in replaced.items())
    assert numba.njit(_turned)(np.ones((1, 2))).tolist() == [[2.0], [2.0]]


@pytest.mark.parametrize("options", [{}, {"boundscheck": False, "error_model": "numpy"}])
def test_what_a_kernel_made_numba_compile_serves_others_too(options):
    kernel(lambda n: np.empty((n, 3), np.float32).size)(2)  # numba keeps what it made of np.empty for such options
    assert numba.njit(lambda n: np.empty((n, 3), np.float32).size, **options)(5) == 15
    assert numba.njit(lambda n: np.zeros((n, n)).sum(), **options)(4) == 0
    assert numba.njit(_turned, **options)(np.ones((1, 2))).tolist() == [[2.0], [2.0]]
