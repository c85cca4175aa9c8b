import json

import numpy as np
import pytest

from hypose.evidence.keypoints import BODY_25
from hypose.io.recordings.recording import load_recording
from hypose.io.videos.video import VideoReader
from hypose.synthetic.scenes import keypoint_detections, make_scene
from hypose.synthetic.write_recording import write_scene


@pytest.fixture(scope="module")
def written(person, tmp_path_factory):
    scene = make_scene("walk", person, "ixmas-5", seconds=0.4, seed=2, distorted=True)
    folder = tmp_path_factory.mktemp("synthetic")
    steps = []
    write_scene(scene, folder, background_frames=5, keypoints=True, progress=lambda a, b: steps.append((a, b)))
    return scene, folder, steps


def test_a_recording_that_loads(written):
    scene, folder, steps = written
    r = load_recording(folder)
    assert (len(r.rig), r.n_frames, r.frame_rate) == (5, 10, 25.0)
    (note,) = r.notes  # says what the files were taken for, and nothing else
    assert note.startswith("Key points: OpenPose files, BODY_25 (stated)")
    assert r.keypoint_set == "BODY_25" and all({"background", "keypoints"} <= v.files.keys() for v in r.views)
    assert steps[-1] == (75, 75)
    for written_camera, camera in zip(r.rig, scene.given_rig, strict=True):
        # stored to the even size of the video, otherwise the same camera
        assert written_camera.size == (390, 290) and np.allclose(written_camera.K, camera.K)
        point = np.array([0.2, -0.3, 1.1])
        assert np.allclose(written_camera.project(point), camera.project(point), atol=1e-6)


def test_videos_hold_the_pictures(written):
    scene, folder, _ = written
    reader = VideoReader(folder / "videos" / "cam2.mp4")
    assert reader.n_frames == 10
    picture = reader.read(4).astype(int)
    assert np.abs(picture - scene.rgb_frame(1, 4)[:290]).mean() < 6
    assert VideoReader(folder / "background" / "cam2.mp4").n_frames == 5


def test_keypoint_files_match_the_detections(written):
    scene, folder, _ = written
    files = sorted((folder / "pose" / "cam1_json").iterdir())
    assert len(files) == 10
    flat = json.loads(files[3].read_text())["people"][0]["pose_keypoints_2d"]
    assert np.allclose(np.reshape(flat, (25, 3)), keypoint_detections(scene, 0)[3], atol=1e-3)


def test_detections_lie_where_the_joints_are_seen(person):
    scene = make_scene("walk", person, "humaneva-4", seconds=4.0, seed=2, distorted=True)
    d = keypoint_detections(scene, 1, noise_px=4.0)
    k = BODY_25.index("left_knee")
    seen = d[:, k, 2] > 0
    error = d[seen, k, :2] - scene.rig[1].project(scene.joints[seen, 14])
    assert 2.0 < np.median(np.abs(error)) / 0.6745 < 6.5
    assert 0.9 < (d[..., 2] > 0).mean() < 1.0
    assert np.array_equal(d, keypoint_detections(scene, 1, noise_px=4.0))
