"""Two people before two depth cameras, from the command line: everybody, one of them, and what is refused."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from hypose.evidence.depth_people import people_seen
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import load_recording
from hypose.io.sensors.depth import read_depth_png, write_depth_png
from hypose.pipeline.one_of_several import frames_to_examine, people_frames, with_all_people
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.depth_scenes import depth_scene
from hypose.synthetic.motions import act
from hypose.synthetic.subjects import load_subjects
from hypose.synthetic.write_recording import write_depth_scene
from tests.standing_people import name_people, standing_at, where

PLACES = {"Anna": (0.5, 0.2), "Bert": (-0.5, 0.0)}
LIGHT = ("--no-overlay", "--formats", "trc")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Bert and Anna beside him before two sensors; recording.toml names Anna first. Read only."""
    folder = tmp_path_factory.mktemp("two") / "two"
    subject = load_subjects()["neutral"]
    bert, anna = (act("wave", subject, 0.2, 25.0, np.random.default_rng(3 + k)) for k in range(2))
    bert, anna = standing_at(bert, PLACES["Bert"]), standing_at(anna, PLACES["Anna"])
    write_depth_scene(replace(depth_scene(bert, subject, "depth-2"), others=((subject, anna),)), folder)
    name_people(folder, PLACES)
    return folder


@pytest.mark.slow
def test_everybody_before_depth_cameras_has_a_folder(hypose, two, tmp_path):
    code, out, err = hypose("track", two, "--people", "all", "--out", tmp_path, *LIGHT)
    assert code == 0, err
    people = json.loads((tmp_path / "people.json").read_text(encoding="utf-8"))["people"]
    assert [p["name"] for p in people] == ["Anna", "Bert"]
    for name, place in PLACES.items():
        assert np.linalg.norm(where(tmp_path / name) - place) < 0.1
        assert {"report.html", "motion.trc", "assessment.json"} <= {p.name for p in (tmp_path / name).iterdir()}


@pytest.mark.slow
def test_one_of_several_is_tracked_and_the_others_are_told(hypose, two, tmp_path):
    code, out, err = hypose("track", unknown_room(two, tmp_path), "--out", tmp_path / "out", *LIGHT)
    assert code == 0, err
    assert "another person is in the masks and left out" in out + err
    assert np.linalg.norm(where(tmp_path / "out") - PLACES["Anna"]) < 0.1


def unknown_room(two, tmp_path):
    """The recording without that of the empty room."""
    return changed(two, tmp_path, *((f'background = "background/depth{k}"\n', "") for k in (1, 2)))


def changed(two, tmp_path, *changes):
    folder = tmp_path / "rec"
    shutil.copytree(two, folder)
    toml = folder / "recording.toml"
    text = toml.read_text(encoding="utf-8")
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    toml.write_text(text, encoding="utf-8")
    return folder


def test_people_are_seen_where_the_empty_room_was_not_recorded(two, tmp_path):
    recording = load_recording(unknown_room(two, tmp_path))
    with FrameStream(recording) as one:
        all_people = with_all_people(one, TrackOptions())
        assert all_people is not None  # one of them is to be tracked, and not a mixture of both
        all_people.close()
    with people_frames(recording, TrackOptions()) as frames:
        found = [person.axis for person in people_seen(frames.frame(2))]
    assert len(found) == 2
    for place in PLACES.values():
        assert min(np.linalg.norm(axis - place) for axis in found) < 0.2


@pytest.mark.parametrize("empty", [True, False], ids=["empty room", "no empty room"])
def test_several_people_do_not_speak_against_the_calibration(two, tmp_path, empty):
    recording = load_recording(two if empty else unknown_room(two, tmp_path))
    frames, several = frames_to_examine(recording)
    with frames:
        assert several and len(people_seen(frames.frame(2))) == 2


def test_key_points_do_not_tell_people_before_depth_cameras_apart(hypose, two):
    code, _, err = hypose("track", two, "--people", "all", "--evidence", "both", *LIGHT)
    assert code == 2
    assert re.search(r"depth cameras \(depth1, depth2\) .* not by key points", " ".join(err.split())), err


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
