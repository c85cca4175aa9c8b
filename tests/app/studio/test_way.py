"""The way from videos to a motion: which job is next, and what is put right on it."""

import io
import json
import zipfile

import pytest

from hypose.app.reports.calibration_pages import printed_board
from hypose.app.studio.job_kinds import found_offsets, next_step
from hypose.errors import InputError
from hypose.io.recordings.recording import load_recording

NAMES = ["cam1", "cam2", "cam3", "cam4"]


@pytest.fixture
def step(folder):
    """step(after, anyway) -> kind of the next job of the recording walk; and its folder."""
    walk = folder / "walk"
    for name in ("check.json", "sync.json"):
        (walk / "results" / name).unlink(missing_ok=True)

    def step(*more):
        found = next_step(walk, load_recording(walk), *more)
        return found and found[0]

    return step, walk


def write(walk, name, value):
    (walk / "results").mkdir(exist_ok=True)
    (walk / "results" / name).write_text(json.dumps(value))


def synchronised(walk, late=(0.0, 0.1, 0.0, -0.1)):
    views = [{"name": n, "late": x, "how": "sd 0.03"} for n, x in zip(NAMES, late, strict=True)]
    write(walk, "sync.json", {"by": "motion", "views": views})


def checked(walk, *findings):
    write(walk, "check.json", {"healthy": not findings, "findings": findings, "warnings": [], "facts": [], "views": []})


def test_the_way_is_synchronise_check_track(step):
    step, walk = step
    assert step() == "sync" and step("sync") == "check"  # a person who stands still tells no time
    synchronised(walk, (0.0, 3.0, 0.0, 0.0))
    assert step() == "in_step"
    synchronised(walk)
    assert step() == "check"
    checked(walk)
    assert step("check") == "track" and step("track") is None
    (walk / "recording.toml").write_text((walk / "recording.toml").read_text() + "\n")
    assert step() == "check"  # what it found is of before


def test_the_way_waits_where_a_button_puts_right_what_was_found(step):
    step, walk = step
    synchronised(walk)
    fault = {"fault": True, "kind": "extrinsics", "views": ["cam1"], "cure": "run hypose check --refine"}
    checked(walk, fault)
    assert step("check") is None and step("check", True) == "track"
    checked(walk, {**fault, "cure": "calibrate the lens again"})
    assert step("check") == "track"
    checked(walk, {**fault, "done": True})
    assert step("check") == "track"


def test_offsets_count_from_the_middle_and_errors_do_not(folder):
    synchronised(folder / "walk", (1.0, 1.05, 4.0, 1.0))
    assert found_offsets(folder / "walk", NAMES) == [0.0, 0.0, 2.95, 0.0]
    assert found_offsets(folder / "walk", NAMES[:2]) is None


def test_a_finding_is_ticked_off_by_what_puts_it_right(own_studio, folder):
    walk = folder / "walk"
    checked(walk, {"fault": True, "kind": "keypoint_lag", "views": [], "sentence": "", "cure": "set keypoint_lag = 1"})
    edit = {"what": "keypoint_lag", "frames": 1, "findings": [0]}
    check = own_studio.get(f"/api/recordings/{own_studio.recording}/repair", edit)["check"]
    assert check["stale"] and check["findings"][0]["done"]
    height = own_studio.get(f"/api/recordings/{own_studio.recording}/repair", {"what": "height", "metres": 1.8})
    assert height["subject_height"] == 1.8


def test_the_files_for_opensim_come_in_one(studio):
    status, _, body = studio.ask(f"/api/results/{studio.result}/opensim.zip")
    assert status == 200 and "motion.mot" in zipfile.ZipFile(io.BytesIO(body)).namelist()


def test_the_board_is_a_pdf(studio):
    status, headers, body = studio.ask("/api/board.pdf?paper=a3")
    assert status == 200 and headers["Content-Type"] == "application/pdf" and body == printed_board("a3")
    at = int(body.split(b"startxref\n")[1].split()[0])
    assert body[at:].startswith(b"xref\n0 8") and body.count(b" re f") == 27
    with pytest.raises(InputError, match="a4 or a3"):
        printed_board("b5")
