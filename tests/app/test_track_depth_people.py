"""Two people before two depth cameras, from the command line: everybody, one of them, and what is refused."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from hypose.synthetic.depth_scenes import depth_scene
from hypose.synthetic.motions import act
from hypose.synthetic.subjects import load_subjects
from hypose.synthetic.write_depth import write_depth_scene
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


def test_everybody_before_depth_cameras_has_a_folder(hypose, two, tmp_path):
    code, out, err = hypose("track", two, "--people", "all", "--out", tmp_path, *LIGHT)
    assert code == 0, err
    people = json.loads((tmp_path / "people.json").read_text(encoding="utf-8"))["people"]
    assert [p["name"] for p in people] == ["Anna", "Bert"]
    for name, place in PLACES.items():
        assert np.linalg.norm(where(tmp_path / name) - place) < 0.1
        assert {"report.html", "motion.trc", "verdict.json"} <= {p.name for p in (tmp_path / name).iterdir()}


@pytest.mark.slow
def test_one_of_several_is_tracked_and_the_others_are_told(hypose, two, tmp_path):
    code, out, err = hypose("track", two, "--out", tmp_path, *LIGHT)
    assert code == 0, err
    assert "another person is in the masks and left out" in out + err
    assert np.linalg.norm(where(tmp_path) - PLACES["Anna"]) < 0.1


@pytest.mark.parametrize(
    "change, said",
    [
        (('background = "background/depth2"\n', ""), "depth camera depth2 .* empty room"),
        (('depth = "depth/depth2"\n', 'masks = "depth/depth2"\n'), r"depth cameras \(depth1\) are told apart by these"),
    ],
    ids=["no empty room", "another camera"],
)
def test_people_are_told_from_the_room_by_depth_cameras_alone(hypose, two, tmp_path, change, said):
    folder = tmp_path / "rec"
    shutil.copytree(two, folder)
    toml = folder / "recording.toml"
    text = toml.read_text(encoding="utf-8")
    assert change[0] in text
    toml.write_text(text.replace(*change), encoding="utf-8")
    code, _, err = hypose("track", folder, "--people", "all", *LIGHT)
    assert code == 2
    assert re.search(said, err.replace("\n", " ")), err
