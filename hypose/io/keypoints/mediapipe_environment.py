"""Key points without a model file: the last MediaPipe that carries its model, in a Python environment of its own.

MediaPipe 0.10.21 (Apache 2.0) holds a pose model and asks for versions of numpy and OpenCV that hypose cannot share, so
it lives in hypose's cache with the few packages that the pose needs, and is talked to through pipes. One person per
picture. It is set up once, when the user has agreed; a set-up that is cut short leaves nothing that is taken for one.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hypose.compute import cache_folder
from hypose.errors import InputError
from hypose.evidence.keypoints import BLAZEPOSE_33
from hypose.geometry import Array
from hypose.io.keypoints import mediapipe_worker
from hypose.io.keypoints.blazepose import to_pixels

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
