"""CSV tables, and the export of all formats at once."""

import csv
from dataclasses import replace

import ezc3d
import numpy as np
import pytest

from hypose.body.joint_angles import ANGLE_NAMES, joint_angles
from hypose.errors import InputError
from hypose.io.motions.c3d import read_c3d
from hypose.io.motions.export import FORMATS, export_motion
from hypose.io.motions.marker_files import read_trc, write_angles_csv, write_joints_csv


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
    doubtful = np.arange(len(small_motion)) == 3
    write_joints_csv(tmp_path / "j.csv", replace(small_motion, joint_covariance=unknown, doubtful=doubtful))
    header, rows = _table(tmp_path / "j.csv")
    assert header[:5] == ["time_s", "lost", "extrapolated", "n_views", "doubtful"]
    assert [int(r["doubtful"]) for r in rows] == doubtful.astype(int).tolist()
    assert [int(r["lost"]) for r in rows] == small_motion.lost.astype(int).tolist()
    assert [int(r["extrapolated"]) for r in rows] == small_motion.extrapolated.astype(int).tolist()
    knee = small_motion.skeleton.joint("left_knee")
    got = [float(rows[7][f"left_knee_{c}_m"]) for c in ("x", "y", "z", "sd")]
    assert got == pytest.approx([*small_motion.joints[7, knee], 0.0042], abs=1e-6)
    assert rows[7]["chest_sd_m"] == "" and rows[7]["chest_x_m"] != ""


def test_export_writes_every_format(tmp_path, small_motion, small_body):
    paths = export_motion(small_motion, small_body, tmp_path / "out", tuple(FORMATS))
    names = {p.name for p in paths}
    assert names == {
        "motion.trc",
        "motion.c3d",
        "motion.bvh",
        "motion.glb",
        "motion.mot",
        "motion.osim",
        "motion_markers.trc",
        "motion_ik.xml",
        "angles.csv",
        "joints.csv",
    }
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
    with pytest.raises(InputError, match=f"no export format 'fbx'; the formats are {', '.join(FORMATS)}"):
        export_motion(small_motion, small_body, tmp_path, ["fbx"])
    assert not list(tmp_path.iterdir())


def test_a_motion_without_frames_is_refused(tmp_path, small_motion, small_body):
    empty = replace(
        small_motion,
        **{
            k: getattr(small_motion, k)[:0]
            for k in ("times", "joints", "poses", "joint_covariance", "lost", "extrapolated", "n_views", "cost")
        },
    )
    with pytest.raises(InputError, match="no frames"):
        export_motion(empty, small_body, tmp_path, ["trc"])
