"""Inputs that once made a reader misbehave: it now reads or refuses them, in time and in one sentence."""

import numpy as np
import pytest

from scripts.fuzz import input_of, judge
from scripts.fuzz_mutations import mutate
from scripts.fuzz_targets import targets, write_good
from tests.conftest import ROOT

CORPUS = sorted((ROOT / "tests" / "io" / "corpus").iterdir())


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    write_good(folder)
    return folder


def test_good_inputs_are_read(good):
    for target in targets().values():
        path = good / target.file
        target.read(path.read_bytes() if target.lines else good / (target.given or target.file))


@pytest.mark.parametrize("path", CORPUS, ids=lambda p: p.name)
def test_what_was_found_stays_mended(good, path):
    target = targets()[path.name.partition("--")[0]]
    assert judge(target, good, path.read_bytes(), []) == ""


def test_spoilt_inputs_follow_from_their_numbers(good):
    target = targets()["trc"]
    data = (good / target.file).read_bytes()
    assert input_of(target, data, 1, 5) == input_of(target, data, 1, 5)
    assert len({input_of(target, data, 1, n) for n in range(20)}) > 15
    archive = (good / "motion" / "motion.npz").read_bytes()
    assert all(mutate(archive, "npz", np.random.default_rng(n)) != archive for n in range(20))
