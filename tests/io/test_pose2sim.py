"""Pose2Sim projects and trials, as they are."""

import json
import shutil

import cv2
import numpy as np
import pytest

from benchmarks.robustness.keypoint_layouts import detections
from hypose.errors import CalibrationError, InputError
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.calibrations.calibration_text import write_calibration
from hypose.io.recordings.frames import load_keypoints
from hypose.io.recordings.recording import load_recording, write_recording
from tests.io.recordings import frame, make_rig, make_video

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
        assert view.name == name and view.video == tmp_path / "Demo" / "videos" / f"{name}.mp4"
        assert view.keypoints == tmp_path / "Demo" / "pose" / f"{name}_json"
    assert load_recording(tmp_path / "Demo" / "Config.toml").views == recording.views


def test_a_recording_toml_beside_it_changes_what_it_says(tmp_path):
    """What a check tells the user to set in recording.toml has a place, without saying everything else again."""
    project = make_project(tmp_path / "Demo")
    plain = load_recording(project)
    toml = project / "recording.toml"
    toml.write_text('keypoint_lag = 1\n[[view]]\nname = "cam02"\nimage_shift = [7.3, 0]\n')
    told = load_recording(project)
    assert told.keypoint_lag == 1 and told.frame_rate == plain.frame_rate and told.rig.names == plain.rig.names
    assert [v.image_shift for v in told.views] == [(0.0, 0.0), (7.3, 0.0)]
    assert [v.video for v in told.views] == [v.video for v in plain.views]
    assert [v.keypoints for v in told.views] == [v.keypoints for v in plain.views]
    toml.write_text('[[view]]\nname = "cam9"\n')
    with pytest.raises(InputError, match=r"has no view 'cam9'"):
        load_recording(project)
    toml.write_text("keypoint_lagg = 1\n")
    with pytest.raises(InputError, match="keypoint_lagg"):
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
        (25, None, "BODY_25B", 1),
        (25, "BODY_25", "BODY_25", 0),
        (17, None, "COCO_17", 1),
        (133, "Whole_body", "COCO_133", 0),
        (26, "COCO_17", "HALPE_26", 1),  # the files are believed
    ],
)
def test_keypoint_set(tmp_path, points, model, expected, notes):
    config = f"[pose]\npose_model = '{model}'\n" if model else ""
    recording = load_recording(make_project(tmp_path / "p", config, points))
    assert recording.keypoint_set == expected
    assert sum("points and are taken as" in n for n in recording.notes) == notes


def test_extrinsics_photos_become_plates(tmp_path):
    folder = make_project(tmp_path / "p")
    (folder / "calibration" / "extrinsics" / "ext_cam01_img").mkdir(parents=True)
    photo = folder / "calibration" / "extrinsics" / "ext_cam01_img" / "photo.png"
    cv2.imwrite(str(photo), frame(9, (128, 96)))
    cv2.imwrite(str(folder / "calibration" / "extrinsics" / "cam02.png"), frame(9, (48, 64)))
    recording = load_recording(folder)
    assert recording.views[0].background == photo and recording.views[1].background is None
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
    assert [v.images for v in recording.views] == [folder / "videos" / n for n in NAMES]
    assert recording.n_frames == 3


def test_a_real_project(shared_data, tmp_path):
    """Pose2Sim's own demo of 2024, with every setting commented out in Config.toml."""
    recording = load_recording(shared_data("pose2sim_balancing"))
    assert recording.rig.names == ("cam_01", "cam_02", "cam_03", "cam_04")
    assert recording.frame_rate == 60 and recording.n_frames == 100 and recording.keypoint_set == "BODY_25B"
    for view in recording.views:
        assert view.video is not None and view.keypoints is not None and view.background is not None
        assert view.name in view.video.name and view.name in view.keypoints.name and view.name in view.background.name
    scaled = [n for n in recording.notes if "taken as scaled" in n]
    assert len(scaled) == 2 and "cam01.mp4 is 1080 x 1920 px, the calibration 1088 x 1920 px" in scaled[0]
    write_recording(recording, tmp_path)
    rig = read_any(tmp_path / "calibration.toml")[0]
    assert np.allclose(rig.projections, recording.rig.projections, atol=1e-8)


# ---- refused -----------------------------------------------------------------------------------------------


def test_refused(tmp_path):
    def refuses(folder, message, error=InputError):
        with pytest.raises(error, match=message):
            load_recording(folder)

    folder = make_project(tmp_path / "a", calibration=False)
    refuses(folder, r"No calibration \(\.toml or \.qca\.txt\) in .*a \(it has no calibration folder\); run")
    (folder / "calibration").mkdir()
    refuses(folder, r"No calibration .* in .*calibration; run Pose2Sim's calibration step or hypose calibrate first")

    folder = make_project(tmp_path / "b", "[project\n")
    refuses(folder, r"Config\.toml is not valid TOML: .*; correct it")

    folder = make_project(tmp_path / "c")
    (folder / "videos" / "cam02.mp4").unlink()
    refuses(folder, r"has 2 cameras \(cam_01, cam_02\) but there are 1 views \(cam01\)", CalibrationError)
    (folder / "videos" / "cam01.mp4").unlink()
    shutil.rmtree(folder / "pose")
    refuses(folder, r"videos holds no videos .* and there are no key points in pose; add one or the other")
    (folder / "videos").rmdir()
    refuses(folder, r"has no videos folder and no key points in pose; put the videos into .*videos")

    folder = make_project(tmp_path / "d", points=40)
    refuses(folder, r"cam01_json: there are 40 points per person, which no set has; known are .*BODY_25B \(25\)")

    folder = make_project(tmp_path / "e")
    (folder / "pose" / "cam01_json" / "cam01.0000.json").write_text("{")
    refuses(folder, r"cam01\.0000\.json is not JSON \(.*\); give the path of")

    folder = make_project(tmp_path / "f", "[project]\nframe_range = [10, 300]\n")
    refuses(folder, r"frame_range = \[10, 300\] lies outside the recording, which has the frames 0 to 11")


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
