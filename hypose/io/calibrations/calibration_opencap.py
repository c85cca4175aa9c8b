"""OpenCap's camera files (cameraIntrinsicsExtrinsics.pickle), read without building any object but numbers and arrays.

A pickle is a program for a small machine that may call any function; opening one from elsewhere can run anything. Here
its instructions are read one by one and only those are followed that make numbers, text, tuples, lists, dictionaries
and plain numeric arrays. Functions are never looked up: the few names that numpy's arrays use are recognised as text,
and whatever else a file names is refused.
"""

from __future__ import annotations

import pickletools  # only splits the bytes into instructions
import struct
from collections.abc import Mapping, Sequence
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
_MAX_STEPS = 20_000
# OpenCap's world is the board's: it stands upright with y down; turned so that z points up, as Pose2Sim does.
_UP_FROM_BOARD = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])


class _Mark:
    """The machine's mark on its stack."""


class _Name:
    """A function or class that the file names; it is never looked up."""

    def __init__(self, text: str) -> None:
        self.text = text.replace("numpy._core", "numpy.core")


class _Kind:
    """A number format in the making: its letters and its byte order."""

    def __init__(self, code: str) -> None:
        self.code, self.order = code, "<"


class _Array:
    """An array in the making."""

    def __init__(self) -> None:
        self.value: Array | None = None


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
    """The value of a pickle of numbers, text, tuples, lists, dictionaries and numeric arrays; a ValueError names what
    else it asks for. Nothing is ever imported or called."""
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    try:
        for step, (op, argument, _) in enumerate(pickletools.genops(data)):
            if step > _MAX_STEPS:
                raise ValueError("it has too many instructions")
            if op.name == "STOP":
                if len(stack) != 1:
                    break
                return _done(stack[0])
            _follow(op.name, argument, stack, memo)
    except ValueError:
        raise
    except (IndexError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        raise ValueError("its instructions do not make sense") from None
    raise ValueError("it is cut off")


_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_LITERALS = frozenset(
    "INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING UNICODE BINUNICODE "
    "SHORT_BINUNICODE BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8".split()
)


def _follow(name: str, argument: Any, stack: list[Any], memo: dict[int, Any]) -> None:
    if name in ("PROTO", "FRAME"):
        return
    if name in _LITERALS:
        stack.append(argument)
    elif name in _CONSTANTS:
        stack.append(_CONSTANTS[name])
    elif name == "MARK":
        stack.append(_Mark())
    elif name in ("EMPTY_DICT", "EMPTY_LIST", "EMPTY_TUPLE"):
        stack.append({"EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_TUPLE": tuple}[name]())
    elif name in ("TUPLE", "LIST", "DICT"):
        items = _since_mark(stack)
        stack.append(tuple(items) if name == "TUPLE" else items if name == "LIST" else _pairs(items))
    elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
        count = int(name[-1])
        items = stack[-count:]
        if len(items) < count:
            raise IndexError
        stack[-count:] = [tuple(items)]
    elif name in ("APPEND", "APPENDS"):
        items = _since_mark(stack) if name == "APPENDS" else [stack.pop()]
        if not isinstance(stack[-1], list):
            raise TypeError
        stack[-1].extend(items)
    elif name in ("SETITEM", "SETITEMS"):
        items = _since_mark(stack) if name == "SETITEMS" else [stack.pop(-2), stack.pop()]
        if not isinstance(stack[-1], dict):
            raise TypeError
        stack[-1].update(_pairs(items))
    elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
        memo[int(argument)] = stack[-1]
    elif name == "MEMOIZE":
        memo[len(memo)] = stack[-1]
    elif name in ("GET", "BINGET", "LONG_BINGET"):
        stack.append(memo[int(argument)])
    elif name in ("POP", "POP_MARK"):
        _since_mark(stack) if name == "POP_MARK" else stack.pop()
    elif name == "GLOBAL":
        stack.append(_Name(str(argument).replace(" ", ".")))
    elif name == "STACK_GLOBAL":
        attribute, module = stack.pop(), stack.pop()
        if not isinstance(attribute, str) or not isinstance(module, str):
            raise TypeError
        stack.append(_Name(f"{module}.{attribute}"))
    elif name == "REDUCE":
        arguments, function = stack.pop(), stack.pop()
        stack.append(_made(function, arguments))
    elif name == "BUILD":
        state = stack.pop()
        _fill(stack[-1], state)
    else:
        raise ValueError(f"it uses the instruction {name}, which plain numbers and arrays do not need")


def _since_mark(stack: list[Any]) -> list[Any]:
    at = max(i for i, v in enumerate(stack) if isinstance(v, _Mark)) if stack else -1
    items = stack[at + 1 :]
    del stack[at:]
    return items


def _pairs(items: Sequence[Any]) -> dict[Any, Any]:
    if len(items) % 2:
        raise ValueError("a dictionary in it is incomplete")
    return {k: v for k, v in zip(items[::2], items[1::2], strict=True)}


def _made(function: Any, arguments: Any) -> Any:
    """What the functions of numpy's pickles would make; everything else is refused."""
    name = function.text if isinstance(function, _Name) else "something that is no function"
    if name == "numpy.core.multiarray._reconstruct":
        return _Array()
    if name == "numpy.core.numeric._frombuffer":  # protocol 5
        raw, kind, shape, order = arguments
        array = _Array()
        _fill(array, (1, shape, kind, order == "F", bytes(raw)))
        return array
    if name == "numpy.dtype":
        return _Kind(str(arguments[0]))
    if name == "numpy.core.multiarray.scalar":
        return float(_numbers(arguments[0], arguments[1])[0])
    if name == "_codecs.encode" and isinstance(arguments[0], str):
        return arguments[0].encode("latin-1")  # how protocol 2 writes bytes
    raise ValueError(f"it asks for {name}, which plain numbers and arrays do not need")


def _fill(target: Any, state: Any) -> None:
    if isinstance(target, _Kind):
        if state[1] in ("<", ">", "|", "="):
            target.order = state[1]
        return
    if not isinstance(target, _Array):
        raise ValueError("it fills an object that is no array")
    _, shape, kind, by_columns, raw = state
    values = _numbers(kind, raw)
    if not isinstance(shape, tuple) or len(shape) > 4 or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise TypeError
    if int(np.prod(shape)) != len(values):
        raise ValueError("an array in it has another size than it says")
    target.value = values.reshape(shape, order="F" if by_columns else "C")


def _numbers(kind: Any, raw: Any) -> Array:
    if not isinstance(kind, _Kind) or kind.code not in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"):
        raise ValueError("an array in it holds something else than numbers")
    if isinstance(raw, str):
        raw = raw.encode("latin-1")
    order = kind.order if kind.order in ("<", ">") else "="
    return np.frombuffer(raw, dtype=np.dtype(order + kind.code)).astype(np.float64)


def _done(value: Any) -> Any:
    if isinstance(value, _Array):
        if value.value is None:
            raise ValueError("an array in it is empty")
        return value.value
    if isinstance(value, dict):
        return {k: _done(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_done(v) for v in value)
    if isinstance(value, _Name | _Kind | _Mark):
        raise ValueError("it holds a function or class")
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
        write_bytes(path, plain_pickle(content))
        out.append(path)
    return out


def plain_pickle(content: Mapping[str, Array]) -> bytes:
    """The bytes of a pickle (protocol 3) of a dictionary of float arrays."""
    out = [b"\x80\x03}("]
    for key, value in content.items():
        array = np.ascontiguousarray(value, dtype="<f8")
        shape = b"(" + b"".join(b"J" + struct.pack("<i", n) for n in array.shape) + b"t"
        kind = b"cnumpy\ndtype\n" + _text("f8") + b"\x89\x88\x87R(K\x03" + _text("<")
        kind += b"NNN" + b"J\xff\xff\xff\xff" * 2 + b"K\x00tb"
        raw = array.tobytes()
        out += [
            _text(key),
            b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R(K\x01",
            shape,
            kind,
            b"\x89B" + struct.pack("<I", len(raw)) + raw + b"tb",
        ]
    return b"".join([*out, b"u."])


def _text(text: str) -> bytes:
    raw = text.encode("utf-8")
    return b"X" + struct.pack("<I", len(raw)) + raw
