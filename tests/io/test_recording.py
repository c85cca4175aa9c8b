"""Recording folders: what recording.toml says is what is loaded, and written again."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.robustness.keypoint_layouts import detections
from hypose.errors import CalibrationError, InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.calibrations.calibration_formats import read_any, write_calibration
from hypose.io.recordings.frames import FrameSettings, FrameStream, load_keypoints
from hypose.io.recordings.recording import (
    PersonSettings,
    ViewSettings,
    load_recording,
    people_of_tables,
    write_recording,
)
from tests.io.recordings import SIZE, frame, make_recording, make_rig, make_video


def test_minimal(tmp_path):
    recording = load_recording(make_recording(tmp_path / "walk"))
    assert recording.name == "walk" and recording.folder == tmp_path / "walk"
    assert recording.rig.names == ("cam_1", "cam_2") == tuple(v.name for v in recording.views)
    assert recording.views[0] == ViewSettings("cam_1", {"video": tmp_path / "walk" / "cam_1.avi"})
    assert recording.frame_rate == pytest.approx(25) and recording.frames == range(12)
    assert recording.keypoint_set is None and recording.subject_height is None and recording.notes == ()
    assert set(recording.inputs) == {"calibration", "cam_1.video", "cam_2.video"}
    assert load_recording(tmp_path / "walk" / "recording.toml").views == recording.views


def everything(folder):
    make_recording(folder)
    for i in range(12):
        (folder / "masks").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / "masks" / f"{i}.png"), frame(i))
    (folder / "pose").mkdir()
    for i in range(12):
        (folder / "pose" / f"{i}.json").write_text('{"people": []}')
    cv2.imwrite(str(folder / "plate.png"), frame(50))
    views = [
        {
            "name": "left",
            "camera": "cam_2",
            "video": "cam_2.avi",
            "background": "plate.png",
            "keypoints": "pose",
            "image_shift": [6.0, -0.5],
        },
        {"name": "right", "camera": "cam_1", "masks": "masks", "accept_scaled": True},
    ]
    return make_recording(
        folder,
        views,
        name="Läufe 1",
        calibration_unit="m",
        frame_rate=25,
        frame_range=[2, 10],
        keypoint_set="BODY_25B",
        keypoint_lag=1,
        keypoint_pixels="image",
        subject_height=1.8,
        subject_mass=75,
    )


def test_everything_and_round_trip(tmp_path):
    folder = everything(tmp_path / "a")
    recording = load_recording(folder)
    assert recording.name == "Läufe 1" and recording.rig.names == ("cam_2", "cam_1")
    left, right = recording.views
    own = {"video": folder / "cam_2.avi", "background": folder / "plate.png", "keypoints": folder / "pose"}
    assert left.image_shift == (6.0, -0.5) and left.files == own and left.source == own["video"]
    assert right.files["masks"] == folder / "masks" and right.source is None and right.accept_scaled
    assert recording.frame_range == (2, 10) and recording.frames == range(2, 10)
    assert (recording.keypoint_set, recording.keypoint_lag, recording.keypoint_pixels) == ("BODY_25B", 1, "image")
    assert (recording.subject_height, recording.subject_mass) == (1.8, 75.0)

    for target in (folder, tmp_path / "elsewhere"):
        written = write_recording(recording, target)
        again = load_recording(written)
        same_paths = [v.source and v.source.resolve() for v in again.views]
        assert same_paths == [v.source and v.source.resolve() for v in recording.views]
        assert np.allclose(again.rig.projections, recording.rig.projections, atol=1e-9)
        for name in ("name", "frame_rate", "frame_range", "keypoint_set", "keypoint_lag", "keypoint_pixels",
                     "subject_height", "subject_mass", "n_frames", "notes"):  # fmt: skip
            assert getattr(again, name) == getattr(recording, name), name
        assert [v.image_shift for v in again.views] == [(6.0, -0.5), (0.0, 0.0)]
    assert 'video = "cam_2.avi"' in (folder / "recording.toml").read_text()  # inside: relative


def test_how_masks_are_made_is_read_written_and_used(tmp_path):
    folder = everything(tmp_path / "a")
    path = folder / "recording.toml"
    plain = path.read_text()
    path.write_text(plain + "\n[silhouettes]\nthreshold = 6\nshadow = false\nshadow_range = [0.5, 0.9]\n")
    recording = load_recording(folder)
    assert recording.silhouettes == SilhouetteSettings(threshold=6, shadow=False, shadow_range=(0.5, 0.9))
    assert load_recording(write_recording(recording, tmp_path / "b")).silhouettes == recording.silhouettes
    with FrameStream(recording) as usual, FrameStream(recording, FrameSettings()) as other:
        assert usual.options.silhouettes == recording.silhouettes and other.options.silhouettes == SilhouetteSettings()
    for line, word in (("treshold = 4", "threshold"), ("shadow = 1", "true or false"), ("min_sd = -1", "min_sd")):
        path.write_text(f"{plain}\n[silhouettes]\n{line}\n")
        with pytest.raises(InputError, match=word):
            load_recording(folder)


def test_calibration_by_default_in_a_subfolder(tmp_path):
    make_recording(tmp_path, calibrated=False)
    (tmp_path / "calibration").mkdir()
    write_calibration(make_rig(), tmp_path / "calibration" / "Calib.toml")
    assert load_recording(tmp_path).calibration == tmp_path / "calibration" / "Calib.toml"


@pytest.mark.parametrize(
    ("views", "cameras", "order", "note"),
    [
        (("cam_2", "cam_1"), ("cam_1", "cam_2"), ("cam_2", "cam_1"), None),
        (("Cam-02", "cam01"), ("cam_01", "cam_02"), ("cam_02", "cam_01"), "matched by their names: Cam-02 = cam_02"),
        (("trial2_v2", "trial2_v1"), ("int_cam1_img", "int_cam2_img"), ("int_cam2_img", "int_cam1_img"), "by their n"),
        (("left", "right"), ("a", "b"), ("a", "b"), "taken in their order: left = a, right = b; if that is wrong"),
    ],
)
def test_cameras_are_matched(tmp_path, views, cameras, order, note):
    for v in views:
        make_video(tmp_path / f"{v}.avi")
    make_recording(tmp_path, [{"name": v, "video": f"{v}.avi"} for v in views], names=cameras)
    recording = load_recording(tmp_path)
    assert recording.rig.names == order and tuple(v.name for v in recording.views) == views
    assert [note in n for n in recording.notes] == [True] if note else recording.notes == ()


@pytest.mark.parametrize(("size", "accepted"), [((128, 96), False), ((72, 48), True)])
def test_scaled_images_are_accepted_with_a_note_and_stretched_ones_on_request(tmp_path, size, accepted):
    make_video(tmp_path / "cam_1.avi", size=size)
    make_video(tmp_path / "cam_2.avi")
    views = [{"name": n, "video": f"{n}.avi", "accept_scaled": accepted} for n in ("cam_1", "cam_2")]
    recording = load_recording(make_recording(tmp_path, views))
    assert len(recording.notes) == 1 and recording.rig[0].size == SIZE
    assert f"cam_1.avi is {size[0]} x {size[1]} px, the calibration 64 x 48 px; the images are" in recording.notes[0]


@pytest.mark.parametrize(
    ("lengths", "note"),
    [
        ((18, 10, 20), " Without cam_2, the others' 18 frames could be tracked."),
        ((12, 18), "different numbers of frames (cam_1 12, cam_2 18)"),
        ((12, 14), None),
    ],
)
def test_different_lengths_use_the_common_part_and_a_camera_that_went_out_is_named(tmp_path, lengths, note):
    cameras = [f"cam_{n}" for n in range(1, len(lengths) + 1)]
    for name, frames in zip(cameras, lengths, strict=True):
        make_video(tmp_path / f"{name}.avi", frames)
    views = [{"name": n, "video": f"{n}.avi"} for n in cameras]
    recording = load_recording(make_recording(tmp_path, views, names=cameras))
    assert recording.n_frames == min(lengths)
    assert [note in n for n in recording.notes] == ([True] if note else [])


def test_a_cut_off_video_is_named(tmp_path):
    """With the frame that it reaches; the other views are cut to the same length."""
    make_recording(tmp_path)
    data = make_video(tmp_path / "cam_1.avi", 60).read_bytes()
    make_video(tmp_path / "cam_2.avi", 60)
    (tmp_path / "cam_1.avi").write_bytes(data[: len(data) // 2])
    recording = load_recording(tmp_path)
    n = recording.n_frames
    assert 10 < n < 40 and recording.frames == range(n)
    assert any(f"cam_1.avi states 60 frames but decoding ends after frame {n - 1}; " in x for x in recording.notes)
    assert any(f"(cam_1 {n}, cam_2 60); the first {n} frames" in x for x in recording.notes)


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_world_up(tmp_path, up):
    """What the calibration calls up becomes z; pixels stay."""
    make_recording(tmp_path)
    plain = load_recording(tmp_path).rig
    turned = load_recording(make_recording(tmp_path, world_up=up)).rig
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1 if up[0] == "-" else 1
    for a, b in zip(plain, turned, strict=True):
        assert np.allclose(b.project([0.0, 0.0, 0.4]), a.project(0.4 * axis), atol=1e-9)
        assert np.isclose(np.linalg.det(b.camera_from_world[:3, :3]), 1)


# ---- test bad input ------------------------------------------------------------------------------------------------
# Recordings that cannot be used: each gives one sentence that names the file or camera and the next step.


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


def test_folder_without_recording(tmp_path):
    refuses(tmp_path / "none", r"none does not exist; give a recording folder, its recording\.toml, or a Pose2Sim")
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


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"framerate": 25.0},
            r"recording\.toml: the key framerate is unknown \(did you mean frame_rate\?\); correct or remove it",
        ),
        ({"xyz": 1}, r"the key xyz is unknown \(known are name, calibration"),
        (
            {"frame_rate": "25"},
            r"frame_rate must be a number of frames .* \(0\.1 to 10000\), got '25'; correct it",
        ),
        ({"frame_rate": True}, r"frame_rate must be a number .*, got True"),
        ({"frame_rate": float("nan")}, r"frame_rate must be a number .*, got nan"),
        ({"frame_rate": -5}, r"frame_rate must be a number of frames per second .*, got -5"),
        ({"name": 5}, r"name must be text in quotes, got 5"),
        ({"keypoint_lag": 0.5}, r"keypoint_lag must be a whole number, got 0\.5"),
        ({"keypoint_pixels": "px"}, r"keypoint_pixels must be calibration, image, got 'px'"),
        ({"world_up": "up"}, r"world_up must be x, y, z, -x, -y, -z, got 'up'"),
        ({"calibration_unit": "inch"}, r"calibration_unit must be auto, m, cm, mm, got 'inch'"),
        ({"subject_height": 178}, r"subject_height must be a number of metres \(0\.4 to 2\.8\), got 178"),
        ({"subject_mass": 0}, r"subject_mass must be a number of kilograms"),
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
            r"empty is not a file or folder of key points of OpenPose, .*Ultralytics; detect them",
        ),
        ({"video": "text.avi"}, r"text\.avi cannot be opened as a video"),
        ({"video": "zero.avi"}, r"zero\.avi is empty \(0 bytes\); record or copy it again"),
        ({"image_shift": [1.0]}, r"view cam_1: image_shift must be 2 numbers in \[ \], got \[1\.0\]"),
        ({"image_shift": ["a", "b"]}, r"view cam_1: image_shift must be 2 numbers"),
        ({"image_shift": [float("inf"), 0.0]}, r"view cam_1: image_shift must be 2 numbers"),
        ({"accept_scaled": 1}, r"view cam_1: accept_scaled must be true or false, got 1"),
        ({"name": "cam_2"}, r"view names must differ, got cam_2, cam_2; rename one"),
        ({"name": 3}, r"view 3: name must be text in quotes, got 3"),
    ],
)
def test_views(good, changes, message):
    (good / "empty").mkdir()
    (good / "text.avi").write_text("no video")
    (good / "text.png").write_text("no image")
    (good / "zero.avi").write_bytes(b"")
    refuses(edit(good, **changes), message)


def test_bad_calibration(good):
    (good / "calibration.toml").write_text("[cam_1]\nmatrix = 5\n")
    refuses(good, r"calibration\.toml, camera cam_1: matrix must be numbers of shape 3 x 3", CalibrationError)
    (good / "calibration.toml").unlink()
    refuses(
        good, r"recording\.toml: there is no calibration \(.*does not exist\); run hypose calibrate", CalibrationError
    )


@pytest.mark.parametrize(
    ("views", "message"),
    [
        (
            [VIEWS[0] | {"name": "left"}],
            r"calibration\.toml has 2 cameras \(cam_1, cam_2\) but there are 1 views \(left\); add the missing ones, "
            r"or give every view its camera",
        ),
        (
            [VIEWS[0] | {"camera": "cam_9"}, VIEWS[1] | {"camera": "cam_2"}],
            r"The calibration has no camera cam_9; it has cam_1, cam_2",
        ),
    ],
)
def test_views_without_a_camera_are_named(good, views, message):
    refuses(make_recording(good, views), message, CalibrationError)


def test_views_named_like_their_cameras_leave_others_out(good):
    make_recording(good, VIEWS[:1])
    recording = load_recording(good)
    assert recording.rig.names == ("cam_1",)
    assert any("The cameras cam_2 of calibration.toml have no view and are left out" in n for n in recording.notes)


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
    cv2.imwrite(str(good / "plate.png"), frame(1, (96, 48)))
    make_video(good / "cam_1.avi")
    for what in ("background", "masks"):
        refuses(edit(good, **{what: "plate.png"}), r"View cam_1: .*plate\.png is 96 x 48 px", CalibrationError)


def test_images_without_frame_rate(good):
    views = []
    for name in ("cam_1", "cam_2"):
        (good / name).mkdir()
        cv2.imwrite(str(good / name / "1.png"), frame(1))
        views.append({"name": name, "images": name})
    refuses(make_recording(good, views), r"images carry no frame rate; add frame_rate = \.\.\. \(frames per second\)")


# ---- test person tables --------------------------------------------------------------------------------------------
# What [[person]] tables may say: names are folders, beside files of everybody's results.


def test_what_is_left_out_is_not_known():
    given = {"name": "J. Smith", "height": 2, "body": "b.npz", "place": [1, 2.5], "time": 3}
    assert people_of_tables(Path("here"), "recording.toml", [{}, given]) == (
        PersonSettings("person-1"),
        PersonSettings("J. Smith", 2.0, Path("here/b.npz"), (1.0, 2.5), 3.0),
    )


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        *(
            ([{"name": name}], "names a folder")
            for name in ("", "a/b", "..", "all", "7", "CON", "overlay.webm", "report.html", "people.json")
        ),
        *(
            ([{"name": "Anna B"}, {"name": "Anna C"}, {"name": other}], "Anna B.*rename one|rename one.*Anna B")
            for other in ("Anna B", "anna b", "Anna-B", "Anna.B")
        ),
        *(
            ([{"name": "anna"} | wrong], "recording.toml, person")
            for wrong in ({"name": 5}, {"height": "1.7"}, {"height": 17.0}, {"time": -1.0}, {"place": [1.0]})
        ),
    ],
)
def test_people_that_cannot_be_are_refused(tables, message):
    with pytest.raises(InputError, match=message):
        people_of_tables(Path("here"), "recording.toml", tables)


# ---- test pose2sim -------------------------------------------------------------------------------------------------
# Pose2Sim projects and trials, as they are.


NAMES = ("cam01", "cam02")


def make_project(folder, config="[project]\nframe_rate = 25\n", points=26, calibration=True, level=None):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "Config.toml").write_text(config)
    if calibration:
        (folder / "calibration").mkdir()
        write_calibration(make_rig(("cam_01", "cam_02")), folder / "calibration" / "Calib_board.toml")
    for name in NAMES:
        make_video(folder / "videos" / f"{name}.mp4")
        pose = folder / "pose" / f"{name}_json"
        pose.mkdir(parents=True)
        for i in range(12):
            people = [{"pose_keypoints_2d": [1.0] * 3 * points}] if i else []
            (pose / f"{name}.{i:04d}.json").write_text(json.dumps({"people": people}))
    return folder


def test_project_of_today(tmp_path):
    config = """[project]
        frame_rate = 'auto'
        frame_range = [2, 9]
        participant_height = 1.72
        participant_mass = [70.0, 63.5]
        [pose]
        pose_model = 'Body_with_feet'"""
    recording = load_recording(make_project(tmp_path / "Demo", config))
    assert recording.name == "Demo" and recording.frame_range == (2, 9) and recording.frame_rate == pytest.approx(25)
    assert recording.keypoint_set == "HALPE_26" and recording.keypoint_pixels == "calibration"
    assert recording.subject_height == 1.72 and recording.subject_mass == 70
    assert recording.rig.names == ("cam_01", "cam_02")
    for view, name in zip(recording.views, NAMES, strict=True):
        assert view.name == name and view.files["video"] == tmp_path / "Demo" / "videos" / f"{name}.mp4"
        assert view.files["keypoints"] == tmp_path / "Demo" / "pose" / f"{name}_json"
    assert load_recording(tmp_path / "Demo" / "Config.toml").views == recording.views


def test_a_recording_toml_beside_it_changes_what_it_says(tmp_path):
    """What a check tells the user to set in recording.toml has a place, without saying everything else again."""
    project = make_project(tmp_path / "Demo")
    plain, toml = load_recording(project), project / "recording.toml"
    toml.write_text('keypoint_lag = 1\n[[view]]\nname = "cam02"\nimage_shift = [7.3, 0]\n')
    reported = load_recording(project)
    assert (
        reported.keypoint_lag == 1 and reported.frame_rate == plain.frame_rate and reported.rig.names == plain.rig.names
    )
    assert [v.image_shift for v in reported.views] == [(0.0, 0.0), (7.3, 0.0)]
    assert [v.files for v in reported.views] == [v.files for v in plain.views]
    toml.write_text('[[view]]\nname = "cam9"\n')
    with pytest.raises(InputError, match=r"has no view 'cam9'"):
        load_recording(project)
    write_calibration(plain.rig, project / "calibration.toml")  # then it is a whole recording of its own
    toml.write_text('[[view]]\nname = "cam_01"\nvideo = "videos/cam01.mp4"\n')
    assert [v.name for v in load_recording(project).views] == ["cam_01"]


def test_trial_of_a_session(tmp_path, monkeypatch):
    """Calibration and settings come from the levels above; the trial's own settings win."""
    session = tmp_path / "session"
    trial = make_project(session / "trial_1", "[project]\nframe_range = [1, 5]\n", calibration=False)
    (session / "calibration").mkdir()
    write_calibration(make_rig(("cam_01", "cam_02")), session / "calibration" / "Calib.toml")
    (session / "Config.toml").write_text("[project]\nframe_range = [0, 3]\nparticipant_height = 1.6\n")
    recording = load_recording(trial)
    assert recording.frame_range == (1, 5) and recording.subject_height == 1.6
    assert recording.calibration == session / "calibration" / "Calib.toml"
    monkeypatch.chdir(trial)
    assert load_recording(".").name == "trial_1" and load_recording(".").n_frames == 12
    with pytest.raises(InputError, match=r"is a Pose2Sim session with the trials trial_1"):
        load_recording(session)


@pytest.mark.parametrize(
    ("points", "model", "expected", "notes"),
    [
        (25, None, "BODY_25", 0),
        (25, "BODY_25", "BODY_25", 0),
        (17, None, "COCO_17", 0),
        (133, "Whole_body", "COCO_133", 0),
        (26, "COCO_17", "HALPE_26", 1),  # the files are believed
    ],
)
def test_keypoint_set(tmp_path, points, model, expected, notes):
    config = f"[pose]\npose_model = '{model}'\n" if model else ""
    recording = load_recording(make_project(tmp_path / "p", config, points))
    assert recording.keypoint_set == expected
    assert sum("points, which are not those of" in n for n in recording.notes) == notes


def test_extrinsics_photos_become_plates(tmp_path):
    folder = make_project(tmp_path / "p")
    (folder / "calibration" / "extrinsics" / "ext_cam01_img").mkdir(parents=True)
    photo = folder / "calibration" / "extrinsics" / "ext_cam01_img" / "photo.png"
    cv2.imwrite(str(photo), frame(9, (128, 96)))
    cv2.imwrite(str(folder / "calibration" / "extrinsics" / "cam02.png"), frame(9, (48, 64)))
    recording = load_recording(folder)
    assert recording.views[0].files["background"] == photo and "background" not in recording.views[1].files
    assert any("serve as background plates of cam01;" in n for n in recording.notes)
    assert any("cam02.png (48 x 64 px) is not used as background of cam02 (64 x 48 px)" in n for n in recording.notes)


def test_qualisys_only_and_image_folders(tmp_path):
    folder = make_project(tmp_path / "p")
    for name in NAMES:
        (folder / "videos" / f"{name}.mp4").unlink()
        (folder / "videos" / name).mkdir()
        for i in range(3):
            cv2.imwrite(str(folder / "videos" / name / f"{i}.jpg"), frame(i))
    recording = load_recording(folder)
    assert [v.files["images"] for v in recording.views] == [folder / "videos" / n for n in NAMES]
    assert recording.n_frames == 3


def test_a_real_project(shared_data, tmp_path):
    """Pose2Sim's own demo of 2024, with every setting commented out in Config.toml."""
    recording = load_recording(shared_data("pose2sim_balancing"))
    assert recording.rig.names == ("cam_01", "cam_02", "cam_03", "cam_04")
    assert recording.frame_rate == 60 and recording.n_frames == 100 and recording.keypoint_set == "BODY_25B"
    for view in recording.views:
        assert {"video", "keypoints", "background"} <= view.files.keys()
        assert all(view.name in path.name for path in view.files.values())
    scaled = [n for n in recording.notes if "taken as scaled" in n]
    assert len(scaled) == 2 and "cam01.mp4 is 1080 x 1920 px, the calibration 1088 x 1920 px" in scaled[0]
    write_recording(recording, tmp_path)
    rig = read_any(tmp_path / "calibration.toml")[0]
    assert np.allclose(rig.projections, recording.rig.projections, atol=1e-8)


# ---- refused -----------------------------------------------------------------------------------------------


def test_refused(tmp_path):
    folder = make_project(tmp_path / "a", calibration=False)
    refuses(folder, r"No calibration \(\.toml or \.qca\.txt\) in .*a \(it has no calibration folder\); run")
    (folder / "calibration").mkdir()
    refuses(folder, r"No calibration .* in .*calibration; run Pose2Sim's calibration step or hypose calibrate first")

    folder = make_project(tmp_path / "c")
    (folder / "videos" / "cam02.mp4").unlink()
    refuses(folder, r"has 2 cameras \(cam_01, cam_02\) but there are 1 views \(cam01\)", CalibrationError)
    (folder / "videos" / "cam01.mp4").unlink()
    shutil.rmtree(folder / "pose")
    refuses(folder, r"has no videos .* or folders of images in videos, and no key points in pose; put the videos")

    folder = make_project(tmp_path / "d", points=40)
    refuses(folder, r"cam01_json: there are 40 points per person, which no set has; known are .*BODY_25B \(25\)")


def test_without_videos(tmp_path):
    """Sizes come from the calibration, names from the folders of pose, the number of frames from the files."""
    folder = make_project(tmp_path / "a")
    shutil.rmtree(folder / "videos")
    (folder / "calibration").rename(folder / "my_calib_of_may")
    seen = detections("HALPE_26", make_rig(("cam_01", "cam_02")), 12)
    for name, frames in zip(NAMES, seen, strict=True):
        for i, points in enumerate(frames[1:], start=1):
            people = [{"pose_keypoints_2d": points.ravel().tolist()}]
            (folder / "pose" / f"{name}_json" / f"{name}.{i:04d}.json").write_text(json.dumps({"people": people}))
    (folder / "pose" / "cam01_json" / "cam01.0003.json").write_text('{"people": {}}')
    (folder / "pose" / "cam01_json" / "cam01.0004.json").write_text('{"people": [{}]}')
    recording = load_recording(folder)
    assert [v.name for v in recording.views] == ["cam01", "cam02"] and not any(v.source for v in recording.views)
    assert recording.n_frames == 12 and recording.frame_rate == 25 and recording.keypoint_set == "HALPE_26"
    assert any("There are no videos in" in n for n in recording.notes)
    points = np.stack([k.points for k in load_keypoints(recording)])
    assert ((points[1:, 1, :, 2] > 0) == (seen[1, 1:, :, 2] > 0)).all() and (points[1:, 1, :, 2] > 0).any()
    assert not points[[0, 3, 4], 0, :, 2].any()
    (folder / "Config.toml").write_text("")
    with pytest.raises(InputError, match=r"key points carry no frame rate"):
        load_recording(folder)
