"""All motion files of one tracked motion, by format name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hypose.body.body import Body
from hypose.body.joint_angles import ANGLE_NAMES, joint_angles
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.io.motions.angles import write_angles_csv, write_joints_csv
from hypose.io.motions.bvh import write_bvh
from hypose.io.motions.c3d import write_c3d
from hypose.io.motions.opensim import write_mot, write_sd_sto
from hypose.io.motions.opensim_ik import write_ik_markers, write_ik_setup
from hypose.io.motions.opensim_model import shoulder_places, write_osim
from hypose.io.motions.rerun_file import rerun_module, write_rrd
from hypose.io.motions.trc import write_trc


def _trc(motion: Motion, body: Body, folder: Path) -> list[Path]:
    path = folder / "motion.trc"
    start = float(motion.times[0])
    write_trc(path, motion.skeleton.joint_names, motion.joints, motion.frame_rate, start_time=start)
    return [path]


def _c3d(motion: Motion, body: Body, folder: Path) -> list[Path]:
    path = folder / "motion.c3d"
    computed = (motion.lost | motion.extrapolated).astype(bool)
    # a standard deviation of exactly 0 is still a measurement, so keep it off the mark for computed points
    residuals = np.where(computed[:, None], 0.0, np.maximum(motion.joint_sd * 1000, 1e-3))
    write_c3d(path, motion.skeleton.joint_names, motion.joints, motion.frame_rate, residuals)
    return [path]


def _bvh(motion: Motion, body: Body, folder: Path) -> list[Path]:
    path = folder / "motion.bvh"
    write_bvh(path, motion)
    return [path]


def _glb(motion: Motion, body: Body, folder: Path) -> list[Path]:
    from hypose.io.motions.gltf import write_glb  # takes long to import

    path = folder / "motion.glb"
    write_glb(path, motion, body)
    return [path]


def _csv(motion: Motion, body: Body, folder: Path) -> list[Path]:
    joints = folder / "joints.csv"
    write_joints_csv(joints, motion)
    if motion.poses is None:  # joint positions alone have no angles
        return [joints]
    angles = folder / "angles.csv"
    write_angles_csv(angles, *joint_angles(motion.skeleton, motion.poses), motion.times, motion.angle_sd)
    return [angles, joints]


def _mot(motion: Motion, body: Body, folder: Path) -> list[Path]:
    path = folder / "motion.mot"
    assert motion.poses is not None  # export_motion has checked
    names, values = joint_angles(motion.skeleton, motion.poses)
    more, places = shoulder_places(motion.skeleton, motion.poses)
    write_mot(path, (*names, *more), np.concatenate([values, places], axis=1), motion.times)
    if motion.angle_sd is None or not np.isfinite(motion.angle_sd).all(1).any():
        return [path]
    sd = folder / "motion_sd.sto"
    write_sd_sto(sd, ANGLE_NAMES, motion.angle_sd, motion.times)
    return [path, sd]


def _osim(motion: Motion, body: Body, folder: Path) -> list[Path]:
    model, markers, setup = (folder / f"motion{end}" for end in (".osim", "_markers.trc", "_ik.xml"))
    write_osim(model, body)
    write_ik_markers(markers, motion, body)
    write_ik_setup(setup, motion, body, model.name, markers.name, "motion_ik.mot")
    return [model, markers, setup]


def _rrd(motion: Motion, body: Body, folder: Path) -> list[Path]:
    path = folder / "motion.rrd"
    write_rrd(path, motion, body)
    return [path]


FORMATS: Mapping[str, Callable[[Motion, Body, Path], list[Path]]] = {
    "trc": _trc,
    "c3d": _c3d,
    "bvh": _bvh,
    "glb": _glb,
    "csv": _csv,
    "mot": _mot,
    "osim": _osim,
}
EXTRAS: Mapping[str, Callable[[Motion, Body, Path], list[Path]]] = {"rrd": _rrd}
"""Formats that need an extra to be installed, so that nobody gets them unasked."""
_NEED_POSES = ("bvh", "glb", "mot", "osim")


def known_formats(asked: Sequence[str]) -> Mapping[str, Callable[[Motion, Body, Path], list[Path]]]:
    """All formats; an InputError for one that is asked for and does not exist, or lacks what it needs here."""
    known = {**FORMATS, **EXTRAS}
    unknown = [f for f in asked if f not in known]
    if unknown:
        raise InputError(f"There is no export format {unknown[0]!r}; the formats are {', '.join(known)}.")
    if "rrd" in asked:
        rerun_module()
    return known


def export_motion(
    motion: Motion, body: Body, folder: str | Path, formats: Sequence[str] = tuple(FORMATS)
) -> list[Path]:
    """Write the motion into a folder in the named formats and return the paths.

    trc, c3d, bvh, glb and mot give motion.<format>, csv gives angles.csv and joints.csv, mot also motion_sd.sto where
    the angles' sd is known; osim gives motion.osim, the model of this body on which motion.mot plays, and
    motion_markers.trc and motion_ik.xml for OpenSim's inverse kinematics; rrd, with the extra
    [rerun], motion.rrd. Each file appears whole or not at all. Lost and extrapolated
    frames keep their predicted points: TRC has no mark for them, C3D gives them residual 0 (computed, not measured),
    joints.csv has a column for each flag. An InputError names an unknown format, or one that needs poses when the
    motion has none, before anything is written.
    """
    known = known_formats(formats)
    if not len(motion):
        raise InputError("The motion has no frames, so there is nothing to export.")
    if motion.poses is None and (wanting := [f for f in formats if f in _NEED_POSES]):
        raise InputError(
            f"The format {wanting[0]} needs poses, this motion holds joint positions only; choose "
            f"{', '.join(f for f in known if f not in _NEED_POSES)}."
        )
    return [path for name in dict.fromkeys(formats) for path in known[name](motion, body, Path(folder))]
