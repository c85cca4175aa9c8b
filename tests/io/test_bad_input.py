"""Recordings that cannot be used: each gives one sentence that names the file or camera and the next step."""

import re

import cv2
import pytest

from hypose.errors import CalibrationError, HyposeError, InputError
from hypose.io.recordings.recording import load_recording
from tests.io.recordings import frame, make_recording, make_video

VIEWS = [{"name": n, "video": f"{n}.avi"} for n in ("cam_1", "cam_2")]


def refuses(path, message, error=InputError):
    with pytest.raises(error, match=message) as caught:
        load_recording(path)
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".") and (";" in text or "," in text), text
    return text


def edit(folder, **changes):
    """The two good views with changes to the first one (None removes a key)."""
    first = {k: v for k, v in (VIEWS[0] | changes).items() if v is not None}
    return make_recording(folder, [first, VIEWS[1]])


@pytest.fixture
def good(tmp_path):
    folder = make_recording(tmp_path / "rec")
    assert load_recording(folder).n_frames == 12
    return folder


def test_missing_path(tmp_path):
    refuses(tmp_path / "none", r"none does not exist; give a recording folder, its recording\.toml, or a Pose2Sim")


def test_folder_without_recording(tmp_path):
    refuses(tmp_path, r"has no recording\.toml and is no Pose2Sim project \(Config\.toml, videos\); write recording")
    make_recording(tmp_path / "walk")
    refuses(tmp_path, r"it holds the recordings walk: name one")


def test_a_file_that_is_no_recording(good):
    refuses(good / "cam_1.avi", r"cam_1\.avi is no recording; give a folder with recording\.toml")
    refuses(good / "calibration.toml", r"calibration\.toml: the key cam_1 is unknown")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", r"recording\.toml is not valid TOML: Invalid value \(.*\); correct it"),
        ("a = " + "[" * 5000, r"recording\.toml is not valid TOML: .*nested too deeply"),
        ("", r"recording\.toml: no views; add one \[\[view\]\] table per camera"),
        ("view = []", r"recording\.toml: no views"),
        ("view = [1]", r"recording\.toml: view must be \[\[view\]\] tables, got 1"),
        ("view = 1", r"recording\.toml: view must be a list in \[ \], got 1"),
        ("[view]\nname = 'a'", r"recording\.toml: view must be a list"),
    ],
)
def test_malformed_toml(good, text, message):
    (good / "recording.toml").write_text(text)
    refuses(good, message)


def test_binary_or_huge_toml(good):
    (good / "recording.toml").write_bytes(b"\xff\xfe\x80")
    refuses(good, r"recording\.toml is not a text file \(UTF-8\)")
    with (good / "recording.toml").open("wb") as stream:
        stream.truncate(6_000_000)
    refuses(good, r"recording\.toml has 6 MiB, at most 5 MiB are read")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"framerate": 25.0},
            r"recording\.toml: the key framerate is unknown \(did you mean frame_rate\?\); correct or remove it",
        ),
        ({"xyz": 1}, r"the key xyz is unknown \(known are name, calibration"),
        ({"frame_rate": "25"}, r"frame_rate must be a number, got '25'; correct it"),
        ({"frame_rate": True}, r"frame_rate must be a number, got True"),
        ({"frame_rate": float("nan")}, r"frame_rate must be a finite number, got nan"),
        ({"frame_rate": -5}, r"frame_rate = -5 is implausible; give frames per second"),
        ({"name": 5}, r"name must be text in quotes, got 5"),
        ({"keypoint_lag": 0.5}, r"keypoint_lag must be a whole number, got 0\.5"),
        ({"keypoint_pixels": "px"}, r"keypoint_pixels must be calibration, image, got 'px'"),
        ({"world_up": "up"}, r"world_up must be x, y, z, -x, -y, -z, got 'up'"),
        ({"calibration_unit": "inch"}, r"calibration_unit must be auto, m, cm, mm, got 'inch'"),
        ({"subject_height": 178}, r"subject_height = 178 is implausible; give it in metres \(0\.4 to 2\.8\)"),
        ({"subject_mass": 0}, r"subject_mass = 0 is implausible; give it in kilograms"),
        ({"frame_range": [0, 13]}, r"frame_range = \[0, 13\] lies outside .* frames 0 to 11; .* at most \[0, 12\]"),
        ({"frame_range": [-1, 5]}, r"frame_range = \[-1, 5\] lies outside"),
        ({"frame_range": [5, 5]}, r"frame_range = \[5, 5\] lies outside"),
        ({"frame_range": [1.5, 5]}, r"frame_range must be 2 whole numbers in \[ \], got \[1\.5, 5\]"),
        ({"frame_range": [1]}, r"frame_range must be 2 whole numbers"),
        ({"calibration": "none.toml"}, r"there is no calibration \(.*none\.toml does not exist\); run hypose cal"),
    ],
)
def test_settings(good, settings, message):
    refuses(make_recording(good, VIEWS, **settings), message)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vidoe": "a.avi"}, r"view cam_1: the key vidoe is unknown \(did you mean video\?\); correct"),
        ({"video": "none.avi"}, r"view cam_1: the video .*none\.avi does not exist; correct the path or copy"),
        ({"video": "."}, r"view cam_1: video must be a file"),
        (
            {"video": None},
            r"view cam_1: neither video, images, depth, masks nor keypoints are given; add one of them, or",
        ),
        ({"images": "."}, r"view cam_1: video and images are both given; keep the one to use"),
        ({"video": None, "images": "cam_1.avi"}, r"view cam_1: images must be a folder, .*cam_1\.avi is not"),
        ({"video": None, "images": "none"}, r"view cam_1: the images .*none does not exist"),
        ({"video": None, "images": "empty"}, r"The folder .*empty holds no images"),
        ({"masks": "none"}, r"view cam_1: the masks .*none does not exist"),
        ({"background": "none.png"}, r"view cam_1: the background .*none\.png does not exist"),
        ({"background": "text.png"}, r"text\.png is not an image or is damaged"),
        ({"keypoints": "none"}, r"view cam_1: the keypoints .*none does not exist"),
        (
            {"keypoints": "empty"},
            r"The folder .*empty holds no key points \(\.json or \.txt, one per frame\); detect them",
        ),
        ({"video": "text.avi"}, r"text\.avi cannot be opened as a video"),
        ({"video": "zero.avi"}, r"zero\.avi is empty \(0 bytes\); record or copy it again"),
        ({"image_shift": [1.0]}, r"view cam_1: image_shift must be 2 numbers in \[ \], got \[1\.0\]"),
        ({"image_shift": ["a", "b"]}, r"view cam_1: image_shift must be 2 numbers"),
        ({"image_shift": [float("inf"), 0.0]}, r"view cam_1: image_shift must be 2 numbers"),
        ({"accept_scaled": 1}, r"view cam_1: accept_scaled must be true or false, got 1"),
        ({"name": "cam_2"}, r"view names must differ, got cam_2, cam_2; rename one"),
        ({"name": 3}, r"view 3: name must be text in quotes, got 3"),
        ({"camera": "cam_9"}, r"calibration has (2 cameras|no camera cam_9)"),
    ],
)
def test_views(good, changes, message):
    (good / "empty").mkdir()
    (good / "text.avi").write_text("no video")
    (good / "text.png").write_text("no image")
    (good / "zero.avi").write_bytes(b"")
    refuses(edit(good, **changes), message)


def test_no_calibration(tmp_path):
    folder = make_recording(tmp_path / "rec", calibrated=False)
    refuses(folder, r"recording\.toml: there is no calibration \(.*calibration\.toml does not exist\); run hypose "
            r"calibrate, or name the file", CalibrationError)  # fmt: skip


def test_bad_calibration(good):
    (good / "calibration.toml").write_text("[cam_1]\nmatrix = 5\n")
    refuses(good, r"calibration\.toml, camera cam_1: matrix must be numbers of shape 3 x 3", CalibrationError)


def test_number_of_cameras(good):
    make_recording(good, [VIEWS[0] | {"name": "left"}])
    refuses(
        good,
        r"calibration\.toml has 2 cameras \(cam_1, cam_2\) but there are 1 views \(left\); add the missing ones, or "
        r"give every view its camera",
        CalibrationError,
    )


def test_views_named_like_their_cameras_leave_others_out(good):
    make_recording(good, VIEWS[:1])
    recording = load_recording(good)
    assert recording.rig.names == ("cam_1",)
    assert any("The cameras cam_2 of calibration.toml have no view and are left out" in n for n in recording.notes)


def test_unknown_camera_lists_those_there_are(good):
    make_recording(good, [VIEWS[0] | {"camera": "cam_9"}, VIEWS[1] | {"camera": "cam_2"}])
    refuses(good, r"The calibration has no camera cam_9; it has cam_1, cam_2", CalibrationError)


def test_size_against_calibration(good):
    make_video(good / "cam_1.avi", size=(96, 48))
    text = refuses(
        good,
        r"View cam_1: .*cam_1\.avi is 96 x 48 px, camera cam_1 is calibrated for 64 x 48 px; calibrate at this size",
        CalibrationError,
    )
    assert "accept_scaled = true for this view in recording.toml" in text
    make_video(good / "cam_1.avi", size=(48, 64))
    refuses(good, r"48 x 64 px, .* 64 x 48 px; the images look turned by 90 degrees", CalibrationError)


def test_size_of_background_and_masks(good):
    cv2.imwrite(str(good / "plate.png"), frame(1, (96, 48)))
    refuses(edit(good, background="plate.png"), r"View cam_1: .*plate\.png is 96 x 48 px", CalibrationError)
    refuses(edit(good, masks="plate.png"), r"View cam_1: .*plate\.png is 96 x 48 px", CalibrationError)


def test_different_frame_rates(good):
    make_video(good / "cam_2.avi", frame_rate=30)
    refuses(good, r"the videos have different frame rates \(cam_1 25, cam_2 30 frames/s\); convert them to one rate")


def test_images_without_frame_rate(good):
    views = []
    for name in ("cam_1", "cam_2"):
        (good / name).mkdir()
        cv2.imwrite(str(good / name / "1.png"), frame(1))
        views.append({"name": name, "images": name})
    refuses(make_recording(good, views), r"images carry no frame rate; add frame_rate = \.\.\. \(frames per second\)")


def test_every_refusal_is_an_error_that_the_command_line_catches():
    assert issubclass(CalibrationError, InputError) and issubclass(InputError, HyposeError)
    assert re.search("exits with code 2", HyposeError.__doc__)
