"""Full disks, folders that may not be written, damaged evidence: one sentence or a result that says what happened."""

import contextlib
import resource

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.body.default_body import human
from hypose.io.motions.export import export_motion
from hypose.io.motions.results import load_motion, save_body

LIGHT = ("--no-overlay", "--formats", "trc")


@pytest.fixture(scope="module")
def masks(tmp_path_factory):
    """Six frames of masks, and a body that is given, so that nothing has to be fitted; may not be spoilt."""
    folder = tmp_path_factory.mktemp("faults")
    save_body(human(), folder / "anna" / "body.npz")
    return write_masks(small_scene(1, 6), folder / "walk")


@contextlib.contextmanager
def full_disk(largest):
    """No file may grow beyond some bytes; Python turns the signal into an error, as a full disk gives."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_disk_that_is_full_at_the_end_keeps_the_motion(hypose, masks, tmp_path, monkeypatch):
    """Full from the first file for other programs on; how large the others are does not matter."""

    def with_full_disk(*arguments):
        with full_disk(4096):
            return export_motion(*arguments)

    arguments = ("track", masks, "--subject", masks.parent / "anna", *LIGHT)
    assert hypose(*arguments, "--out", tmp_path / "whole")[0] == 0
    with monkeypatch.context() as patch:
        patch.setattr("hypose.app.jobs.job.export_motion", with_full_disk)
        code, _, err = hypose(*arguments, "--formats", "glb,trc", "--out", tmp_path / "full")
    sentence = " ".join(err[err.index("error: ") :].split())
    assert code == 2 and "Traceback" not in err
    assert "cannot be written" in sentence and "what was written before is intact" in sentence
    whole, kept = (tmp_path / n / "motion.npz" for n in ("whole", "full"))
    assert kept.read_bytes() == whole.read_bytes()
    code, _, err = hypose(*arguments, "--out", tmp_path / "full", "--resume")
    assert code == 0 and "Track:" not in err
    assert not [p for p in (tmp_path / "full").iterdir() if p.name.startswith(".")]


def test_a_damaged_mask_is_left_out(hypose, masks, tmp_path):
    damaged = masks.parent / "damaged"
    write_masks(small_scene(1, 6), damaged)
    path = sorted((damaged / "cam2").iterdir())[3]
    path.write_bytes(path.read_bytes()[:40])
    code, _, err = hypose("track", damaged, "--subject", masks.parent / "anna", "--out", tmp_path, *LIGHT)
    assert code == 0, err
    assert load_motion(tmp_path / "motion.npz").n_views.tolist() == [4, 4, 4, 3, 4, 4]


@pytest.mark.slow
def test_masks_that_are_all_foreground_are_no_evidence(hypose, masks, tmp_path):
    import cv2

    flooded = masks.parent / "flooded"
    write_masks(small_scene(1, 8), flooded)
    for path in flooded.glob("cam*/0000[34].png"):
        assert cv2.imwrite(str(path), np.full((120, 160), 255, np.uint8))
    code, _, err = hypose("track", flooded, "--subject", masks.parent / "anna", "--out", tmp_path, *LIGHT)
    assert code == 0, err
    motion = load_motion(tmp_path / "motion.npz")
    assert motion.extrapolated.tolist() == [False, False, False, True, True, False, False, False]
    assert np.isfinite(motion.poses).all()


@pytest.mark.parametrize("command", [("track",), ("batch",), ("fuse",), ("export",), ("gesture", "run"), ("check",)])
def test_a_name_that_no_file_can_have_is_told_in_a_sentence(hypose, command):
    code, _, err = hypose(*command, "a" * 300)
    assert code == 2 and "too long for the name of a file" in " ".join(err.split())
    assert "Traceback" not in err and "should not have happened" not in err
