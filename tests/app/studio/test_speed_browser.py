"""How fast the gesture screen is in Chromium: prints figures, asserts none, since they are the machine's as well."""

import json
import sys

import numpy as np
import pytest

from hypose.app.jobs.gesture_job import new_learner
from hypose.app.studio.gesture_feed import PERSON_RATE
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.localise import LocaliseSettings
from hypose.gestures.model import GestureModel
from hypose.pipeline.gesture_files import SessionWriter, save_model
from hypose.synthetic.gesture_live import live_person
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving
from tests.app.studio.test_view_browser import ten_minutes

TAUGHT, SESSION_S, RATE = 60, 900, 30


def taught(folder):
    """A model that has seen a little of a simulated person, and a session of that person, whose few pictures come again
    and again for longer than any browser takes."""
    frames = live_person(0, "tee", np.random.default_rng(5), PERSON_RATE)
    learner, shown = new_learner(0), []
    for k in range(TAUGHT):
        frame = frames.send(k // 15 % 2 == 0) if k else next(frames)
        shown.append(frame.depth)
        if frame.point is not None:
            learner.show(frame.depth, KINECT, 1, *frame.point, mine=False)
        else:
            learner.reject(frame.depth, KINECT, mine=False)
    folder.mkdir()
    save_model(GestureModel(("tee",), learner.forest, (4.0,), LocaliseSettings(), learner), folder / "tee.npz")
    writer = SessionWriter(folder / "tee", ["tee"], KINECT, (640, 480))
    for k, depth in enumerate(shown):
        writer.add(k / RATE, depth, "free")
    writer.close()
    head, *rows = (folder / "tee" / "frames.csv").read_text().splitlines()
    cells = [r.split(",") for r in rows]
    again = (",".join([str(k), f"{k / RATE:.6f}", *cells[k % len(cells)][2:]]) for k in range(SESSION_S * RATE))
    (folder / "tee" / "frames.csv").write_text("\n".join([head, *again]) + "\n")


@pytest.mark.slow
def test_depth_with_a_body_and_plots_beside_it(served, page, tmp_path):
    root = tmp_path / "root"
    root.mkdir()
    taught(root / "gestures")
    ten_minutes(served / "walk" / "results" / "default", root / "long")
    with serving(root) as client:
        said = go(WEB / "tests" / "gesture_speed.walk.mjs", client.address, root, tmp_path, 540)
    measured = json.loads(said.strip().splitlines()[-1])
    sys.stdout.write(f"\nGesture screen: {measured}\n")
    assert min(measured[m]["pictures_per_s"] for m in ("bare", "alone", "with_body_and_plots")) > 0
