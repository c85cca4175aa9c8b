"""Motions of any program to compare with: results of hypose, C3D, TRC, and MOT or STO of OpenSim, as points and angles
by hypose's names.

Points that are named like joints (RKnee, left_knee, LKJC) are those joints. Two markers on either side of a joint are
its centre (r_knee_study and r_mknee_study of OpenCap's and Pose2Sim's augmenter; others by `joint=marker+marker`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hypose.body.joint_angles import joint_angles
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.keypoint_sets import common_name
from hypose.geometry import Array
from hypose.io.motions.c3d import read_c3d
from hypose.io.motions.marker_files import read_mot, read_trc
from hypose.io.motions.results import load_result

_PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_CENTRES = {"s": "shoulder", "e": "elbow", "w": "wrist", "h": "hip", "k": "knee", "a": "ankle"}


@dataclass(frozen=True)
class OtherMotion:
    """times (T,) s; points by joint name (T, 3) m, NaN where not seen; angles by OpenSim's name (T,) rad, or m; notes:
    sentences on what was left out."""

    path: Path
    times: Array
    points: Mapping[str, Array] = field(default_factory=dict)
    angles: Mapping[str, Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_other(
    path: Path, joints: Mapping[str, Sequence[str]] | None = None, subject: str | None = None
) -> OtherMotion:
    """The motion of any file that can be compared with. joints: marker names whose mean is a joint, by joint name, for
    what the names do not tell. subject: whose points, of a file in which several people's are named SUBJECT:POINT. An
    InputError when nothing in the file is known, or not which of several people is meant."""
    ending = path.suffix.lower()
    if path.is_dir() or ending == ".npz":
        motion = load_result(path)
        names = motion.skeleton.joint_names
        points = {n: motion.joints[:, i] for i, n in enumerate(names)}
        return OtherMotion(path, motion.times, points, angles_of(motion))
    if ending in (".mot", ".sto"):
        times, names, values = read_mot(path)
        return OtherMotion(path, times, {}, {n: values[:, i] for i, n in enumerate(names)})
    if ending not in (".c3d", ".trc"):
        raise InputError(f"{path} cannot be compared with; give results of hypose, .c3d, .trc, .mot or .sto.")
    markers = read_c3d(path) if ending == ".c3d" else read_trc(path)
    names, kept = _of_subject(path, markers.names, subject)
    twice = {n for n in names if names.count(n) > 1}
    notes = (
        (f"{path.name} has several points of the name {', '.join(sorted(twice))}, which are left out.",)
        if twice
        else ()
    )
    single = [i for i, n in enumerate(names) if n not in twice]
    names, kept = tuple(names[i] for i in single), [kept[i] for i in single]
    points = _joints_of(path, names, markers.points[:, kept], joints or {})
    return OtherMotion(path, np.arange(len(markers.points)) / markers.frame_rate, points, notes=notes)


def angles_of(motion: Motion) -> dict[str, Array]:
    """Joint angles (T,) rad, or m, by OpenSim's name; none when the motion holds joint positions only."""
    if motion.poses is None:
        return {}
    names, values = joint_angles(motion.skeleton, motion.poses)
    return {n: values[:, i] for i, n in enumerate(names)}


def _of_subject(path: Path, names: tuple[str, ...], subject: str | None) -> tuple[tuple[str, ...], list[int]]:
    """The names that are one person's, or nobody's in particular, without the person's, and their numbers."""
    whose = {i: n.split(":")[0].strip() for i, n in enumerate(names) if ":" in n and not n.startswith("*")}
    people = list(dict.fromkeys(whose.values()))
    if subject is not None and subject not in people:
        known = f"of {', '.join(people)}" if people else "named without a subject"
        raise InputError(f"{path} has no points of {subject!r}, they are {known}; correct or leave out --subject.")
    if subject is None and len(people) > 1:
        raise InputError(f"{path} holds points of {', '.join(people)}; say who is meant: --subject {people[0]}.")
    kept = [i for i in range(len(names)) if subject is None or whose.get(i, subject) == subject]
    bare = [names[i].split(":")[-1].strip() if i in whose else names[i] for i in kept]
    return tuple(b if bare.count(b) == 1 else names[i] for b, i in zip(bare, kept, strict=True)), kept


def _joints_of(path: Path, names: tuple[str, ...], points: Array, given: Mapping[str, Sequence[str]]) -> dict:
    column = {n: i for i, n in enumerate(names)}
    out: dict[str, Array] = {}
    for joint, markers in given.items():
        markers = [m if m in column else m.split(":")[-1] for m in markers]
        missing = [m for m in markers if m not in column]
        if missing:
            shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
            raise InputError(f"{path} has no marker {missing[0]!r}; it has {shown}.")
        out[joint] = np.mean([points[:, column[m]] for m in markers], 0)
    for side, letter in (("left", "l"), ("right", "r")):
        for part in ("knee", "ankle"):  # the augmenter's: the outer and the inner side
            pair = [_lower(column, f"{letter}_{m}{part}_study") for m in ("", "m")]
            if f"{side}_{part}" not in out and None not in pair:
                out[f"{side}_{part}"] = 0.5 * (points[:, pair[0]] + points[:, pair[1]])
    for name, i in column.items():
        joint = _joint_name(name)
        if joint is not None and joint not in out:
            out[joint] = points[:, i]
    if not out:
        shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
        raise InputError(
            f"None of the points of {path} is called like a joint ({shown}); say which markers are one: --joint "
            "left_knee=LKNE+LKNM."
        )
    return out


def _lower(column: Mapping[str, int], name: str) -> int | None:
    return next((i for n, i in column.items() if n.lower().replace("r.", "r_").replace("l.", "l_") == name), None)


def _joint_name(name: str) -> str | None:
    """The joint that a point is named after; None for other markers."""
    bare = name.split(":")[-1].strip()
    centre = re.fullmatch(r"([LR])([SEWHKA])JC(_study)?", bare, re.IGNORECASE)
    if centre:
        return f"{'left' if centre[1].lower() == 'l' else 'right'}_{_CENTRES[centre[2].lower()]}"
    common = common_name(bare)
    if common in {f"{side}_{part}" for side in ("left", "right") for part in _PARTS}:
        return common
    return {"mid_hip": "pelvis", "neck": "neck", "head": "head"}.get(common if bare.lower() != "head" else "head")
