"""C3D: ezc3d reads what we write to 0.001 mm, our reader agrees with ezc3d on real files and refuses
damaged ones."""

import struct

import ezc3d
import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.motions.marker_files import read_c3d, write_c3d


@pytest.fixture
def points(rng):
    p = rng.normal(0, 1, (12, 3, 3))
    p[5, 1] = np.nan
    return p


def test_ezc3d_reads_to_a_micrometre(tmp_path, points):
    residuals = np.full((12, 3), 4.2)
    residuals[3] = 0
    write_c3d(tmp_path / "a.c3d", ["a", "b", "c"], points, 59.94, residuals)
    file = ezc3d.c3d(str(tmp_path / "a.c3d"))
    read = file["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(read, points * 1000, atol=1e-3)
    assert file["parameters"]["POINT"]["LABELS"]["value"] == ["a", "b", "c"]
    assert file["parameters"]["POINT"]["UNITS"]["value"] == ["mm"]
    assert file["parameters"]["POINT"]["Y_SCREEN"]["value"] == ["+Z"]
    assert file["parameters"]["POINT"]["RATE"]["value"][0] == pytest.approx(59.94)
    got = file["data"]["meta_points"]["residuals"][0].T
    # whole millimetres: 4.2 is rounded up; computed points 0; points not seen -1
    assert got[0, 0] == 5 and (got[3] == 0).all() and got[5, 1] == -1


def test_several_subjects_and_events(tmp_path, points):
    names, subjects = ["Anna:a", "Anna:b", "Ben:a"], ["Anna", "Ben"]
    write_c3d(tmp_path / "a.c3d", names, points, 50, events=[(0.1, "Left", "Foot Strike")], subjects=subjects)
    about = ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]
    assert about["SUBJECTS"]["NAMES"]["value"] == subjects and about["SUBJECTS"]["USED"]["value"][0] == 2
    assert about["SUBJECTS"]["LABEL_PREFIXES"]["value"] == ["Anna:", "Ben:"]
    assert about["SUBJECTS"]["USES_PREFIXES"]["value"][0] == 1
    assert about["EVENT"]["SUBJECTS"]["value"] == ["Anna"]
    assert read_c3d(tmp_path / "a.c3d").names == tuple(names)
    write_c3d(tmp_path / "b.c3d", ["a", "b", "c"], points, 50)
    assert "SUBJECTS" not in ezc3d.c3d(str(tmp_path / "b.c3d"))["parameters"]


def test_a_file_of_rotations_alone_says_what_to_export(tmp_path):
    file = ezc3d.c3d()
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["a"]
    for group in ("POINT", "ANALOG"):
        file["parameters"][group]["RATE"]["value"] = [100.0]
    file["data"]["points"], file["data"]["analogs"] = np.zeros((4, 0, 5)), np.zeros((1, 1, 5))
    file.add_parameter("ROTATION", "RATE", [100.0])
    file.add_parameter("ROTATION", "LABELS", ["thigh"])
    file["data"]["rotations"] = np.tile(np.eye(4)[:, :, None, None], (1, 1, 1, 5))
    file.write(str(tmp_path / "theia.c3d"))
    with pytest.raises(InputError, match="rotations and positions of segments, as Theia3D writes them, and no points"):
        read_c3d(tmp_path / "theia.c3d")


def test_more_than_255_points_roll_over(tmp_path, rng):
    names = [f"m{i}" for i in range(600)]
    points = rng.normal(0, 1, (4, 600, 3))
    write_c3d(tmp_path / "a.c3d", names, points, 50)
    assert len(ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]["POINT"]["LABELS"]["value"]) == 255
    back = read_c3d(tmp_path / "a.c3d")
    assert back.names == tuple(names)
    np.testing.assert_allclose(back.points, points, atol=1e-6)


def test_more_frames_than_the_format_counts_are_refused(tmp_path):
    with pytest.raises(InputError, match="at most 65535 frames, these are 65536"):
        write_c3d(tmp_path / "a.c3d", ["a"], np.zeros((65536, 1, 3)), 50)


@pytest.mark.parametrize("name", ["kinematics_tennis_serve.c3d", "kinematics_tennis_serve_nan.c3d", "walking2.c3d"])
def test_real_files_agree_with_ezc3d(shared_data, name):
    path = shared_data("mocap") / name
    mine, file = read_c3d(path), ezc3d.c3d(str(path))
    scale = {"mm": 1e-3, "m": 1}[file["parameters"]["POINT"]["UNITS"]["value"][0]]
    np.testing.assert_allclose(mine.points, file["data"]["points"][:3].transpose(2, 1, 0) * scale, rtol=1e-12)
    assert list(mine.names) == file["parameters"]["POINT"]["LABELS"]["value"]
    assert mine.frame_rate == pytest.approx(file["parameters"]["POINT"]["RATE"]["value"][0])


def _integer_file(order):
    """A C3D by hand: 2 points, 3 frames, one analog channel, 16-bit integers, scale 0.1, in a byte order."""
    end = ">" if order == 86 else "<"

    def real(x):
        if order != 85:
            return struct.pack(end + "f", x)
        bits = struct.unpack("<I", struct.pack("<f", x * 4))[0]  # VAX F: exponent bias 2 larger, halves exchanged
        return struct.pack("<HH", bits >> 16, bits & 0xFFFF)

    def entry(name, group, body):
        return struct.pack("bb", len(name), group) + name + struct.pack(end + "h", len(body) + 2) + body

    labels = b"A   BB  "
    section = struct.pack("BBBB", 1, 0x50, 1, order)
    section += entry(b"POINT", -1, b"\0")
    section += entry(b"SCALE", 1, struct.pack("bB", 4, 0) + real(0.1) + b"\0")
    section += entry(b"LABELS", 1, struct.pack("bBBB", -1, 2, 4, 2) + labels + b"\0")
    section += entry(b"UNITS", 1, struct.pack("bBB", -1, 1, 2) + b"mm" + b"\0")
    head = struct.pack("BB", 2, 0x50) + struct.pack(end + "5H", 2, 1, 1, 3, 10) + real(0.1)
    head += struct.pack(end + "2H", 3, 1) + real(100.0)
    frames = np.array([[k, 10 * k, -k, 0, 5, 6, 7, -1 if k == 2 else 3, 99] for k in range(3)], dtype=end + "i2")
    return head.ljust(512, b"\0") + section.ljust(512, b"\0") + frames.tobytes()


@pytest.mark.parametrize("order", [84, 85, 86])
def test_integer_files_of_all_byte_orders(tmp_path, order):
    (tmp_path / "i.c3d").write_bytes(_integer_file(order))
    m = read_c3d(tmp_path / "i.c3d")
    assert m.names == ("A", "BB") and m.frame_rate == pytest.approx(100)
    k = np.arange(3)
    np.testing.assert_allclose(m.points[:, 0], np.stack([k, 10 * k, -k], 1) * 1e-4, atol=1e-9)
    assert np.isnan(m.points[2, 1]).all() and np.isfinite(m.points[:2, 1]).all()
