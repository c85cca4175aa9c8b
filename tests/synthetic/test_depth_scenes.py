"""Simulated depth cameras: repeatable, with the faults they are said to have, and recordings that are read back."""

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.geometry import se3_inverse
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.recorded_frames import check_views, people_frames
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.depth_scenes import depth_rig, depth_scene
from hypose.synthetic.motions import act
from hypose.synthetic.subjects import load_subjects
from hypose.synthetic.write_recording import walking_scene, write_depth_scene


@pytest.fixture(scope="module")
def scene():
    subject = load_subjects()["neutral"]
    p = act("walk", subject, 0.4, 25.0, np.random.default_rng(4))
    return depth_scene(p, subject, "depth-2", seed=3)


def test_the_same_seed_gives_the_same_maps_in_any_order(scene):
    again = depth_scene(scene.performance, scene.subject, "depth-2", seed=3)
    assert np.array_equal(again.depth_map(1, 5), scene.depth_map(1, 5))
    assert np.array_equal(scene.depth_map(0, 2), scene.depth_map(0, 2))
    other = depth_scene(scene.performance, scene.subject, "depth-2", seed=4)
    assert not np.array_equal(other.depth_map(1, 5), scene.depth_map(1, 5))


def test_sensors_by_name():
    front, side = (c.position for c in depth_rig("depth-2"))
    assert abs(front[:2] @ side[:2]) < 1e-9 and front[1] < 0
    for name in ("depth-0", "depth-9", "kinect"):
        with pytest.raises(InputError, match="depth-1 to depth-8"):
            depth_rig(name)


def test_a_recording_is_read_back_as_depth(tmp_path):
    made = walking_scene("walk", "", "depth-1", seconds=0.2, frame_rate=25.0, seed=2)
    write_depth_scene(made, tmp_path / "rec")
    loaded = load_recording(tmp_path / "rec")
    assert "depth" in loaded.views[0].files and loaded.n_frames == len(made)
    check_views(loaded)  # one depth camera is enough
    with pytest.raises(InputError, match="depth1 is a depth camera"):
        check_views(loaded, of_picture=True)
    with pytest.raises(InputError, match=r"depth cameras \(depth1\) .* not by key points"):
        people_frames(loaded, TrackOptions(evidence="both"))
    with FrameStream(loaded) as frames:
        frame = frames.frame(2)
        assert frame.depth is not None and frame.silhouettes is not None
        assert np.array_equal(frame.depth.maps[0], made.depth_map(0, 2))
        assert frame.silhouettes.masks[0].sum() == pytest.approx(made.clean_map(0, 2)[1].sum(), rel=0.1)
        assert frames.pictures()[0].image(2).shape == (288, 320, 3)
        for k in (4, 0):
            assert np.array_equal(frames.frame(k).depth.maps[0], made.depth_map(0, k))
    assert np.allclose(loaded.rig[0].camera_from_world, made.rig[0].camera_from_world, atol=1e-6)
    assert se3_inverse(loaded.rig[0].camera_from_world)[2, 3] == pytest.approx(1.2, abs=1e-6)


def test_what_is_wrong_with_a_depth_view_is_named(tmp_path):
    made = walking_scene("walk", "", "depth-1", seconds=0.1, frame_rate=25.0, seed=2)
    toml = write_depth_scene(made, tmp_path / "rec")
    text = toml.read_text()
    toml.write_text(text.replace('background = "background/depth1"', 'background = "truth.npz"'))
    with pytest.raises(InputError, match="View depth1: the background of a depth view is a folder"):
        load_recording(toml)
    toml.write_text(text.replace("depth = ", 'masks = "background/depth1"\ndepth = '))
    with pytest.raises(InputError, match="a depth camera is a view of its own"):
        load_recording(toml)
