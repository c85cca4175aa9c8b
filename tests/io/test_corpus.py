"""Inputs that once made a reader misbehave: it now reads or refuses them, in time and in one sentence."""

import re
from pathlib import Path

import numpy as np
import pytest

from hypose.errors import HyposeError
from scripts.fuzz import input_of, judge
from scripts.fuzz_mutations import mutate
from scripts.fuzz_targets import targets
from tests.conftest import ROOT

CORPUS = sorted((ROOT / "tests" / "io" / "corpus").iterdir())
FOREIGN = (b"", bytes(600), b"hello world\n", b"{}", b"\xff" * 2000, b"PK\3\4" + bytes(2000))
"""What no format's file holds."""


def formats():
    """Readers of files: not of lines, nor of what a server, a file name or the cache brings."""
    return [t for t in targets().values() if not t.lines and t.name.split("-")[0] not in ("server", "name", "cache")]


def test_good_inputs_are_read(good):
    for target in targets().values():
        path = good / target.file
        target.read(path.read_bytes() if target.lines else good / (target.given or target.file))


def test_foreign_files_are_refused_in_one_sentence(good):
    for target in formats():
        file = good / target.file
        whole = file.read_bytes()
        for data in FOREIGN:
            file.write_bytes(data)
            # nobody is seen in that frame; one of several files that is no calibration is another file
            if (target.name, data) != ("keypoints-ultralytics", b"") and target.name != "calibration-opencv-folder":
                with pytest.raises(HyposeError, match=r"^[^\n]+\.$"):
                    target.read(good / (target.given or target.file))
                    pytest.fail(f"{target.name} takes {data!r}")
        file.write_bytes(whole)


def test_absent_files_are_refused_by_name(good):
    for target in formats():
        if not target.given:
            path = good / "absent" / Path(target.file).name
            with pytest.raises(HyposeError, match=rf"^[^\n]*{re.escape(path.name)}[^\n]+\.$"):
                target.read(path)


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


def test_spoilt_inputs_follow_from_their_numbers(good):
    target = targets()["motion-trc"]
    data = (good / target.file).read_bytes()
    assert input_of(target, data, 1, 5) == input_of(target, data, 1, 5)
    assert len({input_of(target, data, 1, n) for n in range(20)}) > 15
    archive = (good / "motion" / "motion.npz").read_bytes()
    assert all(mutate(archive, "npz", np.random.default_rng(n)) != archive for n in range(20))
