"""Cameras as sources: motion JPEG over the network, files at their own pace, and what cannot be opened."""

import contextlib
import re
import socket

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.virtual_cameras import CameraFaults, VirtualCameras
from hypose.errors import InputError
from hypose.io.videos import video
from hypose.io.videos.video import StreamEnded, open_camera

SIZE = (64, 48)


def jpeg(grey, size=SIZE):
    return cv2.imencode(".jpg", np.full((size[1], size[0], 3), grey, np.uint8))[1].tobytes()


def grey(shot):
    assert shot.picture.shape == (SIZE[1], SIZE[0], 3)
    return float(shot.picture.mean())


# ---- streams ----


def test_pictures_of_a_motion_jpeg_stream_come_until_it_ends():
    gone = CameraFaults(gone=(((1.5, 9.0),),))
    with VirtualCameras([[jpeg(20), jpeg(200)]], 20.0, gone) as cameras:
        source, shots = open_camera(cameras.addresses[0], 30.0, SIZE), []
        assert source.live
        with pytest.raises(StreamEnded, match="The stream http://127.* delivers nothing more"):
            while True:
                shots.append(source.read())
        source.close()
        with pytest.raises(InputError, match="cannot be opened; check the address with its name"):
            open_camera(cameras.addresses[0], 30.0, SIZE)
    greys = [grey(s) for s in shots]
    assert len(shots) > 10 and {round(g, -1) for g in greys} == {20, 200}
    assert all(0 < b.arrival - a.arrival and a.stamp is None for a, b in zip(shots, shots[1:], strict=False))


@pytest.mark.parametrize("secret", ["pa/ss", "pa#ss", "pa?ss", "p@ss", "[pass", "pa ss", "pass"])
def test_no_password_is_shown_however_it_is_written(secret, capfd):
    with pytest.raises(InputError) as refused:
        open_camera(f"http://admin:{secret}@127.0.0.1:1/video", 30.0, SIZE)
    assert "check the address" in str(refused.value)
    shown = re.sub("address|passwords?", "", "".join([str(refused.value), *capfd.readouterr()]))
    assert secret not in shown and "ss" not in shown


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.parametrize(
    ("address", "sentence"),
    [
        *((a, "The stream http://.*check the address") for a in ("http://127.0.0.1:{}/v", "http://", "http://[::1/v")),
        ("http://127.0.0.1:port/v", "The stream http://.*check the address"),
        ("rtsp://me:secret@127.0.0.1:{}/s", r"The stream rtsp://me:\.\.\.@127.* cannot be opened"),
        ("97", "Camera 97 of this computer cannot be opened"),
        ("nothing.mp4", r"There is no file nothing\.mp4"),
        ("²", "There is no file ²"),
    ],
)
def test_a_camera_that_is_not_there_is_one_sentence(address, sentence):
    with pytest.raises(InputError, match=f"^[^\n]*{sentence}[^\n]*$"):
        open_camera(address.format(free_port()), 30.0, SIZE)


# ---- files ----


class Clock:
    """Passes only while something waits, or works."""

    def __init__(self):
        self.now = 50.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        assert seconds > 0
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(video, "time", clock)
    return clock


@pytest.fixture
def folder(tmp_path):
    for n in range(10):
        cv2.imwrite(str(tmp_path / f"{n}.png"), np.full((48, 64, 3), 20 * n, np.uint8))
    return tmp_path


def played(path, rate, clock, work=0.0):
    source, out = open_camera(str(path), rate, SIZE, 50.5), []
    assert not source.live
    with contextlib.suppress(StreamEnded):
        while True:
            shot = source.read()
            out.append((round(grey(shot) / 20), shot.stamp, shot.arrival))
            clock.now += work
    source.close()
    return out


def test_who_is_too_slow_misses_pictures_as_with_a_camera(folder, clock):
    out = played(folder, 10.0, clock, work=0.25)
    numbers = [n for n, _, _ in out]
    assert numbers[:3] == [0, 2, 5] and numbers[-1] == 9 and len(set(numbers)) == len(numbers)
    assert all(s == pytest.approx(50.5 + n / 10) and a - s < 0.1 for n, s, a in out[:-1])


def test_a_file_that_is_over_says_so(folder, clock):
    source = open_camera(str(folder), 10.0, SIZE, 50.0)
    clock.now = 500.0
    assert grey(source.read()) == 180  # the last one stays until it has been seen
    with pytest.raises(StreamEnded, match="is over"):
        source.read()


def test_a_film_begins_again_and_all_cameras_with_it(folder, clock):
    source = open_camera(str(folder), 10.0, SIZE, 50.5, 1.0)
    shots = [source.read() for _ in range(25)]
    assert [round(grey(s) / 20) for s in shots] == [n % 10 for n in range(25)]
    assert [s.stamp for s in shots] == pytest.approx([50.5 + n / 10 for n in range(25)])
    assert [s.arrival for s in shots] == pytest.approx([s.stamp for s in shots])  # at their pace
    clock.now += 3.35  # what is missed is missed in later rounds, too
    shot = source.read()
    assert shot.stamp == pytest.approx(50.5 + 5.7) and round(grey(shot) / 20) == 7
