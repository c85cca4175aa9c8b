"""TRC: round trip, OpenSim's reading, real files, and files that are refused."""

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.motions.marker_files import read_trc, write_trc

NAMES = ("left_knee", "right_knee")


@pytest.fixture
def points(rng):
    p = rng.normal(0, 1, (7, 2, 3))
    p[2, 1] = p[6, 0] = p[6, 1] = np.nan  # the last row is all empty cells
    return p


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_round_trip(tmp_path, points, unit):
    write_trc(tmp_path / "a.trc", NAMES, points, 29.97, unit)
    back = read_trc(tmp_path / "a.trc")
    assert back.names == NAMES and back.units == unit and back.frame_rate == pytest.approx(29.97)
    np.testing.assert_allclose(back.points, points, atol=1e-7)


def test_file_is_y_up(tmp_path):
    write_trc(tmp_path / "a.trc", ["m"], [[[1.0, 2.0, 3.0]]], 10)
    row = (tmp_path / "a.trc").read_text().splitlines()[6].split("\t")
    assert [float(c) for c in row[2:]] == [2, 3, 1]


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_opensim_reads_the_same_points_and_gaps(tmp_path, points, opensim, unit):
    write_trc(tmp_path / "a.trc", NAMES, points, 50, unit, start_time=1.5)
    table = opensim.TimeSeriesTableVec3(str(tmp_path / "a.trc"))
    assert tuple(table.getColumnLabels()) == NAMES
    np.testing.assert_allclose(table.getIndependentColumn(), 1.5 + np.arange(7) / 50, atol=1e-9)
    rows = [table.getRowAtIndex(i) for i in range(table.getNumRows())]
    read = np.array([[row[m].to_numpy() for m in range(2)] for row in rows])
    scale = 1 if unit == "m" else 1000
    np.testing.assert_allclose(read / scale, points[..., [1, 2, 0]], atol=1e-7)
    assert table.getTableMetaDataString("Units") == unit


def test_real_files(shared_data):
    m = read_trc(shared_data("mocap") / "opencap_walking2.trc")
    assert m.points.shape == (136, 51, 3) and m.frame_rate == 100
    heights = np.nanmedian(m.points[..., 2], axis=0)
    assert heights[m.names.index("C7")] > 1.3 and heights[m.names.index("L_toe")] < 0.15


def test_pose2sim_file_has_fewer_rows_than_it_says(shared_data):
    folder = shared_data("pose2sim_balancing/pose2sim_0.10.49_output")
    m = read_trc(folder / "proj_0-99_filt_butterworth.trc")
    assert m.points.shape == (99, 22, 3)


def _lines(tmp_path):
    write_trc(tmp_path / "good.trc", NAMES, np.ones((3, 2, 3)), 30)
    return (tmp_path / "good.trc").read_text().split("\n")


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (0, "something else", "does not start with PathFileType"),
        (2, "30\t30\t3\tmany\tm\t30\t1\t3", "no number for NumMarkers"),
        (2, "30\t30\t3\t900000000\tm\t30\t1\t3", "NumMarkers 9e\\+08"),
        (2, "nan\t30\t3\t2\tm\t30\t1\t3", "DataRate nan"),
        (2, "30\t30\t3\t2\tfurlong\t30\t1\t3", "unit 'furlong'"),
        (2, "30\t30\t3\t3\tm\t30\t1\t3", "names 2 markers, but NumMarkers says 3"),
        (7, "2\t0.03\t1\t2\t3\t4\t5\t6\t7", "line 8 has 7 cells"),
        (7, "2\t0.03\t1\t2\t3\t4\t5", "line 8 has 5 cells"),
        (7, "2\t0.03\t1\t2\tx\t4\t5\t6", "line 8 holds something that is not a number"),
        (7, "2\t0.03\t1\t2\tinf\t4\t5\t6", "line 8 holds an infinite number"),
    ],
)
def test_malformed_files_are_refused_in_one_sentence(tmp_path, line, text, message):
    lines = _lines(tmp_path)
    lines[line] = text
    (tmp_path / "bad.trc").write_text("\n".join(lines))
    with pytest.raises(InputError, match=message) as error:
        read_trc(tmp_path / "bad.trc")
    assert "bad.trc" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "does not exist"),
        (b"", "is empty"),
        (b"\0\1\2" * 99, "binary file"),
        (b"one line", "is not a TRC"),
    ],
)
def test_foreign_files_are_refused(tmp_path, content, message):
    path = tmp_path / "x.trc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_trc(path)


def test_header_without_frames_is_refused(tmp_path):
    (tmp_path / "x.trc").write_text("\n".join(_lines(tmp_path)[:6]) + "\n")
    with pytest.raises(InputError, match="no frames"):
        read_trc(tmp_path / "x.trc")


@pytest.mark.parametrize(
    ("names", "points", "rate", "message"),
    [
        (["a", "a"], np.zeros((1, 2, 3)), 30, "'a' occurs twice"),
        (["a"], np.zeros((1, 2, 3)), 30, "need points of shape"),
        (["a"], np.zeros((0, 1, 3)), 30, "at least one frame"),
        (["a\tb"], np.zeros((1, 1, 3)), 30, "tab or line break"),
        (["a"], np.zeros((1, 1, 3)), 0, "frame rate"),
        (["a"], np.full((1, 1, 3), np.inf), 30, "infinite"),
    ],
)
def test_bad_points_are_refused_and_leave_no_file(tmp_path, names, points, rate, message):
    with pytest.raises(InputError, match=message):
        write_trc(tmp_path / "a.trc", names, points, rate)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_trc(tmp_path / "file" / "a.trc", ["m"], np.zeros((1, 1, 3)), 30)
