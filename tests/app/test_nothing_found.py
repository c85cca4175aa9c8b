"""A run in which nobody was found does not end well: one sentence, exit code 2, and what was computed stays on disk."""

import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene, write_masks, write_skeletons
from hypose.app.batch import ordered_tasks, run_task, wanted
from hypose.app.jobs import fuse_job
from hypose.errors import EvidenceError
from hypose.io.keypoints.detectors import OwnDetector
from hypose.io.motions.results import load_motion, save_motion
from hypose.io.recordings.recording import load_recording
from hypose.pipeline import track as one_person
from hypose.pipeline.detect_keypoints import detect_keypoints
from tests.app.conftest import fails


@pytest.fixture(scope="module")
def masks(tmp_path_factory):
    """A recording of masks alone, that no test changes."""
    return write_masks(small_scene(0, 3), tmp_path_factory.mktemp("masks") / "walk")


@pytest.fixture
def spoilt(masks, tmp_path):
    """spoilt(change) -> a copy of the recording, each mask (h, w) of 0 and 1 changed."""

    def make(change):
        folder = shutil.copytree(masks, tmp_path / "walk")
        for path in folder.glob("cam*/*.png"):
            cv2.imwrite(str(path), change((cv2.imread(str(path), 0) > 0).astype(np.uint8)))
        return folder

    return make


def lost(result):
    """A result whose person was found in no frame."""
    motion = result.motion
    return replace(result, motion=replace(motion, lost=np.ones(len(motion), dtype=bool)))


@pytest.fixture
def all_lost(monkeypatch):
    """Tracking finds the person in no frame."""
    whole = one_person.track_source
    monkeypatch.setattr(one_person, "track_source", lambda *a, **k: lost(whole(*a, **k)))


def test_track_that_lost_all_frames(hypose, masks, tmp_path, all_lost):
    ran = hypose("track", masks, "--out", tmp_path / "out", "--formats", "csv", "--no-overlay", "--no-smooth")
    fails(ran, "walk: the person was found in none of 3 frames", str(tmp_path / "out"), "hypose check")
    assert (tmp_path / "out" / "report.html").is_file() and (tmp_path / "out" / "joints.csv").is_file()


def test_batch_says_that_a_task_found_no_person(masks, tmp_path, all_lost):
    tasks, _ = ordered_tasks(wanted([masks], formats="trc,csv", overlay=False), tmp_path / "out")
    figures = run_task(tasks[0], tmp_path / "stop", lambda done: None)
    assert figures["state"] == "failed" and "found in none of 3 frames" in figures["message"]


def test_fuse_that_lost_all_frames(hypose, tmp_path, monkeypatch):
    whole = fuse_job.fuse_clip
    monkeypatch.setattr(fuse_job, "fuse_clip", lambda *a, **k: lost(whole(*a, **k)))
    ran = hypose("fuse", write_skeletons(tmp_path / "rec", seconds=2.0), "--out", tmp_path / "out")
    fails(ran, "rec: the person was found in none of 60 frames")
    assert load_motion(tmp_path / "out" / "motion.npz").lost.all()


def test_silhouettes_without_anybody(hypose, spoilt, tmp_path):
    ran = hypose("silhouettes", spoilt(np.zeros_like), "--out", tmp_path / "out")
    fails(ran, "walk: no picture shows anybody", "background of each view")
    assert len(list((tmp_path / "out").glob("cam*/*.png"))) == 12 and (tmp_path / "out" / "sheet.jpg").is_file()


def test_check_without_anybody(hypose, spoilt):
    folder = spoilt(np.zeros_like)
    fails(hypose("check", folder), "nobody is seen in any of 3 frames", "cam1, frame 0: the mask is empty")
    assert (folder / "results" / "check.png").is_file()


def test_sync_of_a_person_who_stands_still(hypose, tmp_path):
    folder = write_masks(small_scene(0, 30), tmp_path / "still")
    for path in folder.glob("cam*/*.png"):
        path.write_bytes(path.with_name("00000.png").read_bytes())
    fails(hypose("sync", folder), "no motion in common", "--by sound")


def test_a_detector_that_finds_nobody(tiny, tmp_path):
    class Blind:
        def detect(self, image):
            return np.zeros((0, 25, 3))

    blind = OwnDetector(Blind(), "body_25", {"model": "blind"}, "here")
    for resume in (False, True):
        with pytest.raises(EvidenceError, match="found nobody in any picture of walk"):
            detect_keypoints(load_recording(tiny), blind, tmp_path / "points", resume=resume)
    assert json.loads(next((tmp_path / "points").glob("cam1/*.json")).read_text())["people"] == []


@pytest.mark.parametrize("command", ["track", "subject"])
def test_one_camera_is_named_and_what_can_be_done_with_it(hypose, masks, tmp_path, command):
    folder = shutil.copytree(masks, tmp_path / "alone")
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text("[[view]]".join(text.split("[[view]]")[:2]))
    fails(
        hypose(command, folder), "has one camera, cam1, and this needs two or more", "--recipe monocular --camera cam1"
    )
    code, out, err = hypose("check", folder)
    assert code == 0 and "There is one camera" in out and "visual hull" not in out + err


@pytest.fixture
def without_room(recording):
    """A recording without backgrounds, too short for the person to leave their place."""
    toml = recording / "recording.toml"
    text, found = re.subn(r"(?m)^background.*\n", "", toml.read_text())
    assert found
    toml.write_text(text)
    return recording


@pytest.mark.parametrize("more", [(), ("--people", "all")])
def test_who_gave_no_empty_room_is_told_so_when_nobody_is_found(hypose, without_room, more):
    fails(
        hypose("track", without_room, "--evidence", "silhouettes", *more),
        "No view has a picture of the empty room",
        "Give a photo or clip of the empty room",
    )


def test_check_says_first_that_there_is_no_empty_room(hypose, without_room):
    code, out, _ = hypose("check", without_room)
    assert code == 1 and " ".join(out.split()).count("warning: No view has a picture of the empty room") == 1
    assert "or the other way round" not in out and "degrees and" not in out


def test_milliseconds_are_not_taken_for_seconds(hypose, tmp_path):
    folder = write_skeletons(tmp_path / "rec", seconds=1.0)
    rows = [line.split(",") for line in (folder / "frames.csv").read_text().splitlines()]
    late = [rows[0], *([s, n, f"{1000 * float(t):.1f}"] for s, n, t in rows[1:])]
    (folder / "frames.csv").write_text("\n".join(map(",".join, late)) + "\n")
    apart = "the frames of the sensor sensor0 lie 33.3 s apart, and times are seconds"
    fails(hypose("fuse", folder), apart, "divide milliseconds by 1000")


def test_a_result_of_no_frames_has_no_report(hypose, tracked, tmp_path):
    motion = load_motion(tracked / "motion.npz")
    none = {name: v[:0] for name, v in vars(motion).items() if isinstance(v, np.ndarray) and len(v) == len(motion)}
    save_motion(replace(motion, **none), tmp_path / "motion.npz")
    for given in (tmp_path / "motion.npz", tmp_path):
        fails(hypose("report", given), "no frames")
    assert not (tmp_path / "report.html").exists()
