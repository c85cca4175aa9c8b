"""TRC: round trip, OpenSim's reading, real files, and files that are refused."""

import csv
from dataclasses import replace

import ezc3d
import numpy as np
import pytest

from hypose.body.joint_angles import ANGLE_NAMES, is_length, joint_angles
from hypose.errors import InputError
from hypose.io.motions.export import MOTION_FORMATS, export_motion
from hypose.io.motions.marker_files import read_c3d, read_trc, write_angles_csv, write_joints_csv, write_mot, write_trc

NAMES = ("left_knee", "right_knee")


@pytest.fixture
def points(rng):
    p = rng.normal(0, 1, (7, 2, 3))
    p[2, 1] = p[6, 0] = p[6, 1] = np.nan  # the last row is all empty cells
    return p


def test_file_is_y_up_and_may_be_in_millimetres(tmp_path):
    write_trc(tmp_path / "a.trc", ["m"], [[[1.0, 2.0, 3.0]]], 10)
    text = (tmp_path / "a.trc").read_text()
    assert [float(c) for c in text.splitlines()[6].split("\t")[2:]] == [2, 3, 1]
    (tmp_path / "a.trc").write_text(text.replace("\tm\t", "\tmm\t"))
    np.testing.assert_allclose(read_trc(tmp_path / "a.trc").points, [[[0.001, 0.002, 0.003]]])


def test_opensim_reads_the_same_points_and_gaps(tmp_path, points, opensim):
    write_trc(tmp_path / "a.trc", NAMES, points, 50, start_time=1.5)
    table = opensim.TimeSeriesTableVec3(str(tmp_path / "a.trc"))
    assert tuple(table.getColumnLabels()) == NAMES and table.getTableMetaDataString("Units") == "m"
    np.testing.assert_allclose(table.getIndependentColumn(), 1.5 + np.arange(7) / 50, atol=1e-9)
    rows = [table.getRowAtIndex(i) for i in range(table.getNumRows())]
    read = np.array([[row[m].to_numpy() for m in range(2)] for row in rows])
    np.testing.assert_allclose(read, points[..., [1, 2, 0]], atol=1e-7)


def test_real_files(shared_data):
    m = read_trc(shared_data("mocap") / "opencap_walking2.trc")
    assert m.points.shape == (136, 51, 3) and m.frame_rate == 100
    heights = np.nanmedian(m.points[..., 2], axis=0)
    assert heights[m.names.index("C7")] > 1.3 and heights[m.names.index("L_toe")] < 0.15
    fewer = shared_data("pose2sim_balancing/pose2sim_0.10.49_output") / "proj_0-99_filt_butterworth.trc"
    assert read_trc(fewer).points.shape == (99, 22, 3)  # its header says one row more


# ---- test opensim --------------------------------------------------------------------------------------------------
# MOT: OpenSim reads names, degrees and metres; without it, the text itself is checked.


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


def test_angles_of_no_frame_are_one_sentence(tmp_path):
    with pytest.raises(InputError, match="no frame has finite"):
        write_mot(tmp_path / "a.mot", ["knee_angle_r"], np.full((2, 1), np.nan), [0, 1])


# ---- test angles ---------------------------------------------------------------------------------------------------
# CSV tables, and the export of all formats at once.


def _table(path):
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, [dict(zip(header, row, strict=True)) for row in rows]


def test_angles_are_degrees_and_metres(tmp_path, small_motion):
    names, values = joint_angles(small_motion.skeleton, small_motion.poses)
    values[3] = np.nan
    write_angles_csv(tmp_path / "a.csv", names, values, small_motion.times)
    header, rows = _table(tmp_path / "a.csv")
    assert header[0] == "time_s" and "knee_angle_l_deg" in header and "pelvis_ty_m" in header
    assert len(header) == 1 + len(ANGLE_NAMES) and len(rows) == 60
    for t in (0, 20):
        assert float(rows[t]["time_s"]) == pytest.approx(small_motion.times[t], abs=1e-6)
        knee = values[t, names.index("knee_angle_l")]
        assert float(rows[t]["knee_angle_l_deg"]) == pytest.approx(np.degrees(knee), abs=1e-5)
        assert float(rows[t]["pelvis_ty_m"]) == pytest.approx(small_motion.joints[t, 0, 2], abs=1e-6)
    assert rows[3]["knee_angle_l_deg"] == ""


def test_joints_have_sd_and_flags(tmp_path, small_motion):
    unknown = small_motion.joint_covariance.copy()
    unknown[7, 2] = np.nan
    low_confidence = np.arange(len(small_motion)) == 3
    write_joints_csv(tmp_path / "j.csv", replace(small_motion, joint_covariance=unknown, low_confidence=low_confidence))
    header, rows = _table(tmp_path / "j.csv")
    assert header[:5] == ["time_s", "lost", "extrapolated", "n_views", "low_confidence"]
    assert [int(r["low_confidence"]) for r in rows] == low_confidence.astype(int).tolist()
    assert [int(r["lost"]) for r in rows] == small_motion.lost.astype(int).tolist()
    assert [int(r["extrapolated"]) for r in rows] == small_motion.extrapolated.astype(int).tolist()
    knee = small_motion.skeleton.joint("left_knee")
    got = [float(rows[7][f"left_knee_{c}_m"]) for c in ("x", "y", "z", "sd")]
    assert got == pytest.approx([*small_motion.joints[7, knee], 0.0042], abs=1e-6)
    assert rows[7]["chest_sd_m"] == "" and rows[7]["chest_x_m"] != ""


def test_export_writes_every_format(tmp_path, small_motion, small_body):
    paths = export_motion(small_motion, small_body, tmp_path / "out", tuple(MOTION_FORMATS))
    names = {p.name for p in paths}
    assert names == {*(f"motion.{e}" for e in ("trc", "c3d", "bvh", "glb", "mot", "osim")), "motion_markers.trc",
                     "motion_ik.xml", "angles.csv", "joints.csv"}  # fmt: skip
    assert sorted(names) == sorted(p.name for p in (tmp_path / "out").iterdir())  # no temporary file stays
    for markers in (read_trc(tmp_path / "out" / "motion.trc"), read_c3d(tmp_path / "out" / "motion.c3d")):
        assert markers.names == small_motion.skeleton.joint_names
        np.testing.assert_allclose(markers.points, small_motion.joints, atol=1e-6)


def test_c3d_marks_lost_and_predicted_frames(tmp_path, small_motion, small_body):
    (path,) = export_motion(small_motion, small_body, tmp_path, ["c3d"])
    residuals = ezc3d.c3d(str(path))["data"]["meta_points"]["residuals"][0].T
    computed = small_motion.lost | small_motion.extrapolated
    assert (residuals[computed] == 0).all()
    assert (residuals[~computed] == 5).all()  # sd 4.2 mm, rounded up


def test_positions_alone_can_be_written_as_points(tmp_path, small_motion, small_body):
    motion = replace(small_motion, poses=None)
    paths = export_motion(motion, small_body, tmp_path, ["trc", "c3d", "csv"])
    assert [p.name for p in paths] == ["motion.trc", "motion.c3d", "joints.csv"]
    for wanting in ("bvh", "glb", "mot", "osim"):
        with pytest.raises(InputError, match=f"{wanting} needs poses.*choose trc, c3d, csv"):
            export_motion(motion, small_body, tmp_path / wanting, ["trc", wanting])
        assert not (tmp_path / wanting).exists()  # refused before anything is written


def test_unknown_format_is_one_sentence(tmp_path, small_motion, small_body):
    with pytest.raises(InputError, match=f"no export format 'fbx'; the formats are {', '.join(MOTION_FORMATS)}"):
        export_motion(small_motion, small_body, tmp_path, ["fbx"])
    assert not list(tmp_path.iterdir())


def test_a_motion_without_frames_is_refused(tmp_path, small_motion, small_body):
    series = ("times", "joints", "poses", "joint_covariance", "lost", "extrapolated", "n_views", "cost")
    empty = replace(small_motion, **{k: getattr(small_motion, k)[:0] for k in series})
    with pytest.raises(InputError, match="no frames"):
        export_motion(empty, small_body, tmp_path, ["trc"])
