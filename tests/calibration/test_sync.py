"""Offsets between cameras: from motion, sound and light; evidence resampled in time."""

import wave

import numpy as np
import pytest

from benchmarks.cameras.sync_accuracy import late_scene, seen_masks, seen_points
from hypose.calibration.synchronisation import (
    Resampled,
    light_event,
    offsets_from_light,
    offsets_from_motion,
    offsets_from_sound,
)
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.silhouettes import make_silhouettes
from hypose.io.videos.video import Sound, read_sound
from hypose.synthetic.scenes import camera_rig as named_rig


@pytest.mark.parametrize("evidence", ["keypoints", "silhouettes"])
def test_offsets_of_a_walk_are_found_to_a_fifth_of_a_frame(evidence):
    late = np.array([0.0, 2.5, -3.7, 5.0])
    scene, shown = late_scene("walk", 3, late, seconds=3.2)
    points, masks = (np.zeros((4, 0, 0, 2)), np.zeros((4, 0, 0))), ()
    if evidence == "keypoints":
        points = seen_points(scene, shown)
    else:
        masks = seen_masks(scene, shown, 0.35)
    found = offsets_from_motion(scene.rig.pinhole(), points, masks)
    wrong = found.frames - late
    assert np.abs(wrong - np.median(wrong)).max() < 0.2
    assert found.gain > 10 and (found.sd < 1).all()


def test_too_few_frames_are_told():
    rig = named_rig("ring-2")
    with pytest.raises(EvidenceError, match="at least 16 consecutive frames"):
        offsets_from_motion(rig, (np.zeros((2, 12, 25, 2)), np.ones((2, 12, 25))))


class _Moving:
    """Two views of a square that moves two pixels a frame."""

    def __init__(self, late):
        self.late, self.rig = late, named_rig("ring-2").pinhole().scaled(0.1)

    def __len__(self):
        return 12

    def frame(self, index, /):
        masks, points = [], np.zeros((2, 1, 3))
        for c in range(2):
            w, h = self.rig[c].size
            mask = np.zeros((h, w), np.uint8)
            x = int(10 + 2 * (index - self.late[c]))
            mask[10:30, x : x + 16] = 1
            masks.append(mask)
            points[c, 0] = x, 20, 0.9
        return Frame(index / 25, index, make_silhouettes(masks, self.rig), Keypoints(points, ("nose",), self.rig))


def test_resampled_frames_are_in_step_and_tell_what_is_missing():
    source = Resampled(_Moving((0, 1.5)), (0.0, 1.5))
    frame = source.frame(5)
    assert frame.keypoints.points[1, 0, 0] == pytest.approx(frame.keypoints.points[0, 0, 0], abs=0.51)
    both = frame.silhouettes.masks
    assert (both[0] & both[1]).sum() / (both[0] | both[1]).sum() > 0.9
    last = source.frame(11).silhouettes
    assert not last.usable[1] and "has no image" in last.reasons[1] and last.usable[0]
    with pytest.raises(InputError, match="3 offsets are given for 2 views"):
        Resampled(_Moving((0, 0)), (0, 1, 2)).frame(0)
    with pytest.raises(InputError, match="finite"):
        Resampled(_Moving((0, 0)), (0, np.nan))


def test_sound_tells_the_offset_to_a_millisecond(rng):
    rate = 16000
    true = rng.normal(size=4 * rate) * 0.1
    true[20000:20400] += 5 * rng.normal(size=400)
    heard = [Sound(rate, true[1000 + k : 1000 + k + 2 * rate]) for k in (0, 800, 3200)]
    seconds, peaks = offsets_from_sound(heard, ["a", "b", "c"], 1.0)
    assert np.allclose(seconds - seconds[0], [0, -0.05, -0.2], atol=1e-3) and (peaks > 20).all()


def test_sounds_of_different_places_are_told(rng):
    sounds = [Sound(16000, rng.normal(size=32000)) for _ in range(2)]
    with pytest.raises(EvidenceError, match="no sound in common"):
        offsets_from_sound(sounds, ["a", "b"])
    with pytest.raises(EvidenceError, match="b: the sound is silent"):
        offsets_from_sound([sounds[0], Sound(16000, np.zeros(32000))], ["a", "b"])


def test_a_lamp_gives_a_fraction_of_a_frame_and_a_flash_its_centre():
    t = np.arange(100)
    levels = [80 + 30 * np.clip(t + 1 - at, 0, 1) for at in (50.25, 52.5, 47.0)]
    late, kinds = offsets_from_light(levels, ["a", "b", "c"])
    assert np.allclose(late, np.array([50.25, 52.5, 47.0]) - 50.25, atol=0.02) and set(kinds) == {"lamp"}
    flash = np.full(60, 80.0)
    flash[30] = 200
    assert light_event(flash, "a") == (pytest.approx(30.5, abs=0.05), "flash")
    with pytest.raises(EvidenceError, match="no flash and no lamp"):
        light_event(80 + np.sin(t), "a")


def test_sound_beside_a_video_is_read(tmp_path):
    samples = (np.sin(np.arange(8000) / 5) * 20000).astype(np.int16)
    with wave.open(str(tmp_path / "cam1.wav"), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(np.repeat(samples, 2).tobytes())
    found = read_sound(tmp_path / "cam1.mp4")
    assert found.rate == 8000 and len(found.samples) == 8000
    assert np.allclose(found.samples, samples / 32767, atol=1e-9)
    (tmp_path / "cam2.wav").write_bytes(b"RIFF....")
    with pytest.raises(InputError, match="no WAV file"):
        read_sound(tmp_path / "cam2.mp4")
