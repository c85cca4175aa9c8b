"""Four videos of phones and nothing else, by the page only, to the files that OpenSim takes."""

import json
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.synthetic.wandering import RATE, wander
from hypose.io.keypoints.detectors import have_models
from hypose.io.motions.results import load_motion
from hypose.io.videos.video import writing_video
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.subjects import dress, load_subjects
from hypose.synthetic.write_recording import write_truth
from tests import missing
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving

MOST_CLICKS = 5
LATE = (0, 9, -6, 14)
_FIRST, _FRAMES = 20, 330
_WHAT = "points and masks from videos alone"

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def phones(tmp_path_factory):
    """A folder with four videos of a person who walks about; they begin at different times."""
    missing.module("ai_edge_litert.interpreter", _WHAT, "pip install ai-edge-litert")
    if not have_models():
        missing.skip(_WHAT, "fetch the models by hypose keypoints RECORDING --yes, name them in HYPOSE_MODELS")
    root = tmp_path_factory.mktemp("phones")
    rng = np.random.default_rng([77, 4])
    subjects = load_subjects()
    subject = dress(subjects[sorted(subjects)[0]], 0.02, rng)
    scene = make_scene(wander(subject, _FRAMES / RATE + 2, rng), subject, camera_rig("humaneva-4"), seed=3)
    for view, late in enumerate(LATE):
        with writing_video(root / "phones" / f"phone{view + 1}.mp4", RATE, scene.rig[view].size) as video:
            for frame in range(_FRAMES):
                video.write(scene.rgb_frame(view, _FIRST + frame - late))
    write_truth(scene, root)
    return root, subject.stature


def test_four_videos_become_files_for_opensim(phones, page, tmp_path, monkeypatch):
    root, height = phones
    truth = tmp_path / "truth.npz"
    (root / "truth.npz").replace(truth)
    monkeypatch.setenv("HEIGHT_CM", f"{100 * height:.0f}")
    with serving(root) as client:
        said = go(WEB / "tests" / "phones.walk.mjs", client.address, root, tmp_path)
    assert json.loads(said.strip().splitlines()[-1])["clicks"] <= MOST_CLICKS
    (made,) = root.glob("phones-in-step/results/*/motion.npz")
    motion = load_motion(made)
    with np.load(truth) as scene:
        off = min(
            laid_onto(motion.joints, scene["joints"], first) for first in range(len(scene["joints"]) - len(motion))
        )
    sys.stdout.write(f"\nFour videos alone: {1000 * off:.0f} mm from the truth, when laid onto it\n")
    assert off < 0.06


def laid_onto(joints, truth, first):
    """Mean distance (m) of joints (T, J, 3) from the true ones from a frame on, when laid onto them as a rigid body."""
    a, b = joints[::5].reshape(-1, 3), truth[first : first + len(joints) : 5].reshape(-1, 3)
    a, b = a - a.mean(0), b - b.mean(0)
    turn = Rotation.align_vectors(b, a)[0]
    return np.linalg.norm(turn.apply(a) - b, axis=1).mean()
