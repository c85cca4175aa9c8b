"""A trained gesture as arrays and plain values: the content of a model file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.compute.forests import GrowingArrays
from hypose.errors import InputError
from hypose.gestures.forest import ForestSettings, GrowingForest
from hypose.gestures.online import Learner, LearnSettings

_FORMAT, VERSION = "hypose-gesture", 3


def check_gesture_name(name: str) -> None:
    """Raise InputError where a text is not a valid name of a gesture.

    Why: names become parts of file names and arguments of commands, which must not mistake one for an option.
    """
    if not 1 <= len(name) <= 64 or not all(c.isalnum() or c in "_-" for c in name) or name.startswith("-"):
        raise InputError(
            f"{name[:80]!r} is not a valid name of a gesture; use up to 64 letters, digits, - and _, and no - at the "
            "start."
        )


@dataclass(frozen=True)
class GestureModel:
    """Trained model of one gesture.

    name: name of the gesture.
    learner: the forest, with the state from which its training continues.
    threshold: score (cm^2) from which the gesture counts as shown; None: not known yet.
    history: sessions that it was trained on, plain values.
    Raises: InputError where the name is not valid.
    """

    name: str
    learner: Learner
    threshold: float | None
    history: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        check_gesture_name(self.name)

    def learned(self, content: str) -> bool:
        """Return whether the model has learned from the session with this content (a hash)."""
        return bool(content) and any(entry.get("content") == content for entry in self.history)


def to_arrays(model: GestureModel) -> dict[str, NDArray]:
    """Convert a model to arrays for an .npz file: those of the forest, "description", a JSON text, and "digest", the
    hash of all others.
    """
    learner = model.learner
    value: dict[str, Any] = {
        "format": _FORMAT,
        "version": VERSION,
        "name": model.name,
        "threshold": model.threshold,
        "forest": asdict(learner.forest.settings),
        "history": [dict(h) for h in model.history],
        "random": learner.rng.bit_generator.state,
        "strength": learner.strength,
        "learning": {k: v for k, v in asdict(learner.settings).items() if k != "look"},
    }
    arrays = {name: np.asarray(a) for name, a in learner.forest.arrays._asdict().items()}
    arrays["description"] = np.array(json.dumps(value, sort_keys=True))
    return {**arrays, "digest": np.array(_digest(arrays))}


def from_arrays(arrays: Mapping[str, NDArray]) -> GestureModel:
    """Make a model from the arrays of `to_arrays`.

    Raises: ValueError with a short reason where the arrays are not a model, or are not as they were written. Why: what
        follows the trees is compiled code, which would leave an array.
    """
    try:
        value = json.loads(str(arrays["description"]))
        kind = value["format"], value["version"]
    except (ValueError, RecursionError, KeyError, TypeError):
        raise ValueError("it has no description") from None
    if kind != (_FORMAT, VERSION):
        raise ValueError(f"it is a {kind[0]} of version {kind[1]}, this hypose reads {_FORMAT} of version {VERSION}")
    if str(arrays.get("digest")) != _digest({k: a for k, a in arrays.items() if k != "digest"}):
        raise ValueError("its content was changed after it was written")
    taken = {name: np.require(arrays[name], None, ["C", "W", "A"]) for name in GrowingArrays._fields}
    rng = np.random.default_rng()
    rng.bit_generator.state = value["random"]
    forest = GrowingForest(ForestSettings(**value["forest"]), GrowingArrays(**taken))
    learning = {f.name: value["learning"][f.name] for f in fields(LearnSettings) if f.name in value["learning"]}
    learner = Learner(forest, rng, LearnSettings(**learning), value["strength"])
    return GestureModel(value["name"], learner, value["threshold"], tuple(value["history"]))


def _digest(arrays: Mapping[str, NDArray]) -> str:
    """Compute the hash of arrays with their names, types and shapes."""
    digest = hashlib.sha256()
    for name, a in sorted(arrays.items()):
        digest.update(f"{name} {a.dtype.str} {a.shape}".encode() + a.tobytes())
    return digest.hexdigest()
