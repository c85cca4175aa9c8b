"""`hypose track --recipe monocular`: one camera through the command line, its errors, interruption and resume."""

import json

import numpy as np
import pytest

from hypose.app.cli import run_cli
from hypose.app.jobs.job import DESCRIPTIONS
from hypose.body.default_body import JOINT_NAMES
from hypose.io.motions.results import load_modes, load_motion
from hypose.synthetic.scenes import camera_rig

CLICKED = [
    *(f"{s}_{p}" for s in ("left", "right") for p in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")),
    "neck",
    "head",
]
MONO = ("--recipe", "monocular", "--camera", "cam2", "--hypotheses", "2")


@pytest.fixture(scope="module")
def clicks(tiny, tmp_path_factory):
    """Joints clicked in the first picture of cam2."""
    with np.load(tiny / "truth.npz") as truth:
        joints = truth["joints"][0]
    uv = camera_rig("humaneva-4", distorted=True).scaled(0.25)[1].project(joints)
    at = {n: uv[JOINT_NAMES.index(n)].round(1).tolist() for n in CLICKED}
    path = tmp_path_factory.mktemp("clicks") / "clicks.json"
    path.write_text(json.dumps({"camera": "cam2", "frame": 0, "joints": at}))
    return path


@pytest.fixture(scope="module")
def one_camera(tiny, clicks, tracked, tmp_path_factory):
    """Results folder of a whole run with a given body."""
    out = tmp_path_factory.mktemp("mono") / "results"
    with pytest.raises(SystemExit) as stopped:
        run_cli(["track", str(tiny), *MONO, "--start", str(clicks), "--subject", str(tracked), "--out", str(out)])
    assert stopped.value.code in (None, 0)
    return out


def test_every_file_is_written_and_the_report_names_the_uncertain_depth(one_camera):
    several = {"motion_sd.sto"}  # of several cameras only
    assert {p.name for p in one_camera.iterdir()} == set(DESCRIPTIONS) - several
    assert "one camera does not measure depth" in (one_camera / "report.html").read_text()


def test_the_modes_can_be_read(one_camera) -> None:
    motion, modes = load_motion(one_camera / "motion.npz"), load_modes(one_camera / "modes.npz")
    assert len(motion) == len(modes) == 8
    apart = np.linalg.norm(modes.joints[:, 0] - motion.joints, axis=-1)
    assert 1e-4 < apart.mean() < 0.1  # the clip was solved as a whole
    assert ((modes.alive >= 1) & (modes.alive <= 2)).all()
    np.testing.assert_allclose(np.nansum(modes.weights, 1), 1.0, atol=1e-6)
    assert (modes.depth_sd > 0).any()
    assert np.isnan(motion.cost).all()  # costs of pictures are no overlap
    spread = np.linalg.eigvalsh(motion.joint_covariance)[..., -1]
    # the wider the region, the likelier an error
    assert (np.diff(motion.error_probability.ravel()[np.argsort(spread, axis=None)]) >= 0).all()


def test_interrupted_and_resumed_is_the_same(tiny, clicks, tracked, one_camera, tmp_path, hypose, interrupted):
    out = tmp_path / "results"
    arguments = ("track", tiny, *MONO, "--start", clicks, "--subject", tracked, "--out", out, "--no-overlay")
    code, printed, _ = interrupted("track", 5, *arguments, "--formats", "trc")
    assert code == 130 and "5 of 8 frames" in printed and len(load_modes(out / "modes.npz")) == 5
    assert hypose(*arguments, "--formats", "trc", "--resume")[0] == 0
    whole, again = load_motion(one_camera / "motion.npz"), load_motion(out / "motion.npz")
    np.testing.assert_array_equal(whole.poses, again.poses)
    assert not (out / "checkpoint.npz").exists()


def test_without_smoothing_the_motion_is_the_best_mode(tiny, clicks, tracked, tmp_path, hypose) -> None:
    out = tmp_path / "results"
    arguments = ("track", tiny, *MONO, "--start", clicks, "--subject", tracked, "--out", out, "--no-overlay")
    assert hypose(*arguments, "--formats", "trc", "--no-smooth", "--floor", "0")[0] == 0
    assert "stand on a floor at z = 0 m" in (out / "report.html").read_text()
    motion, modes = load_motion(out / "motion.npz"), load_modes(out / "modes.npz")
    np.testing.assert_allclose(modes.joints[:, 0], motion.joints, atol=1e-6)
