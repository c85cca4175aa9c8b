"""`hypose track --recipe monocular`: one camera through the command line, its errors, interruption and resume."""

import json

import numpy as np
import pytest

from hypose.app.cli import run_cli
from hypose.app.commands import console
from hypose.app.jobs.job import DESCRIPTIONS
from hypose.body.default_body import JOINT_NAMES, human
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Keypoints, Picture
from hypose.inference.hypotheses import Hypotheses
from hypose.io.motions.results import load_modes, load_motion
from hypose.io.videos.video import open_video
from hypose.synthetic.scenes import camera_rig, look_at
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.recipes import recipe

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


def test_every_file_is_written(one_camera) -> None:
    several = {"motion_sd.sto"}  # of several cameras only
    assert {p.name for p in one_camera.iterdir()} == set(DESCRIPTIONS) - several
    with open_video(one_camera / "overlay.mp4") as video:
        assert video.n_frames == 8


def test_the_modes_can_be_read(one_camera) -> None:
    motion, modes = load_motion(one_camera / "motion.npz"), load_modes(one_camera / "modes.npz")
    assert len(motion) == len(modes) == 8
    apart = np.linalg.norm(modes.joints[:, 0] - motion.joints, axis=-1)
    assert 1e-4 < apart.mean() < 0.1  # the clip was solved as a whole
    assert ((modes.alive >= 1) & (modes.alive <= 2)).all()
    np.testing.assert_allclose(np.nansum(modes.weights, 1), 1.0, atol=1e-6)
    assert (modes.depth_sd > 0).any()
    assert np.isnan(motion.cost).all()  # costs of pictures are no overlap


def test_mirrored_limbs_are_tried_where_key_points_can_tell_them_apart() -> None:
    body = human()
    made = recipe("monocular", body, frame_rate=60.0, particles=4)
    view = look_at("cam1", (2.6, -2.4, 1.4), (0.0, 0.0, 1.0), 450.0, (384, 288))
    picture = Picture(view, np.zeros((288, 384, 3), np.uint8))
    points = Keypoints(np.zeros((1, 1, 3)), ("head",), CameraRig((view,)))
    mirror = next(layer.needed for layer in made.layers if layer.name == "mirror")
    h = Hypotheses.uniform(body.skeleton.rest_pose()[None])
    assert made.particles == 4
    for keypoints, done in ((points, 0), (points, 3), (None, 0)):
        frame = prepare(
            Frame(0.0, 0, keypoints=keypoints, picture=picture), body, h.best(), use_keypoints=True, done=done
        )
        assert mirror(h, frame) == (keypoints is not None and done == 0)


def test_the_report_says_how_uncertain_depth_is(one_camera) -> None:
    page = (one_camera / "report.html").read_text()
    assert "one camera does not measure depth" in page
    assert "mm (1 sd" in page
    assert "monocular" in page


def test_interrupted_and_resumed_is_the_same(tiny, clicks, tracked, one_camera, tmp_path, hypose, monkeypatch) -> None:
    out = tmp_path / "results"
    arguments = ("track", tiny, *MONO, "--start", clicks, "--subject", tracked, "--out", out, "--no-overlay")
    shown = console.Stages.__call__

    def call(self, now, count, total):
        if (now, count) == ("track", 5):
            raise KeyboardInterrupt
        shown(self, now, count, total)

    monkeypatch.setattr(console.Stages, "__call__", call)
    code, printed, _ = hypose(*arguments, "--formats", "trc")
    assert code == 130
    assert "5 of 8 frames" in printed
    assert len(load_modes(out / "modes.npz")) == 5
    monkeypatch.setattr(console.Stages, "__call__", shown)
    code, _, _ = hypose(*arguments, "--formats", "trc", "--resume")
    assert code == 0
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
