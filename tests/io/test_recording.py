"""Recording folders: what recording.toml says is what is loaded, and written again."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.calibrations.calibration_text import write_calibration
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.io.recordings.recording import Recording, View, load_recording, write_recording
from tests.io.recordings import SIZE, frame, make_recording, make_rig, make_video


def test_minimal(tmp_path):
    recording = load_recording(make_recording(tmp_path / "walk"))
    assert recording.name == "walk" and recording.folder == tmp_path / "walk"
    assert recording.rig.names == ("cam_1", "cam_2")
    assert [v.name for v in recording.views] == ["cam_1", "cam_2"]
    assert recording.views[0] == View("cam_1", video=tmp_path / "walk" / "cam_1.avi")
    assert recording.frame_rate == pytest.approx(25) and recording.n_frames == 12
    assert recording.frame_range is None and recording.frames == range(12)
    assert recording.keypoint_set is None and recording.subject_height is None
    assert recording.notes == ()
    assert set(recording.inputs) == {"calibration", "cam_1.video", "cam_2.video"}
    again = load_recording(tmp_path / "walk" / "recording.toml")
    assert again.views == recording.views
    assert np.array_equal(again.rig.projections, recording.rig.projections)


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
    assert left.image_shift == (6.0, -0.5) and left.background == folder / "plate.png"
    assert left.keypoints == folder / "pose" and left.source == folder / "cam_2.avi"
    assert right.masks == folder / "masks" and right.source is None and right.accept_scaled
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


def test_views_without_videos(tmp_path):
    """Image folders carry no frame rate, so recording.toml must."""
    for name in ("cam_1", "cam_2"):
        (tmp_path / name).mkdir(parents=True)
        for i in range(5):
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), frame(i))
    views = [{"name": n, "images": n} for n in ("cam_1", "cam_2")]
    make_recording(tmp_path, views, frame_rate=30.0)
    recording = load_recording(tmp_path)
    assert recording.n_frames == 5 and recording.frame_rate == 30
    assert recording.views[0].images == tmp_path / "cam_1"


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


def test_scaled_images_are_accepted_with_a_note(tmp_path):
    make_video(tmp_path / "cam_1.avi", size=(128, 96))
    make_video(tmp_path / "cam_2.avi")
    recording = load_recording(make_recording(tmp_path, [{"name": n, "video": f"{n}.avi"} for n in ("cam_1", "cam_2")]))
    assert len(recording.notes) == 1
    assert "cam_1.avi is 128 x 96 px, the calibration 64 x 48 px" in recording.notes[0]
    assert recording.rig[0].size == SIZE


def test_stretched_images_on_request(tmp_path):
    make_video(tmp_path / "cam_1.avi", size=(72, 48))
    make_video(tmp_path / "cam_2.avi")
    views = [{"name": n, "video": f"{n}.avi", "accept_scaled": n == "cam_1"} for n in ("cam_1", "cam_2")]
    assert "taken as scaled" in load_recording(make_recording(tmp_path, views)).notes[0]


def test_a_camera_that_went_out_is_named_with_what_the_others_have(tmp_path):
    for n, frames in enumerate((18, 10, 20), 1):
        make_video(tmp_path / f"cam_{n}.avi", frames)
    cameras = [f"cam_{n}" for n in (1, 2, 3)]
    views = [{"name": n, "video": f"{n}.avi"} for n in cameras]
    recording = load_recording(make_recording(tmp_path, views, names=cameras))
    assert recording.n_frames == 10
    assert recording.notes[0].endswith(" Without cam_2, the others' 18 frames could be tracked.")


def test_different_lengths_use_the_common_part(tmp_path):
    make_video(tmp_path / "cam_1.avi", 12)
    make_video(tmp_path / "cam_2.avi", 18)
    views = [{"name": n, "video": f"{n}.avi"} for n in ("cam_1", "cam_2")]
    recording = load_recording(make_recording(tmp_path, views))
    assert recording.n_frames == 12
    assert "different numbers of frames (cam_1 12, cam_2 18)" in recording.notes[0]
    make_video(tmp_path / "cam_2.avi", 14)
    recording = load_recording(tmp_path)
    assert recording.n_frames == 12 and recording.notes == ()


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


def test_mismatched_rig_is_refused():
    with pytest.raises(InputError, match="2 cameras for 1 views"):
        Recording(Path("."), "a", make_rig(), (View("a"),), 25.0, None)
