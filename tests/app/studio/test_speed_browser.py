"""How fast the gesture screen is in Chromium: prints figures, asserts none, since they are the machine's as well."""

import json
import sys

import pytest

from benchmarks.studio.long_results import long_result, long_session
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving


@pytest.mark.slow
def test_depth_with_a_body_and_plots_beside_it(served, page, tmp_path):
    root = tmp_path / "root"
    root.mkdir()
    long_session(root / "gestures")
    long_result(served / "walk" / "results" / "default", root / "long", 15_000)
    with serving(root) as client:
        said = go(WEB / "tests" / "gesture_speed.walk.mjs", client.address, root, tmp_path, 540)
    measured = json.loads(said.strip().splitlines()[-1])
    sys.stdout.write(f"\nGesture screen: {measured}\n")
    assert min(measured[m]["pictures_per_s"] for m in ("bare", "alone", "with_body_and_plots")) > 0
