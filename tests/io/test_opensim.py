"""MOT: OpenSim reads names, degrees and metres; without it, the text itself is checked."""

import numpy as np
import pytest

from hypose.body.joint_angles import is_length, joint_angles
from hypose.errors import InputError
from hypose.io.motions.marker_files import write_mot


@pytest.fixture
def angles(small_motion):
    return joint_angles(small_motion.skeleton, small_motion.poses)


def _expected(names, values):
    return values * [1 if is_length(n) else 180 / np.pi for n in names]


def test_text(tmp_path, angles, small_motion):
    names, values = angles
    write_mot(tmp_path / "a.mot", names, values, small_motion.times)
    head, body = (tmp_path / "a.mot").read_text().split("endheader\n")
    assert "inDegrees=yes" in head and "nRows=60" in head and "nColumns=33" in head
    header, *rows = body.splitlines()
    assert header.split("\t")[:3] == ["time", "pelvis_tilt", "pelvis_list"] and "neck_flexion" in header
    table = np.array([[float(c) for c in row.split("\t")] for row in rows])
    np.testing.assert_allclose(table, np.c_[small_motion.times, _expected(names, values)], atol=1e-8)


def test_opensim_reads_the_table_and_the_storage(tmp_path, angles, small_motion, opensim):
    names, values = angles
    write_mot(tmp_path / "a.mot", names, values, small_motion.times)
    table = opensim.TimeSeriesTable(str(tmp_path / "a.mot"))
    assert table.getTableMetaDataString("inDegrees") == "yes"
    labels = ["neck_flexion" if n == "neck_extension" else n for n in names]
    assert list(table.getColumnLabels()) == labels
    np.testing.assert_allclose(table.getIndependentColumn(), small_motion.times, atol=1e-8)
    np.testing.assert_allclose(table.getMatrix().to_numpy(), _expected(names, values), atol=1e-7)
    storage = opensim.Storage(str(tmp_path / "a.mot"))
    assert storage.isInDegrees() and storage.getSize() == 60


def test_frames_that_are_not_finite_are_left_out(tmp_path, angles, small_motion):
    names, values = angles
    values = values.copy()
    values[5] = np.nan
    write_mot(tmp_path / "a.mot", names, values, small_motion.times)
    text = (tmp_path / "a.mot").read_text()
    assert "nRows=59" in text and "nan" not in text.lower()


@pytest.mark.parametrize(
    ("values", "times", "message"),
    [
        (np.zeros((2, 3)), [0, 1], "got \\(2, 3\\)"),
        (np.zeros((2, 1)), [1, 1], "must increase"),
        (np.full((2, 1), np.nan), [0, 1], "no frame has finite"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, values, times, message):
    with pytest.raises(InputError, match=message):
        write_mot(tmp_path / "a.mot", ["knee_angle_r"], values, times)
