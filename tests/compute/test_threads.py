"""Spreading work over threads."""

import pytest

from hypose.compute import threads as threads_of


@pytest.mark.parametrize(("n", "threads"), [(0, 2), (1, 4), (7, 3), (16, 1)])
def test_chunks_cover_everything_once(n, threads):
    seen = [0] * n

    def work(first, last):
        for k in range(first, last):
            seen[k] += 1

    threads_of.over_chunks(work, n, threads)
    assert seen == [1] * n


def test_an_error_in_any_chunk_is_raised():
    def work(first, last):
        if last == 6:
            raise ValueError("in the last chunk")

    with pytest.raises(ValueError, match="last chunk"):
        threads_of.over_chunks(work, 6, 3)


@pytest.mark.parametrize("threads", ["1", "2"])
def test_a_call_beside_is_made_once_whoever_makes_it(threads, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    made = []
    results = [threads_of.in_background(lambda n=n: made.append(n) or n * n) for n in range(5)]
    assert [result() for result in results] == [0, 1, 4, 9, 16]
    assert sorted(made) == [0, 1, 2, 3, 4]


def test_an_error_beside_is_raised_where_its_result_is_asked(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    result = threads_of.in_background(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        result()
