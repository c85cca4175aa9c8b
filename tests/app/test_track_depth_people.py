"""Two people before two depth cameras, from the command line: everybody, one of them, and what is refused."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from hypose.body.ready_bodies import human
from hypose.io.motions.bodies import save_body
from hypose.io.motions.results import load_motion
from hypose.synthetic.depth_scenes import depth_scene
from hypose.synthetic.motions import act
from hypose.synthetic.performance import moved
from hypose.synthetic.subjects import load_subjects
from hypose.synthetic.write_depth import write_depth_scene

PLACES = {"Anna": (0.5, 0.2), "Bert": (-0.5, 0.0)}
LIGHT = ("--no-overlay", "--formats", "trc")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Bert and Anna beside him before two sensors; recording.toml names Anna first. Read only."""
    folder = tmp_path_factory.mktemp("two") / "two"
    subject = load_subjects()["neutral"]
    bert, anna = (act("wave", subject, 0.2, 25.0, np.random.default_rng(3 + k)) for k in range(2))
    bert, anna = _at(bert, PLACES["Bert"]), _at(anna, PLACES["Anna"])
    write_depth_scene(replace(depth_scene(bert, subject, "depth-2"), others=((subject, anna),)), folder)
    save_body(human(), folder / "body.npz")
    with (folder / "recording.toml").open("a", encoding="utf-8") as file:
        for name, (x, y) in PLACES.items():
            file.write(f'\n[[person]]\nname = "{name}"\nbody = "body.npz"\nplace = [{x}, {y}]\ntime = 0.0\n')
    return folder


def _at(performance, place):
    now = performance.root[:, :2].mean(0)
    return moved(performance, 0.0, (place[0] - now[0], place[1] - now[1]))


def where(folder):
    """(2,) m: the mean place of a result's person."""
    return load_motion(folder / "motion.npz").joints[:, 0, :2].mean(0)


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
