"""Export of a tracked motion to the motion file formats, which are chosen by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hypose.body.body import Body
from hypose.body.joint_angles import ANGLE_NAMES, joint_angles
from hypose.body.motion import Motion, region_reach
from hypose.errors import InputError, extra
from hypose.io.files import atomic_path
from hypose.io.formats import Format, FormatTable
from hypose.io.motions.animation import write_bvh, write_glb
from hypose.io.motions.marker_files import (
    joint_residuals,
    read_c3d,
    read_mot,
    read_trc,
    write_angles_csv,
    write_c3d,
    write_joints_csv,
    write_mot,
    write_trc,
)
from hypose.io.motions.opensim_model import shoulder_places, write_ik_markers, write_ik_setup, write_osim
from hypose.io.motions.results import load_result

# ---- rerun file ----------------------------------------------------------------------------------------------------
# Rerun recordings (.rrd): the body, its skeleton and the 90 % regions of its joints over time, for Rerun's viewer.
#
# The world is the recording's, metres, z up; times are the motion's, in seconds. Frames that are lost or predicted
# are in another colour. Only this format needs the extra [rerun].


_SURE, _UNSURE = (51, 122, 183), (217, 83, 79)
_SKIN = (204, 168, 143, 160)
_RADIUS = 0.012


def write_rrd(path: str | Path, motion: Motion, body: Body) -> None:
    """Write a motion as a Rerun recording: the skeleton, 90 % regions of its joints, and the body's surface where it
    has poses.

    Raises: InputError where rerun-sdk is not installed.
    """
    from scipy.spatial.transform import Rotation  # takes long to import

    rr = rerun_module()
    skeleton = motion.skeleton
    bones = [(int(p), j) for j, p in enumerate(skeleton.parents) if p >= 0]
    unsure = (motion.lost | motion.extrapolated).astype(bool)
    values, axes = np.linalg.eigh(np.nan_to_num(np.asarray(motion.joint_covariance, dtype=np.float64)))
    reach = region_reach(0.9) * np.sqrt(np.maximum(values, 0.0))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1  # rotations, not reflections
    with atomic_path(path) as temporary:
        stream = rr.RecordingStream("hypose", recording_id=Path(path).stem)
        stream.save(str(temporary))
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for t, time in enumerate(motion.times):
            joints = motion.joints[t]
            colour = _UNSURE if unsure[t] else _SURE
            seen = np.isfinite(joints).all(1)
            stream.set_time("time", duration=float(time))
            stream.set_time("frame", sequence=t)
            lines = [joints[[a, b]] for a, b in bones if seen[a] and seen[b]]
            stream.log("person/bones", rr.LineStrips3D(lines, colors=[colour] * len(lines), radii=_RADIUS / 2))
            names = [n for n, s in zip(skeleton.joint_names, seen, strict=True) if s]
            stream.log(
                "person/joints",
                rr.Points3D(joints[seen], colors=[colour] * len(names), radii=_RADIUS, labels=names, show_labels=False),
            )
            known = seen & np.isfinite(motion.joint_covariance[t]).all((1, 2))
            turns = Rotation.from_matrix(axes[t, known]).as_quat() if known.any() else np.zeros((0, 4))
            where = {"centers": joints[known], "half_sizes": reach[t, known], "quaternions": turns}
            stream.log("person/regions_90", rr.Ellipsoids3D(**where, colors=[(*colour, 90)] * int(known.sum())))
            if motion.poses is not None and np.isfinite(motion.poses[t]).all():
                mesh = rr.Mesh3D(
                    vertex_positions=body.skin(motion.poses[t]), triangle_indices=body.coarse.faces, albedo_factor=_SKIN
                )
                stream.log("person/body", mesh)
        stream.flush()
        stream.disconnect()


def rerun_module() -> Any:  # noqa: ANN401 (a module)
    """Import the package of Rerun; InputError where it is not installed."""
    return extra("rerun", "A Rerun recording", "rerun", "rerun-sdk")


def _in_one_file(name: str, write: Callable[[Path, Motion, Body], None]) -> Callable[[Motion, Body, Path], list[Path]]:
    """Make the writer of a format with one file of this name."""

    def written(motion: Motion, body: Body, folder: Path) -> list[Path]:
        write(folder / name, motion, body)
        return [folder / name]

    return written


def _csv(motion: Motion, body: Body, folder: Path) -> list[Path]:
    joints, angles = folder / "joints.csv", folder / "angles.csv"
    write_joints_csv(joints, motion)
    if motion.poses is None:  # joint positions alone have no angles
        return [joints]
    write_angles_csv(angles, *joint_angles(motion.skeleton, motion.poses), motion.times, motion.angle_sd)
    return [angles, joints]


def _mot(motion: Motion, body: Body, folder: Path) -> list[Path]:
    assert motion.poses is not None  # export_motion has checked
    path, sd = folder / "motion.mot", folder / "motion_sd.sto"
    names, values = joint_angles(motion.skeleton, motion.poses)
    more, places = shoulder_places(motion.skeleton, motion.poses)
    write_mot(path, (*names, *more), np.concatenate([values, places], axis=1), motion.times)
    if motion.angle_sd is None or not np.isfinite(motion.angle_sd).all(1).any():
        return [path]
    # as OpenSim's storage: same columns, same units; OpenSim plots such a file, and tools weigh coordinates by it
    write_mot(sd, ANGLE_NAMES, motion.angle_sd, motion.times)
    return [path, sd]


def _osim(motion: Motion, body: Body, folder: Path) -> list[Path]:
    model, markers, setup = (folder / name for name in ("motion.osim", "motion_markers.trc", "motion_ik.xml"))
    write_osim(model, body)
    write_ik_markers(markers, motion, body)
    write_ik_setup(setup, motion, body, model.name, markers.name)
    return [model, markers, setup]


_POSES = "needs poses: joint positions alone are not enough"
MOTION_FILES = FormatTable(
    "a motion",
    "give results of hypose, .c3d, .trc, .mot or .sto",
    (
        Format(
            "trc",
            (".trc",),
            lambda source: read_trc(source.path),
            write=_in_one_file(
                "motion.trc",
                lambda path, motion, _: write_trc(
                    path, motion.skeleton.joint_names, motion.joints, motion.frame_rate, float(motion.times[0])
                ),
            ),
            precision=1e-7,
        ),
        Format(
            "c3d",
            (".c3d",),
            lambda source: read_c3d(source.path),
            write=_in_one_file(
                "motion.c3d",
                lambda path, motion, _: write_c3d(
                    path, motion.skeleton.joint_names, motion.joints, motion.frame_rate, joint_residuals(motion)
                ),
            ),
            limits="32-bit floats of millimetres; at most 65 535 frames",
            precision=1e-6,
        ),
        Format(
            "bvh",
            (".bvh",),
            write=_in_one_file("motion.bvh", lambda path, motion, _: write_bvh(path, motion)),
            limits=_POSES,
        ),
        Format("glb", (".glb",), write=_in_one_file("motion.glb", write_glb), limits=_POSES),
        Format("csv", (".csv",), write=_csv, limits="six digits"),
        Format(
            "mot", (".mot", ".sto"), lambda source: read_mot(source.path), write=_mot, limits=_POSES, precision=1e-8
        ),
        Format("osim", (".osim",), write=_osim, limits=_POSES),
        Format("rrd", (".rrd",), write=_in_one_file("motion.rrd", write_rrd), limits="needs the extra [rerun]"),
        Format("npz", (".npz", "/"), lambda source: load_result(source.path)),
    ),
)
"""Motions: readers of a source that return Markers, the columns of `read_mot`, or a Motion; writers of motion and body
to a folder, which return the written files."""
_WRITERS = {f.name: f for f in MOTION_FILES.formats if f.write is not None}
MOTION_FORMATS = tuple(name for name in _WRITERS if name != "rrd")
"""Names of the formats that are written by default; those that need an extra are written on request only."""


def known_formats(asked: Sequence[str]) -> None:
    """Check the names of requested export formats.

    Raises: InputError for a format that does not exist or whose package is not installed.
    """
    if unknown := [f for f in asked if f not in _WRITERS]:
        raise InputError(f"There is no export format {unknown[0]!r}; the formats are {', '.join(_WRITERS)}.")
    if "rrd" in asked:
        rerun_module()


def export_motion(
    motion: Motion, body: Body, folder: str | Path, formats: Sequence[str] = MOTION_FORMATS
) -> list[Path]:
    """Write a motion to a folder in the given formats.

    Each file is written whole or not at all. The formats give these files:
    trc, c3d, bvh, glb: motion.<format>.
    csv: joints.csv and, where the motion has poses, angles.csv.
    mot: motion.mot, and motion_sd.sto where the standard deviations of the angles are known.
    osim: motion.osim, the model of this body on which motion.mot plays; motion_markers.trc and motion_ik.xml for
        OpenSim's inverse kinematics.
    rrd: motion.rrd; needs the extra [rerun].

    Lost and extrapolated frames keep their predicted points. TRC does not mark them, C3D gives them residual 0
    (computed, not measured), and joints.csv has a column for each flag.

    Returns: the written paths.
    Raises: InputError before anything is written, where a format is unknown, or needs poses that the motion does not
        have, or where there are no frames.
    """
    known_formats(formats)
    if not len(motion):
        raise InputError("The motion has no frames, so there is nothing to export.")
    points_only = [name for name, f in _WRITERS.items() if f.limits != _POSES]
    if motion.poses is None and (wanting := [f for f in formats if f not in points_only]):
        raise InputError(
            f"The format {wanting[0]} needs poses, this motion holds joint positions only; choose "
            f"{', '.join(points_only)}."
        )
    written: list[Path] = []
    for write in (_WRITERS[name].write for name in dict.fromkeys(formats)):
        written += write(motion, body, Path(folder)) if write is not None else []
    return written
