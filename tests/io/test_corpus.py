"""Inputs that once made a reader misbehave: it now reads or refuses them, in time and in one sentence."""

import numpy as np
import pytest

from hypose.errors import InputError
from scripts.fuzz import input_of, judge
from scripts.fuzz_mutations import mutate
from scripts.fuzz_targets import Target, targets, write_good
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


def test_long_sentences_are_cut():
    assert len(str(InputError("a" * 70_000))) < 2000


def test_spoilt_inputs_follow_from_their_numbers(good):
    target = targets()["trc"]
    data = (good / target.file).read_bytes()
    assert input_of(target, data, 1, 5) == input_of(target, data, 1, 5)
    assert len({input_of(target, data, 1, n) for n in range(20)}) > 15
    archive = (good / "motion" / "motion.npz").read_bytes()
    assert all(mutate(archive, "npz", np.random.default_rng(n)) != archive for n in range(20))


@pytest.mark.parametrize(
    ("reader", "what"),
    [
        (lambda data: None, ""),
        (lambda data: {}["key"], "KeyError"),
        (lambda data: (_ for _ in ()).throw(InputError("no.")), ""),
        (lambda data: [0] * 10**13, "out of memory"),
    ],
)
def test_the_judge_tells_what_happened(good, reader, what):
    assert judge(Target("line", "line.json", reader, lines=True), good, b"{}", []).startswith(what)
