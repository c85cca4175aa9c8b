"""A recording folder from recordings of depth cameras: the floor, the frames' instants, lenses, and what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.calibration.depth_registration import CoarseAlignment
from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, EvidenceError, InputError
from hypose.geometry import se3_inverse
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.recordings.frames import FrameStream, working_rig
from hypose.io.recordings.recording import load_recording
from hypose.io.sensors.depth import DepthFile, DepthFrame, read_depth_png, write_depth_png
from hypose.pipeline import import_depth as module
from hypose.pipeline.import_depth import RegisteredSensors, import_depth
from hypose.synthetic.scenes import look_at
from tests.depth_pictures import seen_in_room

LENS = np.array([-0.25, 0.05, 0.0, 0.0, 0.0])


def camera(name="cam", size=(160, 120), distortion=LENS):
    return replace(look_at(name, (0, 0, 1.3), (0, 2.6, 0.4), 0.75 * size[0], size), distortion=distortion)


def folder(path, own, maps, numbers=None, steps=1.0):
    """A folder of maps with its lens beside them, whose place is nobody's affair."""
    path.mkdir(parents=True)
    for k, m in zip(range(len(maps)) if numbers is None else numbers, maps, strict=True):
        write_depth_png(path / f"{k:06d}.png", m / steps)
    write_calibration(CameraRig((replace(own, name="lens", camera_from_world=np.eye(4)),)), path / "calibration.toml")
    return path


def test_the_floor_is_found_through_a_lens_that_bends(tmp_path):
    own = camera()
    source = folder(tmp_path / "my maps", own, [seen_in_room(own)] * 3)
    path, notes = import_depth([source], tmp_path / "rec")
    made = load_recording(path)
    placed = se3_inverse(made.rig[0].camera_from_world)
    assert placed[2, 3] == pytest.approx(1.3, abs=0.01)
    assert np.degrees(np.arccos(placed[2, :3] @ se3_inverse(own.camera_from_world)[2, :3])) < 0.4
    assert np.allclose(made.rig[0].distortion, LENS) and made.rig.names == ("my maps",)
    assert made.frame_rate == 30 and "30 per s are taken" in notes[0] and " m above the floor" in notes[1]


def test_values_of_another_unit_are_noticed_and_can_be_said(tmp_path):
    own = camera(distortion=np.zeros(5))
    source = folder(tmp_path / "fifths", own, [seen_in_room(own)] * 2, steps=0.2)
    with pytest.raises(InputError, match=r"fifths: the camera would hang 6.50 m .* --millimetres"):
        import_depth([source], tmp_path / "rec")
    path, _ = import_depth([source], tmp_path / "rec", frame_rate=12.5, millimetres=0.2)
    made = load_recording(path)
    assert made.frame_rate == 12.5 and made.rig[0].position[2] == pytest.approx(1.3, abs=0.01)


def test_lost_frames_leave_their_instants_empty(tmp_path):
    own = camera(distortion=np.zeros(5))
    shown = [seen_in_room(own, x=x) for x in np.linspace(-0.5, 0.5, 8)]
    kept = [0, 1, 2, 5, 6, 7]
    source = folder(tmp_path / "cam", own, [shown[k] for k in kept], numbers=[10 + 2 * k for k in kept])
    _, notes = import_depth([source], tmp_path / "rec")
    files = sorted((tmp_path / "rec/depth/cam").iterdir())
    assert len(files) == 8 and "2 of 8 frames were lost" in notes[-1]
    for k, file in enumerate(files):
        expected = shown[k] if k in kept else 0 * shown[k]
        assert np.abs(read_depth_png(file) - expected).max() < 6e-4
    assert not (tmp_path / "rec/read").exists()


def recorded(monkeypatch, by_name):
    """Recordings that tell when each frame was seen: (camera, times, maps) by name."""

    def opened(path, *_):
        own, times, maps = by_name[path.name if hasattr(path, "name") else path]
        return DepthFile(own, (DepthFrame(t, m) for t, m in zip(times, maps, strict=True)))

    monkeypatch.setattr(module, "open_depth", opened)


def test_times_decide_which_map_is_which_frame(tmp_path, monkeypatch, rng):
    """Rounded to milliseconds, with a frame lost, and one reported twice."""
    own = camera(distortion=np.zeros(5))
    numbers = np.r_[np.arange(40), np.arange(41, 90)]
    times = np.round(0.46 + numbers / 30 + rng.uniform(-0.002, 0.002, len(numbers)), 3)
    maps = [np.where(seen_in_room(own) > 0, 2 + 0.01 * n, 0) for n in numbers]
    maps[:9] = [seen_in_room(own)] * 9
    recorded(monkeypatch, {"a.bag": (own, np.insert(times, 20, times[19]), [*maps[:20], maps[0], *maps[20:]])})
    path, notes = import_depth(["a.bag"], tmp_path / "rec")
    assert load_recording(path).frame_rate == 30 and "1 of 90 frames" in notes[-1]
    files = sorted((tmp_path / "rec/depth/a").iterdir())
    found = [read_depth_png(f).max() for f in files]
    assert found[40] == 0
    assert found[50] == pytest.approx(2.5) and found[89] == pytest.approx(2.89)
    recorded(monkeypatch, {"a.bag": (own, 0 * times, maps)})
    with pytest.raises(InputError, match="a.bag does not tell when"):
        import_depth(["a.bag"], tmp_path / "other")
    recorded(monkeypatch, {"a.bag": (own, np.r_[times[:20], times[20:] + 60], maps)})
    with pytest.raises(InputError, match="frames are missing between"):
        import_depth(["a.bag"], tmp_path / "other")


def two_cameras(monkeypatch):
    """One that began 0.2 s before the other, by clocks of their own; who walks in comes into both after a while."""
    named = {}
    for name, epoch, ahead in (("a.mkv", 0.46, 6), ("b.mkv", 0.0, 0)):
        own = camera(name[0])
        shown = [seen_in_room(own, person=k - ahead >= 12) for k in range(ahead + 40)]
        named[name] = own, epoch + np.arange(len(shown)) / 30, shown
        named[f"empty-{name}"] = own, np.zeros(1), [seen_in_room(own, person=False)]
    recorded(monkeypatch, named)
    return ["a.mkv", "b.mkv"], ["empty-a.mkv", "empty-b.mkv"]


def test_cameras_brought_together_keep_their_lenses_and_begin_together(tmp_path, monkeypatch):
    sources, empty = two_cameras(monkeypatch)
    looked_at = []

    def together(clips, frame_rate, **_):
        looked_at.append([(c[0].index, c[0].time) for c in clips])
        rig = working_rig(CameraRig(tuple(c[0].depth.rig[0] for c in clips))).scaled(0.5)
        apart = np.eye(4)
        apart[0, 3] = 2.0
        moved = replace(rig[1], camera_from_world=rig[1].camera_from_world @ apart)
        seconds = np.array([0.0, 6 / frame_rate + 0.004])
        return RegisteredSensors(CameraRig((rig[0], moved)), seconds, (CoarseAlignment(apart, seconds[1], 0.02),))

    monkeypatch.setattr(module, "register_depth", together)
    path, notes = import_depth(sources, tmp_path / "rec", empty=empty)
    # nobody is there before
    assert looked_at == [[(18, pytest.approx(18 / 30)), (12, pytest.approx(12 / 30))]]
    made = load_recording(path)
    for own, placed in zip((camera("a"), camera("b")), made.rig, strict=True):
        assert placed.size == own.size and np.allclose(placed.K, own.K) and np.allclose(placed.distortion, LENS)
    assert np.linalg.norm(made.rig[1].position - made.rig[0].position) == pytest.approx(2, abs=0.02)
    assert made.n_frames == 40 and "clock +0.204 s" in notes[-1]
    with FrameStream(made) as frames:  # both see somebody from the same frame on
        assert [frames.frame(k).silhouettes.usable.tolist() for k in (11, 12)] == [[False] * 2, [True] * 2]


@pytest.mark.parametrize("error", [CalibrationError("do not fit"), KeyboardInterrupt()])
def test_what_is_not_finished_leaves_nothing(tmp_path, monkeypatch, error):
    sources, empty = two_cameras(monkeypatch)

    def fails(*_, **__):
        raise error

    monkeypatch.setattr(module, "register_depth", fails)
    with pytest.raises(type(error)):
        import_depth(sources, tmp_path, empty=empty)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "depth").mkdir()
    with pytest.raises(InputError, match="holds depth already"):
        import_depth(sources, tmp_path, empty=empty)
    assert (tmp_path / "depth").is_dir()


def test_what_cannot_be_used_is_named(tmp_path, monkeypatch):
    sources, empty = two_cameras(monkeypatch)
    own, times, maps = camera("c", (80, 60)), np.arange(3) / 30, [seen_in_room(camera("c", (80, 60)))] * 3
    blind = [np.zeros_like(m) for m in maps]
    recorded(
        monkeypatch, {"c.bag": (own, times, maps), "d.bag": (camera(), times, blind), "e.bag": (own, times, blind)}
    )
    with pytest.raises(InputError, match=r"e.bag has maps of 80 x 60 px, d.bag of 160 x 120 px"):
        import_depth(["d.bag"], tmp_path / "rec", empty=["e.bag"])
    with pytest.raises(EvidenceError, match="e.bag: The depth map shows no floor"):
        import_depth(["e.bag"], tmp_path / "rec")
    nobody = own, times, [seen_in_room(own, person=False)] * 3
    recorded(monkeypatch, {"c.bag": nobody, "f.bag": nobody})
    with pytest.raises(EvidenceError, match="c shows no person"):
        import_depth(["c.bag", "f.bag"], tmp_path / "rec", empty=["c.bag", "f.bag"])
    monkeypatch.undo()
    tiny = folder(tmp_path / "tiny", camera(), [seen_in_room(camera()) / 1000])
    with pytest.raises(InputError, match=r"tiny: the camera would hang 0.00 m .* --millimetres"):
        import_depth([tiny], tmp_path / "rec")
    small = folder(tmp_path / "small", camera(), [seen_in_room(own)])
    with pytest.raises(InputError, match=r"000000.png is 80 x 60 px, the lens in .* is for 160 x 120 px"):
        import_depth([small], tmp_path / "rec")


def test_a_recording_that_is_given_twice_is_named(tmp_path):
    own = camera()
    source = folder(tmp_path / "maps", own, [seen_in_room(own)])
    again = tmp_path / "again" / ".." / "maps"
    (tmp_path / "again").mkdir()
    for sources, empty in (([source, again], []), (["a", "b"], [source, again])):
        with pytest.raises(InputError, match="maps is given twice"):
            import_depth(sources, tmp_path / "rec", empty=empty)
