"""Key points by MediaPipe's Pose Landmarker. Needs mediapipe (an extra) and a model file of the user's own.

Pictures are looked at one by one (running mode IMAGE): the mode for videos filters its points over time, and a filter's
lag is the last thing that a solve over the whole clip needs.

Source: the Pose Landmarker guide for Python, ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker/python.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.compute import cache_folder
from hypose.errors import InputError, extra
from hypose.evidence.detector import PoseDetector
from hypose.evidence.keypoints import BLAZEPOSE_33, keypoint_names
from hypose.geometry import Array
from hypose.io.files import open_file
from hypose.io.keypoints import mediapipe_worker
from hypose.io.motions.results import file_identity
from hypose.json_text import is_plain

_MAX_BYTES = 2**30
_INSIDE = "pose_landmarks_detector.tflite"
"""What every bundle of a Pose Landmarker holds."""
_KIND = "a model bundle of MediaPipe's Pose Landmarker (.task)"


@dataclass(frozen=True)
class BlazePose:
    """The landmarker as a `PoseDetector`; opened by `open_blazepose`."""

    library: Any
    landmarker: Any
    identity: dict[str, Any]
    keypoint_set: str = "BLAZEPOSE_33"

    def detect(self, image: NDArray[np.uint8], /) -> Array:
        """People (P, 33, 3) in a picture (h, w, 3) BGR."""
        rgb = np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        found = self.landmarker.detect(self.library.Image(image_format=self.library.ImageFormat.SRGB, data=rgb))
        people = [[_point(p) for p in person] for person in found.pose_landmarks]
        return to_pixels(
            np.array(people, dtype=np.float64).reshape(-1, len(BLAZEPOSE_33), 3), rgb.shape[1], rgb.shape[0]
        )


@contextlib.contextmanager
def open_blazepose(model: str | Path, people: int = 3) -> Iterator[BlazePose]:
    """The landmarker with a model file, for at most `people` persons in a picture. An InputError when the file is none
    of its models or mediapipe is missing."""
    path = Path(model)
    if not 1 <= people <= 20:
        raise InputError(f"{people} people cannot be looked for; give 1 to 20.")
    digest = _checked_model(path)
    library = _library()
    vision = library.tasks.vision
    options = vision.PoseLandmarkerOptions(
        base_options=library.tasks.BaseOptions(model_asset_path=str(path)),
        running_mode=vision.RunningMode.IMAGE,
        num_poses=people,
    )
    try:
        landmarker = vision.PoseLandmarker.create_from_options(options)
    except (RuntimeError, ValueError, OSError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"mediapipe {_version(library)} cannot use the model {path} ({reason}); give {_KIND} that belongs to "
            "this version."
        ) from None
    identity = {"detector": "mediapipe", "version": _version(library), "model": digest, "people": people}
    with landmarker:
        yield BlazePose(library, landmarker, identity)


def _point(landmark: Any) -> tuple[float, float, float]:
    """x and y in shares of the picture, and confidence: that the point is in the picture and nothing is before it."""
    likely = [p for p in (landmark.visibility, landmark.presence) if p is not None]
    return float(landmark.x), float(landmark.y), float(np.prod(likely)) if likely else 1.0


def to_pixels(people: Array, width: int, height: int) -> Array:
    """Shares of the picture's sides (P, K, 3) as pixels; what was guessed outside of the picture is not kept."""
    share = people[..., :2]
    inside = np.asarray(np.isfinite(people).all(-1) & (share >= 0).all(-1) & (share <= 1).all(-1))
    out = np.empty_like(people)
    out[..., :2] = share * (width, height) - 0.5
    out[..., 2] = np.clip(people[..., 2], 0.0, 1.0)
    return np.where(inside[..., None], out, 0.0)


def _checked_model(path: Path) -> str:
    """SHA-256 of a model bundle; an InputError when the file is something else."""
    try:
        with open_file(path, _KIND, _MAX_BYTES) as stream, zipfile.ZipFile(stream) as bundle:
            inside = bundle.namelist()
    except zipfile.BadZipFile:
        raise InputError(f"{path} is no model bundle; give {_KIND}, which is a zip archive.") from None
    if _INSIDE not in inside:
        raise InputError(f"{path} is no model of a pose (it holds no {_INSIDE}); give {_KIND}.")
    return str(file_identity(path)["sha256"])


def _library() -> Any:
    named = "name the key points of any other detector in recording.toml (docs/recordings.md)"
    return extra("mediapipe", "Detecting key points", "mediapipe", or_else=named)


def _version(library: Any) -> str:
    return str(getattr(library, "__version__", "of an unknown version"))


# ---- mediapipe environment -----------------------------------------------------------------------------------------
# Key points without a model file: the last MediaPipe that carries its model, in a Python environment of its own.
#
# MediaPipe 0.10.21 (Apache 2.0) holds a pose model and asks for versions of numpy and OpenCV that hypose cannot
# share, so it lives in hypose's cache with the few packages that the pose needs, and is talked to through pipes. One
# person per picture. It is set up once, when the user has agreed; a set-up that is cut short leaves nothing that is
# taken for one.


VERSION = "0.10.21"
MEGABYTES = 410
PACKAGES = (
    *(f"mediapipe=={VERSION}", "numpy>=1.26,<2", "opencv-python-headless>=4.11,<4.12", "protobuf>=4.25.3,<5"),
    *("absl-py", "attrs", "flatbuffers>=2", "matplotlib"),
)
"""mediapipe itself and what its pose imports; jax, scipy and sound, which it names too, are half a gigabyte more."""
_OWN = Path(__file__).parent
"""Where its processes run, apart from whatever lies in the folder that the user is in."""
_PYTHONS = ((3, 9), (3, 12))
"""that it was built for, first and last"""


def environment_folder() -> Path:
    """Where the environment lies, or would; an InputError where no cache can be written."""
    cache = cache_folder()
    if cache is None:
        raise InputError(
            "MediaPipe's environment needs a cache that can be written; name a folder by HYPOSE_CACHE_DIR."
        )
    return cache.absolute() / "environments" / f"mediapipe-{VERSION}"


def environment_python() -> Path:
    """The environment's Python."""
    return environment_folder() / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


def is_set_up() -> bool:
    """The environment is complete."""
    return environment_python().exists()


def set_up() -> Path:
    """Make the environment by pip and return its folder; an InputError says what failed, and nothing is left then."""
    target, python = environment_folder(), _python()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=".making-", dir=target.parent))
    except OSError as error:
        raise InputError(
            f"{target.parent} cannot be written ({error.strerror}); name another by HYPOSE_CACHE_DIR."
        ) from None
    try:
        _run([python, "-I", "-m", "venv", str(work)])
        inside = work / environment_python().relative_to(target)
        _run([str(inside), "-I", "-m", "pip", "install", "--quiet", "--no-deps", PACKAGES[0]])
        _run([str(inside), "-I", "-m", "pip", "install", "--quiet", *PACKAGES[1:]])
        _run([str(inside), "-I", "-c", "import mediapipe; mediapipe.solutions.pose"])
        with contextlib.suppress(OSError):  # another run was as quick
            work.rename(target)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return target


def _python() -> str:
    """A Python that MediaPipe was built for: this one, or one on the path."""
    first, last = _PYTHONS
    if first <= sys.version_info[:2] <= last:
        return sys.executable
    for minor in range(last[1], first[1] - 1, -1):
        if found := shutil.which(f"python3.{minor}"):
            return found
    built, this = (f"{first[0]}.{first[1]} to {last[0]}.{last[1]}", f"{sys.version_info[0]}.{sys.version_info[1]}")
    raise InputError(
        f"MediaPipe {VERSION}, the last with its own model, runs on Python {built}; this is {this} and no other was "
        "found. Install one beside it, or give a model file by --model or a detector by --detector."
    )


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, cwd=_OWN)
    if done.returncode:
        lines = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        reason = lines[-1].strip()[:300] if lines else f"exit code {done.returncode}"
        raise InputError(
            f"MediaPipe's environment could not be made ({reason}); see that the package registry can be reached, or "
            "give a model file by --model or a detector by --detector."
        )


@dataclass(frozen=True)
class MediaPipe:
    """The landmarker in its environment as a `PoseDetector`; opened by `open_mediapipe`."""

    process: subprocess.Popen[bytes]
    identity: dict[str, Any]
    keypoint_set: str = "BLAZEPOSE_33"

    def detect(self, image: NDArray[np.uint8], /) -> Array:
        """People (0 or 1, 33, 3) in a picture (h, w, 3) BGR; an InputError when the environment stopped answering."""
        height, width = image.shape[:2]
        pipe = _given(self.process.stdin)
        try:
            pipe.write(struct.pack("<ii", height, width))
            pipe.write(np.ascontiguousarray(image).data)
            pipe.flush()
        except OSError:  # its answer tells
            pass
        person = _answer(self.process)
        people = np.array([] if person is None else person, dtype=np.float64)
        return to_pixels(people.reshape(-1, len(BLAZEPOSE_33), 3), width, height)


@contextlib.contextmanager
def open_mediapipe() -> Iterator[MediaPipe]:
    """The landmarker, ready; an InputError when the environment is absent or does not work."""
    if not is_set_up():
        raise InputError(f"MediaPipe's environment is not set up in {environment_folder()}; run again with --yes.")
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    clean |= {"GLOG_minloglevel": "2", "TF_CPP_MIN_LOG_LEVEL": "2", "MPLBACKEND": "agg"}
    command = [str(environment_python()), "-I", mediapipe_worker.__file__]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=clean, cwd=_OWN
    )
    try:
        version = _answer(process)["version"]
        yield MediaPipe(process, {"detector": "mediapipe", "version": version, "model": "pose_landmark_full, its own"})
    finally:
        with contextlib.suppress(OSError):
            _given(process.stdin).close()
        process.kill()
        process.wait()
        _given(process.stdout).close()


def _answer(process: subprocess.Popen[bytes]) -> Any:
    line = _given(process.stdout).readline()
    try:
        return json.loads(line)
    except ValueError:
        raise InputError(
            f"MediaPipe stopped answering; delete {environment_folder()} and run again, which sets it up anew."
        ) from None


def _given(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe


# ---- own detector --------------------------------------------------------------------------------------------------
# A detector of the user's own: an object in a Python file or an installed module, named on the command line.


_EXAMPLE = (
    "a class with keypoint_set, identity and detect(image), which gives people x points x 3 (px, px, score); see "
    "docs/recordings.md"
)


@dataclass(frozen=True)
class OwnDetector:
    """The user's detector with its answers checked."""

    detector: Any
    keypoint_set: str
    identity: dict[str, Any]
    where: str

    def detect(self, image: NDArray[np.uint8], /) -> Array:
        """People (P, K, 3) in a picture (h, w, 3) BGR; an InputError when the detector answers with something else."""
        count = len(keypoint_names(self.keypoint_set))
        try:
            people = np.array(self.detector.detect(image), dtype=np.float64)
        except (TypeError, ValueError):
            people = np.zeros(1)
            wrong = "something that is no array of numbers"
        else:
            wrong = f"the shape {people.shape}"
        if people.size == 0 and people.ndim:
            return np.zeros((0, count, 3))
        if people.ndim != 3 or people.shape[1:] != (count, 3):
            raise InputError(
                f"The detector {self.where} answers with {wrong}; its set {self.keypoint_set} needs people x {count} x "
                "3 (px, px, score)."
            )
        finite = np.isfinite(people).all(-1, keepdims=True)
        return np.where(finite, np.maximum(people, [-np.inf, -np.inf, 0]), 0.0)


def open_own_detector(text: str) -> PoseDetector:
    """The detector that FILE.py:NAME or MODULE:NAME names: an object, or a class or function that makes one when it is
    called without arguments. Its code runs, so name only what you trust. An InputError when it cannot be used."""
    place, colon, name = text.rpartition(":")
    if not colon or not place or not name.isidentifier():
        raise InputError(f"--detector {text} is not understood; write FILE.py:NAME or MODULE:NAME.")
    module = _module(place)
    found = getattr(module, name, None)
    if found is None:
        raise InputError(f"{place} has no {name}; it needs {_EXAMPLE}.")
    try:
        detector = found() if callable(found) and not hasattr(found, "detect") or isinstance(found, type) else found
        kind = getattr(detector, "keypoint_set", None)
        identity = getattr(detector, "identity", {"detector": text})
    except Exception as error:  # the user's own code may fail in any way
        raise InputError(
            f"The detector {text} cannot be made ({type(error).__name__}: {error}); correct it."
        ) from error
    if not callable(getattr(detector, "detect", None)) or not isinstance(kind, str):
        raise InputError(f"{text} is no detector; it needs {_EXAMPLE}.")
    keypoint_names(kind)
    if not isinstance(identity, dict) or not is_plain(identity):
        raise InputError(f"The identity of {text} must be a table of texts and numbers that says program and model.")
    return OwnDetector(detector, kind, dict(identity), text)


def _module(place: str) -> Any:
    try:
        if place.endswith(".py"):
            path = Path(place)
            if not path.is_file():
                raise InputError(f"--detector: {path} does not exist; write FILE.py:NAME or MODULE:NAME.")
            spec = importlib.util.spec_from_file_location(f"detector_{path.stem}", path)
            assert spec is not None and spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module  # dataclasses and pickles look there
            spec.loader.exec_module(module)
            return module
        return importlib.import_module(place)
    except InputError:
        raise
    except Exception as error:  # the user's own code may fail in any way
        raise InputError(
            f"The detector's {place} cannot be loaded ({type(error).__name__}: {error}); correct it, or install what "
            "it needs."
        ) from error
