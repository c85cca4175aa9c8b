"""Inputs that once made a reader misbehave: it now reads or refuses them, in time and in one sentence."""

import pytest

from scripts.fuzz import input_of, judge
from scripts.fuzz_targets import targets
from tests.conftest import ROOT

CORPUS = sorted((ROOT / "tests" / "io" / "corpus").iterdir())


def formats():
    """Readers of files: not of lines, nor of what a server, a file name or the cache brings."""
    return [t for t in targets().values() if not t.lines and t.name.split("-")[0] not in ("server", "name", "cache")]


def test_damaged_files_end_in_no_other_error(good):
    for target in formats():
        whole = (good / target.file).read_bytes()
        for data in (
            *(whole[: len(whole) * k // 4] for k in (1, 2, 3)),
            *(input_of(target, whole, 1, n) for n in range(10)),
        ):
            assert judge(target, good, data, []) == "", target.name


@pytest.mark.parametrize("path", CORPUS, ids=lambda p: p.name)
def test_what_was_found_stays_mended(good, path):
    target = targets()[path.name.partition("--")[0]]
    assert judge(target, good, path.read_bytes(), []) == ""
