"""Depth maps of a view by frame number: lenses, sizes, and what is damaged."""

from dataclasses import replace

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording, View, load_recording, write_recording
from hypose.io.recordings.view_source import DepthSource
from hypose.io.sensors.depth import write_depth_png
from hypose.synthetic.rigs import look_at
from tests.depth_pictures import seen_in_room

CAMERA = look_at("d", (0, 0, 1.3), (0, 2.6, 0.6), 120.0, (160, 120))


def written(folder, frames=6):
    """A recording of a board that stands before an empty room; recording.toml's path."""
    for name, person in (("depth", True), ("room", False)):
        (folder / name).mkdir()
        for k in range(frames):
            write_depth_png(folder / name / f"{k:03d}.png", seen_in_room(CAMERA, person))
    view = View("d", depth=folder / "depth", background=folder / "room")
    rig = CameraRig((CAMERA,))
    return write_recording(Recording(folder, "r", rig, (view,), 25.0, None, keypoint_set=None, n_frames=frames), folder)


def test_one_damaged_map_costs_one_frame(tmp_path):
    toml = written(tmp_path)
    whole = (tmp_path / "depth/002.png").read_bytes()
    (tmp_path / "depth/002.png").write_bytes(whole[: len(whole) // 2])
    with FrameStream(load_recording(toml)) as frames:
        assert [bool(f.silhouettes.usable[0]) for f in frames] == [True, True, False, True, True, True]
        assert len(frames.notes) == 1 and "frame 2" in frames.notes[0] and "002.png" in frames.notes[0]


def test_a_fisheye_lens_is_straightened_without_coefficients_too(tmp_path):
    bent = replace(CAMERA, distortion=np.zeros(4), fisheye=True)
    write_depth_png(tmp_path / "0.png", np.tile(np.linspace(1, 3, 160, dtype=np.float32), (120, 1)))
    view = View("d", depth=tmp_path)
    assert (
        np.abs(DepthSource(view, bent, bent.pinhole()).map(0) - DepthSource(view, CAMERA, CAMERA).map(0)).max() > 0.02
    )


def test_a_map_of_another_size_is_named(tmp_path):
    toml = written(tmp_path)
    write_depth_png(tmp_path / "depth/003.png", seen_in_room(CAMERA)[::2, ::2])
    with FrameStream(load_recording(toml)) as frames:
        found = frames.frame(3).silhouettes
        assert not found.usable[0] and "003.png is 80 x 60 px" in found.reasons[0]


def test_large_pictures_beside_them_make_maps_no_smaller(tmp_path):
    toml = written(tmp_path)
    alone = load_recording(toml)
    large = replace(CAMERA.scaled((1280, 960)), name="c")
    beside = replace(alone, rig=CameraRig((CAMERA, large)), views=(alone.views[0], View("c")))
    with FrameStream(alone) as one, FrameStream(beside) as both:
        assert both.rig.sizes.tolist() == [[160, 120], [480, 360]]
        maps = both.frame(0).depth.maps
        assert np.array_equal(maps[0, :120, :160], one.frame(0).depth.maps[0]) and not maps[1].any()
