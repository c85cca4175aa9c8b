"""Two results of a person who walks, beside each other in Chromium: what they differ by, the gait cycle, files."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from hypose.io.motions.results import save_body, save_motion
from hypose.pipeline.gait import angle_cycles, gait_of
from tests.app.studio.browser import WEB, go
from tests.app.studio.conftest import serving
from tests.pipeline.test_gait import walking

APART = np.array([0.03, 0.0, 0.04])


@pytest.fixture(scope="module")
def two(served, tmp_path_factory):
    """The served folder with two results of four seconds' walking, which lie APART (m)."""
    root = tmp_path_factory.mktemp("two")
    walk = root / "walk"
    shutil.copytree(served / "walk", walk, ignore=shutil.ignore_patterns("results"))
    (walk / "results").mkdir()
    motion, body = walking()
    for name, move in (("first", 0.0), ("second", 1.0)):
        folder = walk / "results" / name
        folder.mkdir()
        poses = motion.poses.copy()
        poses[:, [motion.skeleton.dof_names.index(f"pelvis_t{a}") for a in "xyz"]] += move * APART
        save_motion(replace(motion, poses=poses, joints=motion.joints + move * APART), folder / "motion.npz")
        save_body(body, folder / "body.npz")
    return root, motion, body


@pytest.mark.slow
def test_results_are_compared_and_plotted(two, page, tmp_path):
    root, motion, body = two
    found = gait_of(motion, body)
    knee = next(c for c in angle_cycles(found.events, motion) if c.name == "knee_angle_l")
    expected = {
        "events": len(found.events),
        "strides": knee.n,
        "knee": {"mean": np.degrees(knee.mean).tolist(), "sd": np.degrees(knee.sd).tolist()},
        "rms": 1000 * float(np.linalg.norm(APART)),
    }
    (root / "expected.json").write_text(json.dumps(expected))
    with serving(root) as client:
        go(WEB / "tests" / "compare.walk.mjs", client.address, root, tmp_path)


def test_nobody_walks_where_there_is_nothing_to_walk_with(studio):
    assert studio.get(f"/api/results/{studio.result}/gait") == {"events": [], "figures": [], "cycles": []}
