"""Virtual cameras send what real ones do: pictures at their time, with their faults, each connection for itself."""

import pytest

from benchmarks.synthetic.virtual_cameras import CameraFaults, VirtualCameras
from hypose.errors import InputError
from hypose.io.videos.camera_sources import StreamEnded, open_camera
from tests.conftest import HANG_S

CLIPS = [[b"%d-%d" % (view, n) for n in range(6)] for view in range(2)]


def test_which_picture_is_shown():
    cameras = VirtualCameras(CLIPS, 10.0, first=[[b"empty"] * 3] * 2)
    cameras._server.server_close()
    assert [cameras.picture(1, n) for n in (0, 2, 3, 8, 9)] == [b"empty", b"empty", b"1-0", b"1-5", b"1-4"]
    shown = [cameras.shown(cameras.begin + s) for s in (0.0, 0.3, 0.55, 0.8, 0.95, 1.3)]
    assert shown == pytest.approx([-3.0, 0.0, 2.5, 5.0, 3.5, 0.0], abs=1e-6)
    one = VirtualCameras([[b"a"], [b"b"]], 10.0)
    one._server.server_close()
    assert one.shown(one.begin + 5) == 0.0 and one.picture(1, 7) == b"b"


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
