"""Results on disk: the folder of a run, motions as .npz that are equal byte for byte, checkpoints of a tracker."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import zipfile
import zlib
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np

from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.motion import Modes, Motion, modes_arrays
from hypose.body.skeleton import Skeleton
from hypose.errors import HyposeError, InputError
from hypose.geometry import Array
from hypose.io.files import atomic_path, open_file, write_bytes, write_text
from hypose.json_text import parse_json

_MAX_ARCHIVE_BYTES = 4 << 30
_PIECE = 1 << 20
_MOST_EMPTY = 1 << 20
"""Elements that the dimensions but the empty ones of an array of no bytes may make."""
_ZIP_END, _ZIP_64, _MAX_LIST_BYTES = 22, 20, 4 << 20
"""Bytes of a zip archive's end, of what a large one has before it, and of the list of what it holds."""
_FORMAT = 1
# name: (kinds of dtype, stored dtype, number of dimensions); those in _OPTIONAL may be absent
_MOTION_ARRAYS: dict[str, tuple[str, str, int]] = {
    "times": ("f", "<f8", 1),
    "joints": ("f", "<f8", 3),
    "poses": ("f", "<f8", 2),
    "joint_covariance": ("f", "<f4", 4),
    "lost": ("b", "|b1", 1),
    "extrapolated": ("b", "|b1", 1),
    "doubtful": ("b", "|b1", 1),
    "p_wrong": ("f", "<f4", 2),
    "doubtful_joints": ("b", "|b1", 2),
    "angle_sd": ("f", "<f4", 2),
    "systematic_covariance": ("f", "<f4", 4),
    "rivals": ("f", "<f4", 3),
    "rival_weights": ("f", "<f4", 2),
    "n_views": ("i", "<i8", 1),
    "cost": ("f", "<f8", 1),
    "parents": ("i", "<i8", 1),
    "rest_offsets": ("f", "<f8", 2),
    "ball": ("b", "|b1", 1),
    "axes": ("f", "<f8", 2),
    "joint_of_dof": ("i", "<i8", 1),
    "lower": ("f", "<f8", 1),
    "upper": ("f", "<f8", 1),
    "sigma": ("f", "<f8", 1),
    "joint_names": ("U", "", 1),
    "dof_names": ("U", "", 1),
    "provenance": ("U", "", 0),
}
_SKELETON = ("parents", "rest_offsets", "ball", "axes", "joint_of_dof", "lower", "upper", "sigma")
_SERIES = ("times", "joints", "joint_covariance", "lost", "extrapolated", "n_views", "cost")
_OPTIONAL = (
    *("poses", "doubtful", "p_wrong", "doubtful_joints", "angle_sd", "systematic_covariance"),
    *("rivals", "rival_weights"),
)


def to_json(value: Any) -> str:
    """Readable JSON with sorted keys; numpy numbers, arrays and paths become plain values; what is no UTF-8 in names
    becomes JSON's escapes."""

    def plain(v: Any) -> Any:
        if isinstance(v, np.ndarray | np.generic):
            return v.tolist()
        if isinstance(v, Mapping):
            return dict(v)
        if isinstance(v, os.PathLike):
            return os.fspath(v)
        raise TypeError(f"no JSON for {type(v).__name__}")

    text = json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, default=plain)
    return text.encode("utf-8", "backslashreplace").decode() + "\n"


@dataclass(frozen=True)
class ResultsFolder:
    """The folder of one run, results/<recipe>/ of a recording; made on the first write."""

    path: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))

    @staticmethod
    def of(recording_folder: str | Path, recipe: str) -> ResultsFolder:
        """results/<recipe>/ in a recording's folder."""
        return ResultsFolder(Path(recording_folder) / "results" / recipe)

    @property
    def motion(self) -> Path:
        """Where the motion lies."""
        return self.path / "motion.npz"

    @property
    def checkpoint(self) -> Path:
        """Where a run that is under way keeps its state."""
        return self.path / "checkpoint.npz"

    def file(self, name: str) -> Path:
        """Path of a file in this folder."""
        return self.path / name

    def write_text(self, name: str, text: str) -> Path:
        """Write a text file (UTF-8, \\n line ends) whole or not at all; returns its path."""
        write_text(self.path / name, text)
        return self.path / name

    def write_bytes(self, name: str, data: bytes) -> Path:
        """Write a binary file whole or not at all; returns its path."""
        write_bytes(self.path / name, data)
        return self.path / name

    def write_json(self, name: str, value: Any) -> Path:
        """Write a JSON file whole or not at all; returns its path."""
        return self.write_text(name, to_json(value))


# ---- archives ----------------------------------------------------------------------------------------------


def write_archive(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """An .npz (np.load reads it) whose bytes depend on the arrays alone: fixed dates, stored, sorted by
    name."""
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(arrays):
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(arrays[name], order="C"), (1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o644 << 16  # else Windows writes other bytes
            archive.writestr(entry, buffer.getvalue())


@contextlib.contextmanager
def open_archive(stream: BinaryIO) -> Iterator[zipfile.ZipFile]:
    """A zip archive whose list of contents is read only when it is of a size that an honest one has; BadZipFile."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _ZIP_END - _ZIP_64))
    end = stream.read()
    # of an archive without a comment: the mark of its end, where the size of the list stands
    listed = end[-_ZIP_END : -_ZIP_END + 4] == b"PK\5\6" and int.from_bytes(end[-10:-6], "little") <= _MAX_LIST_BYTES
    if not listed or end.startswith(b"PK\6\7"):
        raise zipfile.BadZipFile("it does not end as an archive, or lists too much")
    with zipfile.ZipFile(stream) as archive:
        yield archive


def _read_archive(path: Path, what: str, only: Container[str] | None, packed: int) -> dict[str, np.ndarray]:
    """`load_archive`, but a ValueError with a short reason for what is no such archive."""
    out: dict[str, np.ndarray] = {}
    with open_file(path, what, _MAX_ARCHIVE_BYTES) as stream, open_archive(stream) as archive:
        entries = archive.infolist()
        if sum(e.file_size for e in entries) > max(packed, os.fstat(stream.fileno()).st_size):
            raise ValueError("its contents are larger than the file")
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            if not entry.filename.endswith(".npy") or not all(c.isalnum() or c in "_.-" for c in name):
                raise ValueError(f"it holds {entry.filename!r}, which is no array")
            if (entry.compress_type != zipfile.ZIP_STORED and not packed) or entry.flag_bits & 1:
                raise ValueError(f"{name} is compressed or encrypted")
            if name in out:
                raise ValueError(f"{name} occurs twice")
            if only is None or name in only:
                with archive.open(entry) as array:
                    out[name] = parse_array(name, array, entry.file_size)
    return out


def parse_array(name: str, stream: IO[bytes], size: int) -> np.ndarray:
    """The array of numpy's format that so many bytes hold; a ValueError when the header does not agree with them, asks
    for more elements than they can have, or for Python objects. Nothing is allocated before."""
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError(f"{name} has another version of the array format")
    try:
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    except Exception as error:  # numpy lets errors of Python's own parser through
        raise ValueError(f"the header of {name} is damaged ({error})") from None
    if dtype.hasobject or dtype.kind not in "fiubU" or not dtype.itemsize:
        raise ValueError(f"{name} holds {dtype}, which is not allowed")
    rest = size - stream.tell()
    # an array without elements may have one dimension of any length, over which a loop would run for hours
    if min(shape, default=0) < 0 or (not rest and 0 in shape and math.prod(n or 1 for n in shape) > _MOST_EMPTY):
        raise ValueError(f"{name} has shape {shape}")
    if math.prod(shape) * dtype.itemsize != rest:
        raise ValueError(f"{name} of shape {shape} does not fit its {rest} bytes")
    data = np.empty(rest, np.uint8)
    for at in range(0, rest, _PIECE):  # whole, it would lie in memory twice
        piece = stream.read(min(_PIECE, rest - at))
        data[at : at + len(piece)] = np.frombuffer(piece, np.uint8)
    array = data.view(dtype)
    return array.reshape(shape[::-1]).T.copy() if fortran else array.reshape(shape)


def load_archive(
    path: Path, what: str, next_step: str, only: Container[str] | None = None, packed: int = 0
) -> dict[str, np.ndarray]:
    """The arrays of a file that `write_archive` wrote, or only those of these names; raises InputError, which calls
    it a `what` of hypose and ends with the next step.

    Nothing is unpacked or allocated before its size is known: entries must be stored (a compressed one could be a zip
    bomb), or unpack to at most `packed` bytes together.
    """
    if not path.is_file():
        raise InputError(f"The {what} {path} does not exist; {next_step}.")
    try:
        return _read_archive(path, f"a {what}", only, packed)
    except (zipfile.BadZipFile, ValueError, EOFError, NotImplementedError, RuntimeError, KeyError) as error:
        raise InputError(f"{path} is not a {what} of hypose, or is damaged: {error}; {next_step}.") from None
    except (OSError, MemoryError, zlib.error) as error:
        raise InputError(f"{path} cannot be read ({error}); {next_step}.") from None


# ---- motions -----------------------------------------------------------------------------------------------


def save_motion(motion: Motion, path: str | Path) -> None:
    """Write motion.npz (np.load reads it without pickle). Equal motions give equal bytes.

    The provenance's "run" part (command, times, machine) is left out for that reason; it belongs in
    provenance.json.
    """
    arrays = {name: np.asarray(getattr(motion, name)) for name in _SERIES}
    arrays |= {name: np.asarray(getattr(motion.skeleton, name)) for name in _SKELETON}
    arrays |= {name: a for name in _OPTIONAL if (a := getattr(motion, name)) is not None}
    arrays = {name: a.astype(_MOTION_ARRAYS[name][1]) for name, a in arrays.items()}
    arrays["joint_names"] = np.array(motion.skeleton.joint_names, dtype=np.str_)
    arrays["dof_names"] = np.array(motion.skeleton.dof_names, dtype=np.str_)
    provenance = {k: v for k, v in motion.provenance.items() if k != "run"}
    arrays["provenance"] = np.array(to_json({"format": _FORMAT, "provenance": provenance}))
    write_archive(path, arrays)


def load_motion(path: str | Path) -> Motion:
    """Read a motion.npz; an InputError names the file and what is wrong (damaged, foreign or hostile
    archive)."""
    path = Path(path)
    next_step = "give the motion.npz that hypose track wrote"
    arrays = load_archive(path, "motion", next_step)

    def bad(reason: str) -> InputError:
        return InputError(f"{path} is not a motion of hypose, or is damaged: {reason}; {next_step}.")

    for name, array in arrays.items():
        if name not in _MOTION_ARRAYS:
            raise bad(f"it holds the unknown array {name!r}")
        kinds, stored, ndim = _MOTION_ARRAYS[name]
        if array.dtype.kind not in kinds or (stored and array.dtype != np.dtype(stored)) or array.ndim != ndim:
            raise bad(f"{name} is {array.dtype} with {array.ndim} dimensions")
    missing = [n for n in _MOTION_ARRAYS if n not in arrays and n not in _OPTIONAL]
    if missing:
        raise bad(f"{', '.join(missing)} is missing")
    for name in (*_SKELETON, "times"):
        values = arrays[name]
        if values.dtype.kind != "f":
            continue
        # a free degree of freedom has infinite limits
        usable = ~np.isnan(values) if name in ("lower", "upper") else np.isfinite(values)
        if not usable.all():
            raise bad(f"{name} contains NaN or infinity")
    if (np.diff(arrays["times"]) <= 0).any():
        raise bad("times do not increase")
    try:
        document = parse_json(str(arrays["provenance"]))
        provenance, version = document["provenance"], document["format"]
        if not isinstance(provenance, dict):
            raise ValueError
    except (ValueError, KeyError, TypeError, RecursionError):
        raise bad("its provenance is no JSON") from None
    if version != _FORMAT:
        raise bad(f"it has format {version}, this version of hypose reads format {_FORMAT}")
    try:
        skeleton = Skeleton(
            joint_names=tuple(str(n) for n in arrays["joint_names"]),
            dof_names=tuple(str(n) for n in arrays["dof_names"]),
            **{name: arrays[name] for name in _SKELETON},
        )
        if (
            len(arrays["joint_names"]) == 0
            or not ((arrays["joint_of_dof"] >= 0) & (arrays["joint_of_dof"] < len(arrays["joint_names"]))).all()
        ):
            raise bad("joint_of_dof names joints that do not exist")
        return Motion(
            skeleton=skeleton,
            **{name: arrays.get(name) for name in _OPTIONAL},
            provenance=provenance,
            **{name: arrays[name] for name in _SERIES},
        )
    except InputError as error:
        if str(path) in str(error):
            raise
        raise bad(str(error).rstrip(".")) from None


# ---- checkpoints -------------------------------------------------------------------------------------------

_AFRESH = "run again without --resume to start from the first frame"


@dataclass(frozen=True)
class Checkpoint:
    """The state of a tracker after some frames, to go on from after a break.

    frame: the next frame to track. arrays: the tracker's state and what was tracked so far. meta: plain JSON
    values. identity: what must be equal for a resumed run to give the same result (`provenance.identity`).
    """

    frame: int
    arrays: Mapping[str, Array]
    meta: Mapping[str, Any]
    identity: Mapping[str, Any]

    def save(self, path: str | Path) -> None:
        """Write whole or not at all."""
        document = {
            "format": _FORMAT,
            "frame": self.frame,
            "meta": dict(self.meta),
            "identity": dict(self.identity),
        }
        arrays = {f"state.{k}": np.asarray(v) for k, v in self.arrays.items()}
        write_archive(path, {**arrays, "checkpoint": np.array(to_json(document))})

    @staticmethod
    def load(path: str | Path, identity: Mapping[str, Any]) -> Checkpoint:
        """Read a checkpoint of the same run; an InputError says what differs (inputs, settings, seed,
        versions)."""
        found = Checkpoint.read(path)
        difference = _first_difference(found.identity, json.loads(to_json(dict(identity))))
        if difference:
            raise InputError(
                f"{path} belongs to another run: {difference}; {_AFRESH}, or restore the former inputs and settings."
            )
        return found

    @staticmethod
    def read(path: str | Path) -> Checkpoint:
        """Read a checkpoint of any run."""
        path = Path(path)
        next_step = _AFRESH
        arrays = load_archive(path, "checkpoint", next_step)
        try:
            document = parse_json(str(arrays.pop("checkpoint")))
            frame, meta, stored = document["frame"], document["meta"], document["identity"]
            version = document["format"]
        except (ValueError, KeyError, TypeError, RecursionError):
            raise InputError(f"{path} is not a checkpoint of hypose; {next_step}.") from None
        if version != _FORMAT or not (isinstance(frame, int) and isinstance(meta, dict) and isinstance(stored, dict)):
            raise InputError(f"{path} is a checkpoint of another version of hypose; {next_step}.")
        return Checkpoint(frame, {k.removeprefix("state."): v for k, v in arrays.items()}, meta, stored)


def load_result(path: Path) -> Motion:
    """The motion of a results folder, or of a motion.npz."""
    if not path.exists():
        raise InputError(f"{path} does not exist; give the results folder that hypose track wrote.")
    file = path / "motion.npz" if path.is_dir() else path
    if path.is_dir() and not file.exists():
        people = sorted(p.parent for p in path.glob("*/motion.npz"))
        if people:
            raise InputError(
                f"{path} holds the results of {', '.join(p.name for p in people)}; give one of them, for example "
                f"{people[0]}."
            )
        runs = sorted(p.parent for p in path.glob("results/*/motion.npz"))
        if runs:
            raise InputError(f"{path} is a recording, not a result; give one of its results, for example {runs[0]}.")
    if file.suffix.lower() != ".npz":
        raise InputError(f"{path} is no result of hypose; give the results folder, or its motion.npz, first.")
    return load_motion(file)


def _first_difference(stored: Any, current: Any, where: str = "") -> str:
    if isinstance(stored, dict) and isinstance(current, dict):
        for key in sorted(set(stored) | set(current)):
            name = f"{where}.{key}" if where else key
            if key not in stored:
                return f"{name} was not given then and is now"
            if key not in current:
                return f"{name} was given then and is not now"
            difference = _first_difference(stored[key], current[key], name)
            if difference:
                return difference
        return ""
    if stored == current:
        return ""
    return f"{where} was {_short(stored)} then and is {_short(current)} now"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


# ---- bodies --------------------------------------------------------------------------------------------------------
# Bodies on disk: body.npz beside motion.npz, so that exports and pictures need neither the recording nor a new fit.
#
# The same safety as motion.npz: no pickle, nothing allocated before its size is known, equal bodies give equal bytes.


_FORMAT_body = 1
_SKELETON_body = {
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
    **_SKELETON_body,
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
    arrays: dict[str, np.ndarray] = {k: np.asarray(getattr(s, k)) for k in _SKELETON_body}
    for level, mesh in (("coarse", body.coarse), ("fine", body.fine)):
        arrays |= {f"{level}_{k}": np.asarray(getattr(mesh, k)) for k in _MESH}
    marks = body.landmarks
    arrays |= {"landmark_joint": np.asarray(marks.joint), "landmark_offset": np.asarray(marks.offset)}
    arrays["format"] = np.array(_FORMAT_body)
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
    if int(arrays["format"]) != _FORMAT_body:
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
        **{k: arrays[k] for k in _SKELETON_body},
    )
    marks = Landmarks(
        tuple(str(n) for n in arrays["landmark_names"]), arrays["landmark_joint"], arrays["landmark_offset"]
    )
    return Body(str(arrays["name"]), skeleton, mesh("coarse"), mesh("fine"), marks)


# ---- modes ---------------------------------------------------------------------------------------------------------
# modes.npz beside motion.npz: every hypothesis of every frame of a monocular track.
#
#     modes = load_modes("results/monocular/modes.npz")
#     modes.joints[t, k]      # (19, 3) m of mode k of frame t, NaN when frame t has fewer modes
#     modes.weights[t]        # (K,), sum 1
#
# The same safety as motion.npz: no pickle, nothing allocated before its size is known, equal modes give equal bytes.


_FORMAT_modes = 1
_NEXT_STEP = "give the modes.npz that hypose track --recipe monocular wrote"
_DIMENSIONS = {
    "poses": 3,
    "joints": 4,
    "weights": 2,
    "costs": 2,
    "covariances": 4,
    "joint_covariance": 4,
    "depth_sd": 2,
    "alive": 1,
}


def save_modes(modes: Modes, path: str | Path) -> None:
    """Write whole or not at all."""
    write_archive(path, {**modes_arrays(modes), "format": np.array(_FORMAT_modes)})


def load_modes(path: str | Path) -> Modes:
    """Read a modes.npz; an InputError names the file and what is wrong."""
    path = Path(path)
    arrays = load_archive(path, "file of modes", _NEXT_STEP)
    if arrays.pop("format", np.array(-1)).tolist() != _FORMAT_modes:
        raise InputError(f"{path} is no file of modes of this version of hypose; {_NEXT_STEP}.")
    return _from_arrays(arrays, str(path))


def load_joints_of_modes(path: str | Path) -> tuple[Array, Array]:
    """joints (T, K, J, 3) m and weights (T, K) of a modes.npz alone, which is little of what it holds; an InputError as
    of `load_modes`."""
    path, names = Path(path), ("joints", "weights")
    found = load_archive(path, "file of modes", _NEXT_STEP, set(names))
    for name in names:
        if name not in found or found[name].dtype.kind != "f" or found[name].ndim != _DIMENSIONS[name]:
            raise InputError(f"{path} is damaged: {name} is missing or has another shape; track again.")
    joints, weights = (found[name] for name in names)
    if joints.shape[:2] != weights.shape or joints.shape[3] != 3:
        raise InputError(f"{path} is damaged: joints and weights do not belong together; track again.")
    return joints, weights


def _from_arrays(arrays: dict[str, np.ndarray], source: str) -> Modes:
    """The inverse of `modes_arrays`; an InputError naming the source when arrays are missing or of another kind."""
    for name, dimensions in _DIMENSIONS.items():
        kind = "i" if name == "alive" else "f"
        if name not in arrays or arrays[name].ndim != dimensions or arrays[name].dtype.kind != kind:
            raise InputError(f"{source} is damaged: {name} is missing or has another shape; track again.")
    unknown = set(arrays) - set(_DIMENSIONS)
    if unknown:
        raise InputError(f"{source} holds the unknown array {sorted(unknown)[0]!r}; track again.")
    return Modes(**arrays)
