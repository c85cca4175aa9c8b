"""A gesture is taught to the simulated person in the page."""

import os

import pytest

from hypose.pipeline.gesture_files import load_model, read_recording
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving


@pytest.mark.slow
def test_taught_in_the_page(page, tmp_path, monkeypatch):
    root, pictures = tmp_path / "root", tmp_path / "pictures"
    root.mkdir()
    pictures.mkdir()
    monkeypatch.setitem(os.environ, "ROUNDS", "6")  # more than it takes: teaching is ended by hand, in the second
    with serving(root) as client:
        go(WEB / "tests" / "gesture_taught.walk.mjs", client.address, root, pictures, timeout=3600)
    first, model = load_model(root / "first.npz"), load_model(root / "gestures" / "tee.npz")
    assert first.threshold is not None

    # the second session went on with the first one's trees
    assert [h["session"] for h in model.history] == ["tee", "tee-2"]
    assert model.learner.forest.size.sum() >= first.learner.forest.size.sum()

    # everything that was shown is on disk, with what was taken back
    recorded = read_recording(root / "gestures" / "tee")
    assert recorded.undone
    assert {f.phase for f in recorded.frames} >= {"do_gesture", "positive", "release", "negative", "test"}
