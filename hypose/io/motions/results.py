"""Results on disk: the folder of a run, motions, bodies and modes as .npz files with reproducible bytes, checkpoints,
provenance.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import platform
import re
import sys
import zipfile
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np

from hypose import __version__
from hypose.body.body import Body, Landmarks, Mesh
from hypose.body.motion import Modes, Motion, modes_arrays
from hypose.body.skeleton import Skeleton
from hypose.errors import HyposeError, InputError, visible
from hypose.geometry import Array
from hypose.io.files import DAMAGED, atomic_path, natural_key, open_file, unreadable, write_text
from hypose.json_text import parse_json

_MAX_ARCHIVE_BYTES = 4 << 30
_PIECE = 1 << 20
# Largest product of the dimensions that are not 0, of an array without elements.
_MOST_EMPTY = 1 << 20
# Sizes in bytes: the end record of a zip archive, the record before it in a large archive, the longest list of
# contents.
_ZIP_END, _ZIP_64, _MAX_LIST_BYTES = 22, 20, 4 << 20
_FORMAT = 1
# Arrays of an archive by name: kind of dtype, stored dtype ("" for any of the kind) and number of dimensions.
_Layout = Mapping[str, tuple[str, str, int]]
_SKELETON: _Layout = {
    "parents": ("i", "<i8", 1),
    "rest_offsets": ("f", "<f8", 2),
    "ball": ("b", "|b1", 1),
    "axes": ("f", "<f8", 2),
    "joint_of_dof": ("i", "<i8", 1),
    "lower": ("f", "<f8", 1),
    "upper": ("f", "<f8", 1),
    "sigma": ("f", "<f8", 1),
}
_NAMES: _Layout = {"joint_names": ("U", "", 1), "dof_names": ("U", "", 1)}
_SERIES: _Layout = {
    "times": ("f", "<f8", 1),
    "joints": ("f", "<f8", 3),
    "joint_covariance": ("f", "<f4", 4),
    "lost": ("b", "|b1", 1),
    "extrapolated": ("b", "|b1", 1),
    "n_views": ("i", "<i8", 1),
    "cost": ("f", "<f8", 1),
}
_OPTIONAL: _Layout = {
    "poses": ("f", "<f8", 2),
    "low_confidence": ("b", "|b1", 1),
    "error_probability": ("f", "<f4", 2),
    "low_confidence_joints": ("b", "|b1", 2),
    "angle_sd": ("f", "<f4", 2),
    "systematic_covariance": ("f", "<f4", 4),
    "rivals": ("f", "<f4", 3),
    "rival_weights": ("f", "<f4", 2),
}
# Limits of the degrees of freedom, which are infinite where one is free.
_LIMITS = ("lower", "upper")


def to_json(value: Any) -> str:
    """Format a value as readable JSON with sorted keys.

    Numpy numbers, arrays and paths become plain values; invalid UTF-8 in names becomes JSON's escapes.
    """

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


def json_values(value: Any) -> Any:
    """Convert a value to plain JSON values; NaN and infinity become null, invalid text is escaped."""
    if isinstance(value, np.ndarray | np.generic):
        return json_values(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {visible(str(k)): json_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(v) for v in value]
    return value if isinstance(value, int | bool) or value is None else visible(str(value))


def write_json(path: Path, value: Any) -> None:
    """Write a value as a JSON file, as `to_json` formats it, whole or not at all."""
    write_text(path, to_json(value))


def results_folder(recording_folder: str | Path, recipe: str) -> Path:
    """Locate the folder results/<recipe>/ of a recording; it is made when the first file is written."""
    return Path(recording_folder) / "results" / recipe


# ---- archives ----------------------------------------------------------------------------------------------


def write_archive(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as an .npz file whose bytes depend on the arrays alone; np.load reads it.

    Dates are fixed, entries are sorted by name and not compressed.
    """
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(arrays):
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(arrays[name], order="C"), (1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o644 << 16  # otherwise the bytes differ on Windows
            archive.writestr(entry, buffer.getvalue())


@contextlib.contextmanager
def open_archive(stream: BinaryIO) -> Iterator[zipfile.ZipFile]:
    """Open a zip archive only when the list of its contents has a plausible size.

    Raises: BadZipFile where it is too long or the file is not an archive.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(0, size - _ZIP_END - _ZIP_64))
    end = stream.read()
    # of an archive without a comment: the mark of its end, where the size of the list stands
    listed = end[-_ZIP_END : -_ZIP_END + 4] == b"PK\5\6" and int.from_bytes(end[-10:-6], "little") <= _MAX_LIST_BYTES
    if not listed or end.startswith(b"PK\6\7"):
        raise zipfile.BadZipFile("it does not end as an archive, or lists too much")
    with zipfile.ZipFile(stream) as archive:
        yield archive


def parse_array(name: str, stream: IO[bytes], size: int) -> np.ndarray:
    """Parse an array in numpy's .npy format from a stream.

    name: name of the array in error messages.
    size: number of bytes of array and header.
    Raises: ValueError where the header disagrees with the size, is damaged, or describes Python objects. Nothing is
        allocated before.
    """
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
    for at in range(0, rest, _PIECE):  # read at once, it would be in memory twice
        piece = stream.read(min(_PIECE, rest - at))
        data[at : at + len(piece)] = np.frombuffer(piece, np.uint8)
    array = data.view(dtype)
    return array.reshape(shape[::-1]).T.copy() if fortran else array.reshape(shape)


@dataclass(frozen=True)
class Archive:
    """Description of one kind of .npz file that `write_archive` writes: its name and the arrays that it holds.

    what: its name in error messages.
    next_step: last part of the error messages.
    layout: its arrays; None where they are not known before.
    finite: names of the arrays that must not hold NaN or infinity.
    optional: names of the arrays that may be absent.
    packed: limit of the unpacked size in bytes when compressed entries are accepted; 0 accepts none, because they could
        be a zip bomb.
    """

    what: str
    next_step: str
    layout: _Layout | None = None
    finite: Container[str] = ()
    optional: Container[str] = ()
    packed: int = 0

    def load(
        self, path: Path, build: Callable[[dict[str, np.ndarray]], Any] = dict, only: Container[str] | None = None
    ) -> Any:  # noqa: ANN401 (what `build` returns)
        """Read the arrays, check them against the layout, and make a value of them.

        build: function that makes the value of the arrays; its errors say that the file is damaged.
        only: names of the arrays to read; None for all.
        Raises: InputError where the file does not exist, is damaged or is not of this kind. Nothing is allocated before
            its size is known.
        """
        if not path.is_file():
            raise InputError(f"The {self.what} {path} does not exist; {self.next_step}.")
        with open_file(path, f"a {self.what}", _MAX_ARCHIVE_BYTES) as stream:
            try:
                return build(self._checked(self._read(stream, only), only))
            except OSError as error:
                raise InputError(f"{path} cannot be read ({error}); {self.next_step}.") from None
            except (HyposeError, *DAMAGED) as error:
                reason = f"{error} is missing" if isinstance(error, KeyError) else str(error).rstrip(".")
                raise InputError(f"{path} is not a {self.what}, or is damaged: {reason}; {self.next_step}.") from None

    def _read(self, stream: BinaryIO, only: Container[str] | None) -> dict[str, np.ndarray]:
        """Read the arrays of an archive; ValueError and others where it cannot be one."""
        with open_archive(stream) as archive:
            entries = archive.infolist()
            for entry in entries:
                if not re.fullmatch(r"[\w.-]+\.npy", entry.filename):
                    raise ValueError(f"it holds {entry.filename!r}, which is no array")
                if (entry.compress_type != zipfile.ZIP_STORED and not self.packed) or entry.flag_bits & 1:
                    raise ValueError(f"{entry.filename} is compressed or encrypted")
            limit = max(self.packed, os.fstat(stream.fileno()).st_size)
            if sum(e.file_size for e in entries) > limit or len({e.filename for e in entries}) < len(entries):
                raise ValueError(f"it holds an array twice, or arrays of more than {limit >> 20} MiB together")
            out: dict[str, np.ndarray] = {}
            for entry in entries:
                name = entry.filename.removesuffix(".npy")
                if only is None or name in only:
                    with archive.open(entry) as array:
                        out[name] = parse_array(name, array, entry.file_size)
            return out

    def _checked(self, arrays: dict[str, np.ndarray], only: Container[str] | None) -> dict[str, np.ndarray]:
        """Check arrays against the layout and return them; ValueError where they do not fit it."""
        if self.layout is None:
            return arrays
        for name, array in arrays.items():
            if name not in self.layout:
                raise ValueError(f"it holds the unknown array {name!r}")
            kind, stored, ndim = self.layout[name]
            if array.dtype.kind != kind or (stored and array.dtype != np.dtype(stored)) or array.ndim != ndim:
                raise ValueError(f"{name} is {array.dtype} with {array.ndim} dimensions")
            usable = ~np.isnan(array) if name in _LIMITS else np.isfinite(array) if name in self.finite else True
            if not np.all(usable):
                raise ValueError(f"{name} contains NaN or infinity")
        wanted = [n for n in self.layout if n not in self.optional and (only is None or n in only)]
        if missing := [n for n in wanted if n not in arrays]:
            raise ValueError(f"{', '.join(missing)} is missing")
        if "format" in arrays:
            _check_format(int(arrays.pop("format")))
        return arrays


def _check_format(version: object) -> None:
    """Check the number of the format; ValueError where another version of hypose wrote it."""
    if version != _FORMAT:
        raise ValueError(f"it has format {version}, this version of hypose reads format {_FORMAT}")


def _stored(values: Any, layout: _Layout) -> dict[str, np.ndarray]:
    """Convert the attributes of an object to arrays of the stored types.

    values: the object, such as a motion.
    layout: names of the attributes and their types; attributes that are None are left out.
    """
    found = {name: getattr(values, name) for name in layout}
    return {name: np.asarray(v).astype(layout[name][1]) for name, v in found.items() if v is not None}


def _stored_skeleton(skeleton: Skeleton) -> dict[str, np.ndarray]:
    names = {name: np.array(getattr(skeleton, name), dtype=np.str_).reshape(-1) for name in _NAMES}
    return _stored(skeleton, _SKELETON) | names


def _skeleton_of(arrays: Mapping[str, np.ndarray]) -> Skeleton:
    """Assemble the skeleton from the arrays of an archive.

    Raises: InputError where the arrays disagree; it does not name the file.
    """
    if not len(arrays["joint_names"]):
        raise InputError("it has no joints")
    _check_joints(arrays, "joint_of_dof")
    fields: dict[str, Any] = {name: arrays[name] for name in _SKELETON}
    fields |= {name: tuple(str(n) for n in arrays[name]) for name in _NAMES}
    return Skeleton(**fields)


def _check_joints(arrays: Mapping[str, np.ndarray], name: str) -> None:
    """Check that the array of this name holds numbers of joints that exist; InputError otherwise."""
    if not ((arrays[name] >= 0) & (arrays[name] < len(arrays["joint_names"]))).all():
        raise InputError(f"{name} names joints that do not exist")


# ---- motions -----------------------------------------------------------------------------------------------

_MOTION = Archive(
    "motion",
    "give the motion.npz that hypose track wrote",
    {**_SERIES, **_OPTIONAL, **_SKELETON, **_NAMES, "provenance": ("U", "", 0)},
    finite=("times", "rest_offsets", "axes", "sigma"),
    optional=_OPTIONAL,
)


def save_motion(motion: Motion, path: str | Path) -> None:
    """Write a motion as motion.npz, which np.load reads without pickle. Equal motions give equal bytes.

    The part "run" of the provenance (command, times, machine) is left out for this reason; it is written to
    provenance.json.
    """
    arrays = _stored(motion, {**_SERIES, **_OPTIONAL}) | _stored_skeleton(motion.skeleton)
    provenance = {k: v for k, v in motion.provenance.items() if k != "run"}
    arrays["provenance"] = np.array(to_json({"format": _FORMAT, "provenance": provenance}))
    write_archive(path, arrays)


def load_motion(path: str | Path) -> Motion:
    """Read a motion.npz.

    Raises: InputError where the file is damaged, of another kind, or malicious.
    """
    return _MOTION.load(Path(path), _motion_of)


def _motion_of(arrays: Mapping[str, np.ndarray]) -> Motion:
    if (np.diff(arrays["times"]) <= 0).any():
        raise ValueError("times do not increase")
    document = parse_json(str(arrays["provenance"]))
    _check_format(document["format"])
    series: dict[str, Any] = {name: arrays.get(name) for name in (*_SERIES, *_OPTIONAL)}
    return Motion(skeleton=_skeleton_of(arrays), provenance=dict(document["provenance"]), **series)


# ---- checkpoints -------------------------------------------------------------------------------------------

_AFRESH = "run again without --resume to start from the first frame"


@dataclass(frozen=True)
class Checkpoint:
    """The state of a tracker after some frames, from which an interrupted run continues.

    frame: next frame to track.
    arrays: state of the tracker and the results so far.
    meta: plain JSON values.
    identity: inputs and settings that must be equal for a resumed run to give the same result (`provenance_identity`).
    """

    frame: int
    arrays: Mapping[str, Array]
    meta: Mapping[str, Any]
    identity: Mapping[str, Any]

    def save(self, path: str | Path) -> None:
        """Write the checkpoint whole or not at all."""
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
        """Read a checkpoint of the same run.

        identity: identity of the present run.
        Raises: InputError where an input, a setting, the seed or a version differs; it names the difference.
        """
        found = Checkpoint.read(path)
        difference = _first_difference(found.identity, json.loads(to_json(dict(identity))))
        if difference:
            raise InputError(
                f"{path} belongs to another run: {difference}; {_AFRESH}, or restore the former inputs and settings."
            )
        return found

    @staticmethod
    def read(path: str | Path) -> Checkpoint:
        """Read a checkpoint of any run; InputError where the file is damaged or of another version of hypose."""
        return Archive("checkpoint", _AFRESH).load(Path(path), _checkpoint_of)


def _checkpoint_of(arrays: dict[str, np.ndarray]) -> Checkpoint:
    document = parse_json(str(arrays.pop("checkpoint")))
    _check_format(document["format"])
    frame, meta, identity = document["frame"], document["meta"], document["identity"]
    if not (isinstance(frame, int) and isinstance(meta, dict) and isinstance(identity, dict)):
        raise ValueError("its description is none of a checkpoint")
    return Checkpoint(frame, {k.removeprefix("state."): v for k, v in arrays.items()}, meta, identity)


def load_result(path: Path) -> Motion:
    """Read the motion of a results folder, or a motion.npz.

    Raises: InputError where there is none; it names the results that exist.
    """
    if not path.exists():
        raise InputError(f"{path} does not exist; give the results folder that hypose track wrote.")
    file = path / "motion.npz" if path.is_dir() else path
    if path.is_dir() and not file.exists():
        found = [p.parent for pattern in ("*/motion.npz", "results/*/motion.npz") for p in sorted(path.glob(pattern))]
        if found:
            names = ", ".join(p.relative_to(path).as_posix() for p in found)
            raise InputError(f"{path} holds the results of {names}; give one of them, for example {found[0]}.")
    if file.suffix.lower() != ".npz":
        raise InputError(f"{path} is no result of hypose; give the results folder, or its motion.npz, first.")
    return load_motion(file)


def _first_difference(stored: Any, current: Any, where: str = "") -> str:
    """Describe the first difference of two nested tables by its keys and both values; empty where they are equal."""
    if not (isinstance(stored, dict) and isinstance(current, dict)):
        texts = [t if len(t := json.dumps(v)) <= 40 else t[:37] + "..." for v in (stored, current)]
        return "" if stored == current else f"{where} was {texts[0]} then and is {texts[1]} now"
    for key in sorted(set(stored) | set(current)):
        name = f"{where}.{key}" if where else key
        if key not in stored or key not in current:
            return f"{name} was {'given' if key in stored else 'not given'} then and is{' not' * (key in stored)} now"
        if difference := _first_difference(stored[key], current[key], name):
            return difference
    return ""


# ---- bodies ------------------------------------------------------------------------------------------------
# body.npz next to motion.npz, so that exports and pictures need neither the recording nor a new fit.

_MESH: _Layout = {
    "vertices": ("f", "<f8", 2),
    "faces": ("i", "<i4", 2),
    "skin_index": ("i", "<i4", 2),
    "skin_weight": ("f", "<f8", 2),
}
_MARKS: _Layout = {"joint": ("i", "<i8", 1), "offset": ("f", "<f8", 2)}
_LEVELS = ("coarse", "fine")
_BODY_LAYOUT: _Layout = {
    **_SKELETON,
    **_NAMES,
    **{f"{level}_{k}": v for level in _LEVELS for k, v in _MESH.items()},
    **{f"landmark_{k}": v for k, v in _MARKS.items()},
    "landmark_names": ("U", "", 1),
    "name": ("U", "", 0),
    "format": ("i", "<i8", 0),
}
_BODY = Archive(
    "body",
    "give the results folder that hypose track wrote",
    _BODY_LAYOUT,
    finite=[name for name, (kind, _, _) in _BODY_LAYOUT.items() if kind == "f"],
)


def body_arrays(body: Body) -> dict[str, np.ndarray]:
    """Convert a body (metres, model frame) to arrays, which `body_of_arrays` reads."""
    arrays = _stored_skeleton(body.skeleton)
    for level, mesh in zip(_LEVELS, (body.coarse, body.fine), strict=True):
        arrays |= {f"{level}_{k}": v for k, v in _stored(mesh, _MESH).items()}
    arrays |= {f"landmark_{k}": v for k, v in _stored(body.landmarks, _MARKS).items()}
    names = np.array(body.landmarks.names, dtype=np.str_).reshape(-1)
    return arrays | {"landmark_names": names, "name": np.array(body.name)}


def save_body(body: Body, path: str | Path) -> None:
    """Write a body (metres, model frame) as body.npz. Equal bodies give equal bytes."""
    write_archive(path, {**body_arrays(body), "format": np.array(_FORMAT, dtype="<i8")})


def body_of_arrays(arrays: Mapping[str, np.ndarray]) -> Body:
    """Assemble a body from the arrays of `body_arrays`.

    Raises: InputError where the arrays disagree; it does not name the file.
    """
    skeleton = _skeleton_of(arrays)
    for name in ("landmark_joint", "coarse_skin_index", "fine_skin_index"):
        _check_joints(arrays, name)
    names = tuple(str(n) for n in arrays["landmark_names"])
    marks = Landmarks(names, arrays["landmark_joint"], arrays["landmark_offset"])
    if marks.joint.shape != (len(names),) or marks.offset.shape != (len(names), 3):
        raise InputError("the landmarks do not fit their names")
    coarse, fine = (_mesh(arrays, level) for level in _LEVELS)
    return Body(str(arrays["name"]), skeleton, coarse, fine, marks)


def load_body(path: str | Path) -> Body:
    """Read a body.npz.

    Raises: InputError where the file does not exist, is damaged, of another kind, or malicious.
    """
    return _BODY.load(Path(path), body_of_arrays)


def _mesh(arrays: Mapping[str, np.ndarray], level: str) -> Mesh:
    mesh = Mesh(**{k: arrays[f"{level}_{k}"] for k in _MESH})
    if mesh.vertices.shape[1] != 3 or mesh.faces.shape[1] != 3:
        raise InputError(f"the {level} mesh has no triangles")
    return mesh


def load_result_body(results: Path) -> tuple[Motion, Body]:
    """Read the motion of a results folder, or a motion.npz, and the body.npz next to it.

    Raises: InputError where one does not exist or they belong to different bodies.
    """
    motion = load_result(results)
    folder = results if results.is_dir() else results.parent
    body = load_body(folder / "body.npz")
    if body.skeleton.joint_names != motion.skeleton.joint_names:
        raise InputError(f"{folder}: body.npz and the motion belong to different bodies; track the recording again.")
    return motion, body


# ---- modes -------------------------------------------------------------------------------------------------
# modes.npz next to motion.npz: every hypothesis of every frame of a monocular track.
#
#     modes = load_modes("results/monocular/modes.npz")
#     modes.joints[t, k]      # (19, 3) m of mode k of frame t, NaN when frame t has fewer modes
#     modes.weights[t]        # (K,), sum 1

_MODES = Archive(
    "file of modes",
    "give the modes.npz that hypose track --recipe monocular wrote",
    {
        "poses": ("f", "", 3),
        "joints": ("f", "", 4),
        "weights": ("f", "", 2),
        "costs": ("f", "", 2),
        "covariances": ("f", "", 4),
        "joint_covariance": ("f", "", 4),
        "depth_sd": ("f", "", 2),
        "alive": ("i", "", 1),
        "format": ("i", "", 0),
    },
)


def save_modes(modes: Modes, path: str | Path) -> None:
    """Write the modes (possible poses of each frame) of a monocular track as modes.npz, completely or not at all."""
    write_archive(path, {**modes_arrays(modes), "format": np.array(_FORMAT)})


def load_modes(path: str | Path) -> Modes:
    """Read a modes.npz, the hypotheses of a monocular track.

    Raises: InputError where the file cannot be used.
    """
    return _MODES.load(Path(path), lambda arrays: Modes(**arrays))


def load_joints_of_modes(path: str | Path) -> tuple[Array, Array]:
    """Read only the joints and weights of a modes.npz, a small part of the file.

    Returns: joints (T, K, J, 3) m, and weights (T, K).
    Raises: InputError as `load_modes`.
    """
    return _MODES.load(Path(path), _joints_and_weights, ("joints", "weights"))


def _joints_and_weights(arrays: Mapping[str, np.ndarray]) -> tuple[Array, Array]:
    joints, weights = arrays["joints"], arrays["weights"]
    if joints.shape[:2] != weights.shape or joints.shape[3] != 3:
        raise ValueError("joints and weights do not belong together")
    return joints, weights


# ---- provenance ----------------------------------------------------------------------------------------------------
# The origin of a result: versions, seed, settings and the hashes of its inputs.


_FULL_HASH_BYTES = 64 << 20
_ENDS_BYTES = 1 << 20


def provenance(
    recipe: str,
    seed: int | None,
    settings: Mapping[str, Any],
    inputs: Mapping[str, Path],
    run: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Collect the provenance of a result as plain JSON values.

    settings: the effective settings.
    inputs: path of each input file or folder.
    run: further values that may differ between runs with equal results, such as times and threads.
    Returns: recipe, seed, settings, versions of hypose and its packages, inputs (see `file_identity`) and run. "run"
        holds the command, the platform and the given values; `save_motion` leaves it out.
    """
    return {
        "recipe": recipe,
        "seed": seed,
        "settings": dict(settings),
        "versions": versions(),
        "inputs": {name: file_identity(path) for name, path in inputs.items()},
        "run": {
            "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
            "platform": platform.platform(),
            **(run or {}),
        },
    }


def provenance_identity(record: Mapping[str, Any]) -> dict[str, Any]:
    """Extract the part of a provenance that determines the result: all except "run" and the trace of the passes."""
    return {k: v for k, v in record.items() if k not in ("run", "trace")}


def versions() -> dict[str, str]:
    """List the versions of hypose, of Python and of the packages that affect its numbers."""
    out = {"hypose": __version__, "python": platform.python_version()}
    for package in ("numpy", "scipy", "numba", "opencv-python-headless"):
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            out[package] = "not installed"
    return out


def file_identity(path: str | Path) -> dict[str, Any]:
    """Compute the size and hash of a file or folder.

    Files below 64 MiB are hashed whole. Of larger files the first and last MiB and the size are hashed, which is fast
    for hours of video and still detects a re-encoded or cut file. A folder's hash is that of its files' names and
    hashes in natural order.

    Returns: name, bytes, sha256, and hashed ("all" or the hashed part); files, their number, for a folder.
    Raises: InputError where a file cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        files = sorted((p for p in path.rglob("*") if p.is_file()), key=lambda p: natural_key(p.as_posix()))
        found = [(file.relative_to(path).as_posix(), file_identity(file)) for file in files]
        lines = "".join(f"{name} {one['bytes']} {one['sha256']}\n" for name, one in found)
        partial = any(one["hashed"] != "all" for _, one in found)
        return {
            "name": path.name,
            "files": len(files),
            "bytes": sum(one["bytes"] for _, one in found),
            "sha256": hashlib.sha256(lines.encode()).hexdigest(),
            "hashed": "first and last MiB of large files" if partial else "all",
        }
    try:
        with open_file(path, "an input", sys.maxsize, 0) as stream:
            size = os.fstat(stream.fileno()).st_size
            whole = size < _FULL_HASH_BYTES
            if whole:
                digest = hashlib.file_digest(stream, "sha256")
            else:
                digest = hashlib.sha256(stream.read(_ENDS_BYTES))
                stream.seek(-_ENDS_BYTES, 2)
                digest.update(stream.read(_ENDS_BYTES) + str(size).encode())
    except OSError as error:
        raise unreadable(path, error) from None
    hashed = "all" if whole else "first and last MiB"
    return {"name": path.name, "bytes": size, "sha256": digest.hexdigest(), "hashed": hashed}
