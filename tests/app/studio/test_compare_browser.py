"""Two results of a person who walks, beside each other in Chromium: what they differ by, the gait cycle, files."""

import io
import json
import shutil
import zipfile
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


def test_all_files_of_a_result_in_one(two):
    root, _, _ = two
    hidden = root / "walk" / "results" / "first" / ".hidden"
    hidden.write_text("no")
    outside = root / "walk" / "results" / "first" / "link.txt"
    outside.symlink_to("/etc/hostname")
    with serving(root) as client:
        id = next(r["id"] for r in client.get("/api/state")["results"] if r["name"] == "first")
        status, headers, data = client.ask(f"/api/results/{id}/all.zip")
        assert status == 200 and 'filename="walk-first.zip"' in headers["content-disposition"]
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            assert archive.testzip() is None
            names = archive.namelist()
            assert {"first/motion.npz", "first/body.npz"} <= set(names) and not any("hidden" in n for n in names)
            assert "first/link.txt" not in names
            stored = archive.read("first/motion.npz")
        assert stored == (root / "walk" / "results" / "first" / "motion.npz").read_bytes()
        assert client.get("/api/results/000000000000/all.zip", status=404)["error"]
    hidden.unlink()
    outside.unlink()


def test_nobody_walks_where_there_is_nothing_to_walk_with(studio):
    id = studio.get("/api/state")["results"][0]["id"]
    assert studio.get(f"/api/results/{id}/gait") == {"events": [], "figures": [], "cycles": []}
