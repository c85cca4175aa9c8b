"""OpenCap's camera files (cameraIntrinsicsExtrinsics.pickle), read without running anything of the file's choice.

A pickle may name any function and call it: opening one from elsewhere can run any program. Here the few names that
arrays need stand for functions of this module, and a file that names another is refused.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import Array, so3_log
from hypose.io.calibrations.calibration_toml import checked_camera, natural_key, rig_of
from hypose.io.file_names import file_name, text_of
from hypose.io.files import read_bytes, write_bytes

_MAX_BYTES = 1_000_000
# OpenCap's world is the board's: it stands upright with y down; turned so that z points up, as Pose2Sim does.
_UP_FROM_BOARD = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])


class _Kind:
    """The number format of an array: its letters and byte order."""

    def __init__(self, code: Any, *_: Any) -> None:
        self.code, self.order = code, "<"

    def __setstate__(self, state: Any) -> None:
        self.order = ">" if state[1] == ">" else "<"

    def numbers(self, raw: Any) -> Array:
        """Bytes (of protocol 0 as text) as numbers; a ValueError for other kinds than numbers."""
        if self.code not in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"):
            raise ValueError("an array in it holds something else than numbers")
        raw = raw.encode("latin-1") if isinstance(raw, str) else bytes(raw)
        return np.frombuffer(raw, self.order + self.code).astype(np.float64)


class _Array:
    """An array in the making."""

    value: Array | None = None

    def __init__(self, *_: Any) -> None:
        pass

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, by_columns, raw = state
        self.value = kind.numbers(raw).reshape(shape, order="F" if by_columns else "C")


def _from_buffer(raw: Any, kind: _Kind, shape: tuple[int, ...], order: str) -> Array:
    return kind.numbers(raw).reshape(shape, order="F" if order == "F" else "C")


_OF_ARRAYS = {
    "_codecs.encode": lambda text, _: text.encode("latin-1"),  # how protocol 2 writes bytes
    "numpy.dtype": _Kind,
    "numpy.ndarray": None,
    "numpy.core.multiarray._reconstruct": _Array,
    "numpy.core.multiarray.scalar": lambda kind, raw: float(kind.numbers(raw)[0]),
    "numpy.core.numeric._frombuffer": _from_buffer,  # protocol 5
}
"""What pickles of arrays name, and what stands for it: numpy's own crash on states that make no sense."""


class _ArraysOnly(pickle.Unpickler):
    """Reads numbers, text, tuples, lists, dictionaries and arrays; a ValueError names what else a file asks for."""

    def find_class(self, module: str, name: str) -> Any:
        full = f"{module}.{name}".replace("numpy._core", "numpy.core")
        if full not in _OF_ARRAYS:
            raise ValueError(f"it asks for {full}, which plain numbers and arrays do not need")
        return _OF_ARRAYS[full]


def read_opencap(path: str | Path) -> tuple[CameraRig, tuple[str, ...]]:
    """Rig of one OpenCap pickle or of a folder of them (also Videos/Cam0/cameraIntrinsicsExtrinsics.pickle), metres,
    z up. A CalibrationError names the file and what is wrong or refused."""
    path = Path(path)
    files = [path] if path.is_file() else sorted(path.rglob("*.pickle"), key=lambda p: natural_key(str(p)))
    if not files:
        raise CalibrationError(f"{path} holds no .pickle file; give OpenCap's calibration files or their folder.")
    if len(files) > 100:
        raise CalibrationError(f"{path} holds {len(files)} .pickle files; give the folder of the camera files only.")
    cameras = []
    for file in files:
        name = text_of(file.parent.name if file.stem.lower() == "cameraintrinsicsextrinsics" else file.stem)
        cameras.append(_camera(file, name))
    return rig_of(path, cameras), ("OpenCap's world is turned so that z points up.",)


def _camera(path: Path, name: str) -> Any:
    try:
        content = read_plain_pickle(read_bytes(path, "an OpenCap camera file", _MAX_BYTES))
    except ValueError as error:
        raise CalibrationError(f"{path} is not an OpenCap camera file: {error}.") from None
    where = f"{path}, camera {name}"
    if not isinstance(content, dict):
        raise CalibrationError(f"{path} is not an OpenCap camera file: it holds no dictionary.")

    def get(key: str, count: int) -> Array:
        value = content.get(key)
        array = None if not isinstance(value, np.ndarray | list | tuple) else _floats(value)
        if array is None or array.size != count or not np.isfinite(array).all():
            raise CalibrationError(f"{where}: {key} must be {count} finite numbers; export the calibration again.")
        return array.ravel()

    lens = content.get("distortion")
    lens_size = int(np.size(lens)) if isinstance(lens, np.ndarray | list) else 5
    height, width = get("imageSize", 2)
    rotation = get("rotation", 9).reshape(3, 3) @ _UP_FROM_BOARD.T
    return checked_camera(
        where,
        name,
        get("intrinsicMat", 9).reshape(3, 3),
        get("distortion", lens_size),
        rotation,
        get("translation", 3) / 1000,
        np.array([width, height]),
    )


def _floats(value: Any) -> Array | None:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def read_plain_pickle(data: bytes) -> Any:
    """The value of a pickle of numbers, text, tuples, lists, dictionaries and arrays; a ValueError says what is wrong.
    Nothing that the file names is imported."""
    try:
        return _plain(_ArraysOnly(io.BytesIO(data)).load())
    except ValueError:
        raise
    except Exception as error:  # instructions that make no sense may end in any
        raise ValueError(f"it is damaged ({error})") from None


def _plain(value: Any) -> Any:
    if isinstance(value, _Array):
        return _plain(value.value)
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_plain(v) for v in value)
    return value


# ---- writing -------------------------------------------------------------------------------------------------------


def write_opencap(rig: CameraRig, folder: str | Path) -> list[Path]:
    """One .pickle per camera, as OpenCap and Pose2Sim read them: millimetres, world of an upright board."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    out = []
    for camera in rig:
        if camera.fisheye:
            raise CalibrationError(
                f"Camera {camera.name} is a fisheye, which OpenCap's files cannot hold; write .toml."
            )
        rotation = camera.camera_from_world[:3, :3] @ _UP_FROM_BOARD
        lens = np.zeros(5)
        lens[: min(5, len(camera.distortion))] = camera.distortion[:5]
        if np.abs(camera.distortion[5:]).max(initial=0) > 0:
            raise CalibrationError(
                f"Camera {camera.name} has {len(camera.distortion)} distortion coefficients, OpenCap's files hold 5; "
                "write .toml."
            )
        content = {
            "distortion": lens[None],
            "intrinsicMat": camera.K,
            "imageSize": np.array([[camera.size[1]], [camera.size[0]]], dtype=np.float64),
            "rotation": rotation,
            "translation": 1000 * camera.camera_from_world[:3, 3:],
            "rotation_EulerAngles": so3_log(rotation)[:, None],
        }
        path = folder / f"{file_name(camera.name)}.pickle"
        # protocol 3 and the old name of numpy's core: programs with numpy 1 read it too
        write_bytes(path, pickle.dumps(content, 3).replace(b"numpy._core", b"numpy.core"))
        out.append(path)
    return out
