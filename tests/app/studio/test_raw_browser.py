"""From raw footage to a result, by the page only: what `hypose synth --raw` writes."""

import json
import sys

import numpy as np
import pytest

from hypose.io.motions.results import load_motion
from hypose.pipeline.comparison import compare_with_truth
from hypose.synthetic import write_recording
from hypose.synthetic.scenes import camera_rig, make_scene
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving

MOST_CLICKS = 15

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A folder with the session of four cameras, at half of their size; the board is carried about quickly, so that
    there are fewer pictures to look at."""
    root = tmp_path_factory.mktemp("raw")
    scene = make_scene("walk", "neutral", camera_rig("humaneva-4", distorted=True).scaled(0.5), seconds=1.2, seed=3)
    with pytest.MonkeyPatch.context() as hurry:
        for name, value in {"_STATIONS": 16, "_LYING": 8, "_HELD": (2, 3), "_MOVED": (1, 2)}.items():
            hurry.setattr(write_recording, name, value)
        write_recording.write_session(scene, root / "session")
    return root


def test_raw_footage_becomes_a_result_in_fifteen_clicks(session, page, tmp_path):
    truth = session.parent / "truth.npz"
    (session / "session" / "truth.npz").replace(truth)
    with serving(session) as client:
        said = go(WEB / "tests" / "raw.walk.mjs", client.address, session, tmp_path)
    assert json.loads(said.strip().splitlines()[-1])["clicks"] <= MOST_CLICKS
    motion = load_motion(session / "session" / "results" / "default" / "motion.npz")
    off = np.nanmean(compare_with_truth(truth, motion, 0).distances)
    sys.stdout.write(f"\nRaw footage by the page: {1000 * off:.0f} mm from the truth\n")
    assert off < 0.06
