"""A detector of the user's own: an object in a Python file or an installed module, named on the command line."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.evidence.detector import PoseDetector
from hypose.evidence.keypoints import keypoint_names
from hypose.evidence.pose_network import Crop, Sighting
from hypose.geometry import Array
from hypose.json_text import is_plain

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
    gives_masks: bool = False

    def look(self, image: NDArray[np.uint8], number: int = 0, before: Sequence[Crop] = (), /) -> list[Sighting]:
        """People in a picture (h, w, 3) BGR; an InputError as of `detect`."""
        return [Sighting(person) for person in self.detect(image)]

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
