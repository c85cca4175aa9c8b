"""What a check found is mended by changes of recording.toml that leave all else in it as it was."""

import pytest

from hypose.io.recordings.recording import load_recording


@pytest.fixture
def asked(own_studio, folder):
    """mend(**wish) -> the recording as the page gets it; and its folder."""

    def edit_recording(status=200, **wish):
        return own_studio.get(f"/api/recordings/{own_studio.recording}/repair", wish, status=status)

    return edit_recording, folder / "walk", own_studio


def test_a_view_is_left_out_and_taken_back(asked):
    edit_recording, walk, _ = asked
    before = (walk / "recording.toml").read_text()
    left = edit_recording(what="leave_out", view="cam2")
    assert [v["name"] for v in left["views"]] == ["cam1", "cam3", "cam4"] and left["left_out"] == ["cam2"]
    assert [v.name for v in load_recording(walk).views] == ["cam1", "cam3", "cam4"]
    assert edit_recording(what="leave_out", view="cam4")["left_out"] == ["cam2", "cam4"]
    back = edit_recording(what="take_back")
    assert len(back["views"]) == 4 and back["left_out"] == [] and (walk / "recording.toml").read_text() == before
    for name in ("cam1", "cam2", "cam3"):
        edit_recording(what="leave_out", view=name)
    assert "only view" in edit_recording(what="leave_out", view="cam4", status=400)["error"]


def test_an_empty_room_is_another_file_of_the_folder(asked):
    edit_recording, walk, _ = asked
    shown = edit_recording(what="background", view="cam1", path="background/cam4.mp4")
    assert shown["views"][0]["background"] == "cam4.mp4"
    assert load_recording(walk).views[0].files["background"] == walk / "background" / "cam4.mp4"
    for path in ("background/none.mp4", "../../secret.mp4", "/etc/hostname", None):
        assert edit_recording(what="background", view="cam1", path=path, status=400)["error"].endswith(".")


def test_what_does_not_mend_it_changes_nothing(asked):
    edit_recording, walk, _ = asked
    before = (walk / "recording.toml").read_text()
    (walk / "results" / "calibration_refined.toml").write_text("nonsense")
    assert "does not repair" in edit_recording(what="use_refined", status=400)["error"]
    for wish in ({}, {"what": "burn"}, {"what": "leave_out"}, {"what": "leave_out", "view": "cam9"}):
        assert edit_recording(status=400, **wish)["error"].endswith(".")
    assert (walk / "recording.toml").read_text() == before


def test_key_points_and_pictures_are_moved_by_what_was_found(asked):
    edit_recording, walk, _ = asked
    edit_recording(what="keypoint_lag", frames=2)
    edit_recording(what="keypoint_lag", frames=-1)
    assert load_recording(walk).keypoint_lag == 1
    edit_recording(what="image_shift", view="cam3", x=2.5, y=-1)
    edit_recording(what="image_shift", view="cam3", x=1, y=0)
    assert [v.image_shift for v in load_recording(walk).views] == [(0, 0), (0, 0), (3.5, -1), (0, 0)]
    edit_recording(what="keypoint_pixels")
    assert load_recording(walk).keypoint_pixels == "image"
    assert "number" in edit_recording(what="image_shift", view="cam3", x="left", status=400)["error"]
    assert edit_recording(what="keypoint_lag", frames=0.5, status=400)["error"]
