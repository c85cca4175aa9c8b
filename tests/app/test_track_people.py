"""`hypose track --people` on a recording of two: who is asked for by name and place, or by how many."""

import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hypose.io.sensors.depth import read_depth_png, write_depth_png
from hypose.synthetic.depth_scenes import depth_scene
from hypose.synthetic.motions import act
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.subjects import load_subjects
from hypose.synthetic.write_recording import write_depth_scene, write_scene
from tests.app.conftest import fails
from tests.standing_people import name_people, standing_at, where

PLACES = {"Anna": (0.8, 0.2), "Bert": (-0.8, 0.0)}
LIGHT = ("--no-overlay", "--formats", "trc")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Bert, who comes first, and Anna beside him; recording.toml names Anna first. Read only."""
    folder = tmp_path_factory.mktemp("two") / "two"
    cameras = camera_rig("humaneva-4", distorted=True).scaled(0.4)
    bert, anna = (make_scene("wave", "neutral", cameras, seconds=0.2, seed=3 + k) for k in range(2))
    bert = replace(bert, performance=standing_at(bert.performance, PLACES["Bert"]))
    anna = replace(anna, performance=standing_at(anna.performance, PLACES["Anna"]))
    write_scene(replace(bert, others=((anna.subject, anna.performance),)), folder, background_frames=10)
    name_people(folder, PLACES)
    return folder


def people_in(out):
    return [p["name"] for p in json.loads((out / "people.json").read_text(encoding="utf-8"))["people"]]


@pytest.fixture(scope="module")
def two_in_depth(tmp_path_factory):
    """The same two before two depth cameras. Read only."""
    folder = tmp_path_factory.mktemp("two") / "two"
    subject = load_subjects()["neutral"]
    bert, anna = (act("wave", subject, 0.2, 25.0, np.random.default_rng(3 + k)) for k in range(2))
    bert, anna = standing_at(bert, PLACES["Bert"]), standing_at(anna, PLACES["Anna"])
    write_depth_scene(replace(depth_scene(bert, subject, "depth-2"), others=((subject, anna),)), folder)
    name_people(folder, PLACES)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("seen_by", ["two", "two_in_depth"])
def test_everybody_has_a_folder_by_the_name_of_who_stands_at_the_place(hypose, request, tmp_path, seen_by):
    code, out, err = hypose("track", request.getfixturevalue(seen_by), "--people", "all", "--out", tmp_path, *LIGHT)
    assert code == 0, err
    assert people_in(tmp_path) == ["Anna", "Bert"] and "2 people: Anna, Bert" in out + err
    for name, place in PLACES.items():
        assert np.linalg.norm(where(tmp_path / name) - place) < 0.1
        assert {"report.html", "motion.trc", "assessment.json"} <= {p.name for p in (tmp_path / name).iterdir()}
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count("/report.html") == 2


def test_one_person_is_asked_for_by_name(hypose, two, tmp_path):
    code, _, err = hypose("track", two, "--people", "Bert", "--out", tmp_path, *LIGHT)
    assert code == 0, err
    assert people_in(tmp_path) == ["Bert"] and np.linalg.norm(where(tmp_path / "Bert") - PLACES["Bert"]) < 0.1


@pytest.mark.parametrize("who", ["Carl", "0", "two"])
def test_who_is_nobody_is_refused_with_the_names_there_are(hypose, two, who):
    fails(hypose("track", two, "--people", who), "Anna, Bert")


def test_masks_that_are_brought_in_step_show_everybody_and_check_says_so(hypose, two, tmp_path):
    code, _, err = hypose("sync", two, "--offsets", "0,1,0,0", "--out", tmp_path / "step")
    assert code == 0, err
    shown = [len(components(path)) for path in sorted((tmp_path / "step" / "masks").glob("*/000001.png"))]
    assert len(shown) == 4 and sum(n == 2 for n in shown) >= 3, shown  # they stand behind each other in one view
    code, out, err = hypose("check", tmp_path / "step", "--samples", "1")
    assert "Several people stand in the masks" in out and "note: several people" in out, out + err


def components(path):
    """Areas of the large parts of a mask."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    areas = stats[1:, cv2.CC_STAT_AREA]
    return areas[areas > 0.3 * areas.max()]


# ---- depth cameras


@pytest.fixture
def unknown_room(two_in_depth, tmp_path):
    """The recording of depth cameras without that of the empty room."""
    folder = shutil.copytree(two_in_depth, tmp_path / "rec")
    text, found = re.subn(r'background = "background/depth\d"\n', "", (folder / "recording.toml").read_text("utf-8"))
    assert found == 2
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_one_of_several_is_tracked_and_the_others_are_told(hypose, unknown_room, tmp_path):
    code, out, err = hypose("track", unknown_room, "--out", tmp_path / "out", *LIGHT)
    assert code == 0, err
    assert "another person is in the masks and left out" in out + err
    assert np.linalg.norm(where(tmp_path / "out") - PLACES["Anna"]) < 0.1


def test_key_points_do_not_tell_people_before_depth_cameras_apart(hypose, two_in_depth):
    refused = hypose("track", two_in_depth, "--people", "all", "--evidence", "both", *LIGHT)
    fails(refused, "depth cameras (depth1, depth2)", "not by key points")


@pytest.mark.slow
def test_a_depth_camera_that_measures_nothing_is_named_and_not_counted(hypose, tmp_path):
    subject = load_subjects()["neutral"]
    walk = act("walk", subject, 0.3, 25.0, np.random.default_rng(3))
    write_depth_scene(depth_scene(walk, subject, "depth-2"), tmp_path / "rec")
    for file in (tmp_path / "rec/depth/depth2").iterdir():
        write_depth_png(file, np.zeros_like(read_depth_png(file)))
    code, out, err = hypose("track", tmp_path / "rec", "--out", tmp_path / "out", *LIGHT)
    assert code == 0 and "frames in 1 of 2 views" in out, out + err
    assert "depth2 measures nothing in all frames that were looked at" in out and "Assessment: Look at" in out
