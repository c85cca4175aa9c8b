"""Bodies on disk: body.npz beside motion.npz, so that exports and pictures need neither the recording nor a new fit.

The same safety as motion.npz: no pickle, nothing allocated before its size is known, equal bodies give equal bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.errors import HyposeError, InputError
from hypose.io.motions.results import load_archive, load_result, write_archive

_FORMAT = 1
_SKELETON = {
    "parents": ("i", "<i8", 1),
    "rest_offsets": ("f", "<f8", 2),
    "ball": ("b", "|b1", 1),
    "axes": ("f", "<f8", 2),
    "joint_of_dof": ("i", "<i8", 1),
    "lower": ("f", "<f8", 1),
    "upper": ("f", "<f8", 1),
    "sigma": ("f", "<f8", 1),
}
_MESH = {
    "vertices": ("f", "<f8", 2),
    "faces": ("i", "<i4", 2),
    "skin_index": ("i", "<i4", 2),
    "skin_weight": ("f", "<f8", 2),
}
# name: (kind of dtype, stored dtype, "" = text of any length, number of dimensions)
_ARRAYS: dict[str, tuple[str, str, int]] = {
    **_SKELETON,
    **{f"coarse_{k}": v for k, v in _MESH.items()},
    **{f"fine_{k}": v for k, v in _MESH.items()},
    "landmark_joint": ("i", "<i8", 1),
    "landmark_offset": ("f", "<f8", 2),
    "landmark_names": ("U", "", 1),
    "joint_names": ("U", "", 1),
    "dof_names": ("U", "", 1),
    "name": ("U", "", 0),
    "format": ("i", "<i8", 0),
}
_LIMITS = ("lower", "upper")


def save_body(body: Body, path: str | Path) -> None:
    """Write a body (metres, model frame). Equal bodies give equal bytes."""
    s = body.skeleton
    arrays: dict[str, np.ndarray] = {k: np.asarray(getattr(s, k)) for k in _SKELETON}
    for level, mesh in (("coarse", body.coarse), ("fine", body.fine)):
        arrays |= {f"{level}_{k}": np.asarray(getattr(mesh, k)) for k in _MESH}
    marks = body.landmarks
    arrays |= {"landmark_joint": np.asarray(marks.joint), "landmark_offset": np.asarray(marks.offset)}
    arrays["format"] = np.array(_FORMAT)
    arrays = {k: a.astype(_ARRAYS[k][1]) for k, a in arrays.items()}
    for key, names in (
        ("landmark_names", marks.names),
        ("joint_names", s.joint_names),
        ("dof_names", s.dof_names),
    ):
        arrays[key] = np.array(names, dtype=np.str_).reshape(len(names))
    arrays["name"] = np.array(body.name)
    write_archive(path, arrays)


def load_body(path: str | Path) -> Body:
    """Read a body.npz; an InputError names the file and what is wrong (absent, damaged, foreign or hostile archive)."""
    path = Path(path)
    next_step = "give the results folder that hypose track wrote"
    arrays = load_archive(path, "body", next_step)
    problem = _problem(arrays)
    if problem:
        raise InputError(f"{path} is not a body of hypose, or is damaged: {problem}; {next_step}.")
    try:
        return _body(arrays)
    except HyposeError as error:
        reason = str(error).rstrip(".")
        raise InputError(f"{path} is not a body of hypose, or is damaged: {reason}; {next_step}.") from None


def load_result_body(results: Path) -> tuple[Motion, Body]:
    """The motion of a results folder, or of its motion.npz, and the body beside it; an InputError when there is none,
    or they belong to different bodies."""
    motion = load_result(results)
    folder = results if results.is_dir() else results.parent
    body = load_body(folder / "body.npz")
    if body.skeleton.joint_names != motion.skeleton.joint_names:
        raise InputError(f"{folder}: body.npz and the motion belong to different bodies; track the recording again.")
    return motion, body


def _problem(arrays: Mapping[str, np.ndarray]) -> str:
    """What is wrong with the arrays of a file, "" when nothing is."""
    for name, array in arrays.items():
        if name not in _ARRAYS:
            return f"it holds the unknown array {name!r}"
        kind, stored, ndim = _ARRAYS[name]
        if array.dtype.kind != kind or (stored and array.dtype != np.dtype(stored)) or array.ndim != ndim:
            return f"{name} is {array.dtype} with {array.ndim} dimensions"
        if kind == "f" and name not in _LIMITS and not np.isfinite(array).all():
            return f"{name} contains NaN or infinity"
        if name in _LIMITS and np.isnan(array).any():
            return f"{name} contains NaN"
    missing = [n for n in _ARRAYS if n not in arrays]
    if missing:
        return f"{', '.join(missing)} is missing"
    if int(arrays["format"]) != _FORMAT:
        return f"it has format {int(arrays['format'])}, this version of hypose reads format {_FORMAT}"
    joints = len(arrays["joint_names"])
    for name in ("joint_of_dof", "landmark_joint", "coarse_skin_index", "fine_skin_index"):
        if not ((arrays[name] >= 0) & (arrays[name] < joints)).all():
            return f"{name} names joints that do not exist"
    for level in ("coarse", "fine"):
        if arrays[f"{level}_vertices"].shape[1] != 3 or arrays[f"{level}_faces"].shape[1] != 3:
            return f"the {level} mesh has no triangles"
        faces = arrays[f"{level}_faces"]
        if len(faces) and not ((faces >= 0) & (faces < len(arrays[f"{level}_vertices"]))).all():
            return f"{level}_faces names vertices that do not exist"
    marks = len(arrays["landmark_names"])
    if arrays["landmark_joint"].shape != (marks,) or arrays["landmark_offset"].shape != (marks, 3):
        return "the landmarks do not fit their names"
    return "" if joints else "it has no joints"


def _body(arrays: Mapping[str, np.ndarray]) -> Body:
    def mesh(level: str) -> Mesh:
        return Mesh(**{k: arrays[f"{level}_{k}"] for k in _MESH})

    skeleton = Skeleton(
        joint_names=tuple(str(n) for n in arrays["joint_names"]),
        dof_names=tuple(str(n) for n in arrays["dof_names"]),
        **{k: arrays[k] for k in _SKELETON},
    )
    marks = Landmarks(
        tuple(str(n) for n in arrays["landmark_names"]), arrays["landmark_joint"], arrays["landmark_offset"]
    )
    return Body(str(arrays["name"]), skeleton, mesh("coarse"), mesh("fine"), marks)
