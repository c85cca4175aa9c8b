"""Virtual cameras send what real ones do: pictures at their time, with their faults, each connection for itself."""

import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from benchmarks.synthetic.virtual_cameras import CameraFaults, VirtualCameras, there_and_back
from hypose.errors import InputError
from hypose.io.videos.camera_sources import StreamEnded, open_camera
from tests.conftest import HANG_S

CLIPS = [[b"%d-%d" % (view, n) for n in range(6)] for view in range(2)]


def test_a_clip_is_played_there_and_back():
    assert [there_and_back(n, 4) for n in range(9)] == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert [there_and_back(n, 1) for n in range(3)] == [0, 0, 0]


def test_which_picture_is_shown():
    cameras = VirtualCameras(CLIPS, 10.0, first=[[b"empty"] * 3] * 2)
    cameras._server.server_close()
    assert [cameras.picture(1, n) for n in (0, 2, 3, 8, 9)] == [b"empty", b"empty", b"1-0", b"1-5", b"1-4"]
    shown = [cameras.shown(cameras.begin + s) for s in (0.0, 0.3, 0.55, 0.8, 0.95, 1.3)]
    assert shown == pytest.approx([-3.0, 0.0, 2.5, 5.0, 3.5, 0.0], abs=1e-6)
    one = VirtualCameras([[b"a"], [b"b"]], 10.0)
    one._server.server_close()
    assert one.shown(one.begin + 5) == 0.0 and one.picture(1, 7) == b"b"


def sent(faults, view=0, count=40, rate=100.0):
    """(picture's number, stamp or None) of what a view sends, without waiting: its time passes as it is waited for."""
    cameras = VirtualCameras([[b"%d" % n for n in range(1000)]] * 2, rate, faults, seed=5)
    cameras._server.server_close()
    out = []

    def write(data):
        head, _, body = data.partition(b"\r\n\r\n")
        lines = dict(line.split(b": ") for line in head.split(b"\r\n")[1:])
        assert int(lines[b"Content-Length"]) == len(body) - 2
        out.append((int(body), float(lines[b"X-Timestamp"]) if b"X-Timestamp" in lines else None))
        if len(out) == count:
            cameras._ended.set()

    cameras.play(view, write)
    return np.array(out, float)


def test_pictures_come_in_their_order_and_at_their_pace():
    begin = time.monotonic()
    numbers = sent(CameraFaults())[:, 0]
    assert (np.diff(numbers) >= 1).all() and time.monotonic() - begin > 0.35  # never sooner


def test_lost_pictures_do_not_come():
    numbers = sent(CameraFaults(lost=0.5), count=30)[:, 0]
    assert numbers[-1] - numbers[0] > 42


def test_late_pictures_show_what_was_and_stamps_are_those_of_the_cameras_clock():
    late = sent(CameraFaults(late=(0.1, 0.0), stamps=True), count=20)
    assert np.round(100 * late[:, 1] - late[:, 0])[12:] == pytest.approx(10)
    other = sent(CameraFaults(stamps=True), view=1, count=3)
    assert (other[:, 1] > 1000).all()  # each has a time of its own


def test_what_is_sent_is_read_as_from_a_camera():
    clips = [[b"\xff\xd8" + b"%d" % n for n in range(100)]] * 2
    with VirtualCameras(clips, 50.0, CameraFaults(stamps=True)) as cameras:
        source = open_camera(cameras.addresses[1], 50.0, (64, 48))
        shots = [source.read() for _ in range(5)]
        source.close()
    assert all(s.data[:2] == b"\xff\xd8" and s.stamp is not None for s in shots)
    numbers = [int(s.data[2:]) for s in shots]
    assert numbers == sorted(numbers) and len(set(numbers)) == 5


def test_a_camera_that_is_unplugged_ends_its_stream_refuses_and_comes_back():
    with VirtualCameras([[b"\xff\xd8"] * 10] * 2, 50.0) as cameras:
        source = open_camera(cameras.addresses[1], 50.0, (64, 48))
        cameras.faults = CameraFaults(gone=((), ((0.0, HANG_S),)))
        with pytest.raises(StreamEnded):
            while True:
                source.read()
        source.close()
        assert cameras.away(1) and not cameras.away(0)
        with pytest.raises(InputError, match="cannot be opened"):
            open_camera(cameras.addresses[1], 50.0, (64, 48))
        other = open_camera(cameras.addresses[0], 50.0, (64, 48))
        assert other.read().data == b"\xff\xd8"
        other.close()
        cameras.faults = CameraFaults(gone=((), ((-2.0, -1.0),)))
        again = open_camera(cameras.addresses[1], 50.0, (64, 48))
        assert again.read().data == b"\xff\xd8"
        again.close()


def test_other_addresses_are_not_found():
    with VirtualCameras(CLIPS, 10.0) as cameras:
        for path in ("", "2", "x", "0/1"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"http://127.0.0.1:{cameras._server.server_port}/{path}", timeout=HANG_S)
