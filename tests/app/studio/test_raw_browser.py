"""From raw footage to a result, by the page only: what `hypose synth --raw` writes, and a real Pose2Sim project."""

import json
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from hypose.app.jobs.truth import compare
from hypose.io.motions.results import load_motion
from hypose.synthetic import film_session
from hypose.synthetic.rigs import rig
from hypose.synthetic.scenes import make_scene
from tests import missing
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving

MOST_CLICKS = 15
SOME = 36
"""Frames of a real recording that are enough to find out by how many its key points are late, and to track."""
BALANCING = Path(__file__).resolve().parents[4] / "shared" / "data" / "pose2sim_balancing"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A folder with the session of four cameras, at half of their size; the board is carried about quickly, so that
    there are fewer pictures to look at."""
    root = tmp_path_factory.mktemp("raw")
    scene = make_scene("walk", "neutral", rig("humaneva-4", distorted=True).scaled(0.5), seconds=1.2, seed=3)
    with pytest.MonkeyPatch.context() as hurry:
        for name, value in {"_STATIONS": 16, "_LYING": 8, "_HELD": (2, 3), "_MOVED": (1, 2)}.items():
            hurry.setattr(film_session, name, value)
        film_session.write_session(scene, root / "session")
    return root


def test_raw_footage_becomes_a_result_in_fifteen_clicks(session, page, tmp_path):
    truth = session.parent / "truth.npz"
    (session / "session" / "truth.npz").replace(truth)
    with serving(session) as client:
        said = go(WEB / "tests" / "raw.walk.mjs", client.address, session, tmp_path)
    assert json.loads(said.strip().splitlines()[-1])["clicks"] <= MOST_CLICKS
    motion = load_motion(session / "mine" / "results" / "default" / "motion.npz")
    off = np.nanmean(compare(truth, motion, 0).distances)
    sys.stdout.write(f"\nRaw footage by the page: {1000 * off:.0f} mm from the truth\n")
    assert off < 0.06


def cut_short(source, target, frames):
    """The last frames of a Pose2Sim project: its photos, and of each camera's video and key points so many."""
    shutil.copytree(source / "calibration", target / "calibration")
    for folder in (source / "pose").iterdir():
        for file in sorted(folder.glob("*.json"))[-frames:]:
            (target / "pose" / folder.name).mkdir(parents=True, exist_ok=True)
            shutil.copy(file, target / "pose" / folder.name)
    (target / "videos").mkdir()
    for file in (source / "videos").iterdir():
        read = cv2.VideoCapture(str(file))
        read.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        size = tuple(int(read.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        code, rate = cv2.VideoWriter.fourcc(*"mp4v"), read.get(cv2.CAP_PROP_FPS)
        written = cv2.VideoWriter(str(target / "videos" / file.name), code, rate, size)
        for _ in range(int(read.get(cv2.CAP_PROP_FRAME_COUNT)) - frames):
            assert read.grab(), file
        for _ in range(frames):
            there, image = read.read()
            assert there, file
            written.write(image)
        written.release()


def test_a_pose2sim_projects_own_files_become_a_result(page, tmp_path):
    """Its photos, videos and key points, the last frames of them, dropped as they are; nothing but a name is typed."""
    if not BALANCING.is_dir():
        missing.skip("real recordings (pose2sim_balancing)", "put them into ../shared/data beside the checkout")
    raw = tmp_path / "balancing"
    cut_short(BALANCING, raw, SOME)
    root = tmp_path / "root"
    root.mkdir()
    (root / "expected.json").write_text(json.dumps({"raw": str(raw), "frames": SOME}))
    with serving(root) as client:
        said = go(WEB / "tests" / "balancing.walk.mjs", client.address, root, tmp_path)
    assert json.loads(said.strip().splitlines()[-1])["clicks"] <= MOST_CLICKS
    motion = load_motion(root / "beam" / "results" / "default" / "motion.npz")
    assert len(motion) == SOME and motion.lost.mean() < 0.05 and np.nanmedian(motion.cost) < 0.3
