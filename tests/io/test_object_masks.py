import struct
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.io.recordings.object_masks import ObjectMasks, open_masks
from hypose.io.recordings.recording import load_recording
from tests.evidence.scenes import ring
from tests.io.recordings import write_toml

SIZE = (64, 48)
LABELS = np.zeros(SIZE[::-1], np.uint8)
LABELS[10:40, 5:20], LABELS[12:44, 40:56] = 1, 2


def write_palette_png(path, labels, bits=8):
    """A PNG with a palette whose colours are dark: their brightest channel would lose them."""
    palette = bytes([0, 0, 0, 90, 0, 0, 0, 100, 0, 0, 0, 110])
    if bits == 2:
        packed = (labels[:, 0::4] << 6) | (labels[:, 1::4] << 4) | (labels[:, 2::4] << 2) | labels[:, 3::4]
    else:
        packed = labels
    rows = b"".join(b"\x00" + r.tobytes() for r in packed)
    h, w = labels.shape

    def piece(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", w, h, bits, 3, 0, 0, 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + piece(b"IHDR", header)
        + piece(b"PLTE", palette)
        + piece(b"IDAT", zlib.compress(rows))
        + piece(b"IEND", b"")
    )


def write_images(folder, images):
    folder.mkdir(parents=True, exist_ok=True)
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / f"{i:04d}.png"), image)
    return folder


def check(found, names=("1", "2")):
    assert isinstance(found, ObjectMasks)
    assert found.size == SIZE and found.objects == names
    there = found.at(1)
    assert np.array_equal(there[names[0]], LABELS == 1) and np.array_equal(there[names[1]], LABELS == 2)
    assert np.array_equal(found.union(1), LABELS > 0)
    assert np.array_equal(found.union(1, frozenset({names[1]})), LABELS == 2)
    assert found.read(1).shape == (48, 64, 3) and found.read(1).max() == 255
    with pytest.raises(InputError, match="ends with frame"):
        found.at(found.n_frames)


@pytest.mark.parametrize("bits", [2, 8])
def test_palette_images(tmp_path, bits):
    for i in range(3):
        write_palette_png(tmp_path / "m" / f"{i}.png", LABELS, bits)
    check(open_masks(tmp_path / "m"))


def test_masks_of_one_kind_stay_what_they_were(tmp_path):
    white = (LABELS > 0) * np.uint8(255)
    for n, images in enumerate(([white] * 3, [cv2.blur(white, (3, 3))] * 3, [(LABELS > 0).astype(np.uint8)] * 3)):
        assert not isinstance(open_masks(write_images(tmp_path / str(n), images)), ObjectMasks)
    soft = white.copy()
    soft[LABELS == 1] = 127  # not sure
    assert not isinstance(open_masks(write_images(tmp_path / "soft", [soft] * 3)), ObjectMasks)
    colours = np.dstack([white, white // 2, white])
    assert not isinstance(open_masks(write_images(tmp_path / "colours", [colours] * 3)), ObjectMasks)


def test_one_folder_per_object(tmp_path):
    write_images(tmp_path / "m" / "anna", [(LABELS == 1) * np.uint8(255)] * 3)
    write_images(tmp_path / "m" / "bert", [(LABELS == 2) * np.uint8(255)] * 3)
    (tmp_path / "m" / "bert" / "0002.png").unlink()  # has left
    found = open_masks(tmp_path / "m")
    check(found, ("anna", "bert"))
    assert found.n_frames == 3 and set(found.at(2)) == {"anna"}


def drawn(camera, places, numbers):
    """Labels of two upright boxes of 0.4 x 0.3 x 1.7 m at places (2,) m."""
    out = np.zeros(camera.size[::-1], np.uint8)
    order = np.argsort([-np.linalg.norm(np.append(p, 0.9) - camera.position) for p in places])
    for i in order:
        x = np.array([[sx * 0.2, sy * 0.15, z] for sx in (-1, 1) for sy in (-1, 1) for z in (0, 1.7)])
        uv = camera.project_pinhole(x + np.append(places[i], 0.0))
        cv2.fillConvexPoly(out, cv2.convexHull(np.rint(uv).astype(np.int32)), int(numbers[i]))
    return out


def test_which_object_is_whom_is_found(tmp_path):
    """Every view numbers two people in its own way; one of them is not in all views."""
    rig = ring(4, radius=4.5)
    rig = CameraRig(tuple(replace(c, name=f"cam{i}") for i, c in enumerate(rig)))
    write_calibration(rig, tmp_path / "calibration.toml")
    numbers = [(1, 2), (2, 1), (7, 3), (1, 2)]
    for c, camera in enumerate(rig):
        images = []
        for t in range(8):
            labels = drawn(camera, [(-0.8 + 0.1 * t, 0.2), (0.9, -0.5)], numbers[c])
            if c == 3:
                labels[labels == numbers[c][1]] = 0
            if c == 3 and t == 0:
                labels[:3, :3] = 9  # something else, for a moment
            images.append(labels)
        write_images(tmp_path / f"m{c}", images)
    views = [{"name": f"cam{c}", "masks": f"m{c}"} for c in range(4)]
    write_toml(tmp_path / "recording.toml", {"frame_rate": 25.0, "view": views})
    recording = load_recording(tmp_path)
    with FrameStream(recording, FrameSettings(longer_side=10_000)) as stream:
        assert any("several objects" in n and "cam2 7" in n for n in stream.notes)
        for t in (0, 5):
            masks = stream.frame(t).silhouettes.masks
            for c, camera in enumerate(rig):
                labels = drawn(camera, [(-0.8 + 0.1 * t, 0.2), (0.9, -0.5)], numbers[c])
                assert (masks[c] != (labels == numbers[c][0])).sum() < 0.03 * (labels > 0).sum()
    with FrameStream(recording, FrameSettings(longer_side=10_000, people=True)) as all_people:
        assert all_people.tells_apart and any("cam3 9" in n and "left out" in n for n in all_people.notes)
        masks = all_people.frame(5).silhouettes.masks
        for c, camera in enumerate(rig):
            labels = drawn(camera, [(-0.3, 0.2), (0.9, -0.5)], numbers[c])
            shown = labels == numbers[c][0] if c == 3 else labels > 0
            assert (masks[c] != shown).sum() < 0.03 * (labels > 0).sum()
