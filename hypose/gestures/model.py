"""A trained gesture as arrays and plain values: the content of a model file, and its check on loading."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.compute.forests import GrowingArrays
from hypose.errors import InputError
from hypose.gestures.forest import CLASSES, ForestSettings, GrowingForest
from hypose.gestures.online import Learner, LearnSettings

_FORMAT, VERSION = "hypose-gesture", 2
_KINDS = {
    "test": ("<i2", 3), "left": ("<i2", 2), "seen": ("<u4", 3), "level": ("|u1", 2), "slot": ("<i2", 2),
    "size": ("<i4", 1), "free": ("<i2", 2), "n_free": ("<i4", 1), "candidate": ("<i2", 4), "left_count": ("<u2", 4),
    "total": ("<i4", 3), "random": ("<u8", 1), "tally": ("<i8", 1),
}  # fmt: skip


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

    name: of the gesture.
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
    """Convert a model to arrays for an .npz file: those of the forest, and "description", a JSON text."""
    learner = model.learner
    value: dict[str, Any] = {
        "format": _FORMAT,
        "version": VERSION,
        "growing": True,
        "names": [model.name],
        "thresholds": [model.threshold],
        "forest": asdict(learner.forest.settings),
        "history": [dict(h) for h in model.history],
        "learner": {
            "random": learner.rng.bit_generator.state,
            "strength": {} if learner.strength is None else {"1": learner.strength},
            "settings": {k: v for k, v in asdict(learner.settings).items() if k != "look"},
        },
    }
    arrays = {name: np.asarray(a) for name, a in learner.forest.arrays._asdict().items()}
    return {**arrays, "description": np.array(json.dumps(value, sort_keys=True))}


def from_arrays(arrays: Mapping[str, NDArray]) -> GestureModel:
    """Make a model from the arrays of `to_arrays`.

    Raises: ValueError with a short reason where the arrays are not a model, or following them would leave an array.
    """
    value = _description(arrays)
    names, thresholds = value.get("names"), value.get("thresholds")
    if not isinstance(names, list) or not isinstance(thresholds, list) or len(names) != 1 or len(thresholds) != 1:
        raise ValueError("it is not of one gesture")
    if value.get("growing") is not True or not isinstance(names[0], str):
        raise ValueError("it has no name, or no forest that grows")
    settings = _made(ForestSettings, value.get("forest"))
    taken = {name: _array(arrays, name) for name in GrowingArrays._fields}
    _check_trees(taken, settings)
    _check_growing(taken, settings)
    learner = _learner(value.get("learner"), GrowingForest(settings, GrowingArrays(**taken)))
    history = tuple(h for h in value.get("history") or () if isinstance(h, dict))
    return GestureModel(names[0], learner, None if thresholds[0] is None else float(thresholds[0]), history)


def _description(arrays: Mapping[str, NDArray]) -> dict[str, Any]:
    """Read and check the JSON text among the arrays of a model file; ValueError with a short reason."""
    text = arrays.get("description")
    if text is None or text.dtype.kind != "U" or text.ndim:
        raise ValueError("it has no description")
    try:
        value = json.loads(str(text))
    except (ValueError, RecursionError):
        raise ValueError("its description is not JSON") from None
    if not isinstance(value, dict) or value.get("format") != _FORMAT:
        raise ValueError("it is not a gesture model")
    if value.get("version") != VERSION:
        raise ValueError(f"it is of version {value.get('version')}, this hypose reads version {VERSION}")
    return value


def _made(kind: type, value: Any) -> Any:
    """Make settings from the values of a model file.

    kind: class of the settings.
    value: values by field name.
    Raises: ValueError where it has other fields, or a value is no number or outside its range.
    """
    known = {f.name for f in fields(kind)}
    if not isinstance(value, dict) or not set(value) <= known:
        raise ValueError(f"its {kind.__name__} is not valid")
    for v in value.values():
        if v is not None and not isinstance(v, bool | int | float):
            raise ValueError(f"its {kind.__name__} holds {v!r}")
    try:
        return kind(**value)
    except (InputError, TypeError) as error:
        raise ValueError(str(error).rstrip(".")) from None


def _array(arrays: Mapping[str, NDArray], name: str) -> NDArray:
    """Return an array of a model file; ValueError where it is missing or not of the type in _KINDS."""
    dtype, dimensions = _KINDS[name]
    a = arrays.get(name)
    if a is None or a.dtype != np.dtype(dtype) or a.ndim != dimensions:
        raise ValueError(f"its {name} is missing or of another type")
    return np.require(a, np.dtype(dtype).newbyteorder("="), ["C", "W", "A"])


def _check_trees(a: Mapping[str, NDArray], s: ForestSettings) -> None:
    """Raise ValueError where compiled code that follows the trees would leave an array or run in a circle."""
    test, left, seen, size = a["test"], a["left"], a["seen"], a["size"]
    nt, n = left.shape
    if nt != s.trees or n < 1 or test.shape != (nt, n, 5) or seen.shape[:2] != (nt, n) or size.shape != (nt,):
        raise ValueError("its arrays do not fit each other")
    if seen.shape[2] != CLASSES:
        raise ValueError(f"it has {seen.shape[2]} classes")
    if size.min() < 1 or size.max() > n:
        raise ValueError("it has more nodes than it holds")
    inner = left >= 0
    number = np.arange(n)[None]
    if (inner & (number >= size[:, None])).any() or (left < -1).any():
        raise ValueError("a node lies outside its tree")
    if (inner & ((left <= number) | (left + 1 >= size[:, None]))).any():
        raise ValueError("a node's children do not come after it in its tree")
    if np.abs(test[..., :4].astype(np.int32)).max(initial=0) > s.reach_mm:
        raise ValueError("a test reaches farther than reach_mm")


def _check_growing(a: Mapping[str, NDArray], s: ForestSettings) -> None:
    """Raise ValueError where the arrays of a growing forest do not fit each other, so that growth would leave an array.

    a: arrays by name.
    s: settings of the forest.
    """
    nt, n = a["left"].shape
    c, slots = a["seen"].shape[2], a["free"].shape[1]
    shapes = {
        "level": (nt, n),
        "slot": (nt, n),
        "free": (nt, slots),
        "n_free": (nt,),
        "candidate": (nt, slots, s.candidates, 5),
        "left_count": (nt, slots, s.candidates, c),
        "total": (nt, slots, c),
        "random": (nt,),
        "tally": (2,),
    }
    if any(a[k].shape != shape for k, shape in shapes.items()) or n > s.most_nodes or slots > s.most_slots:
        raise ValueError("its arrays do not fit each other")
    if np.abs(a["candidate"][..., :4].astype(np.int32)).max(initial=0) > s.reach_mm:
        raise ValueError("a test reaches farther than reach_mm")
    for t in range(nt):
        free = a["free"][t, : max(0, int(a["n_free"][t]))]
        used = a["slot"][t, : a["size"][t]]
        both = np.concatenate([free, used[used >= 0]])
        if not 0 <= a["n_free"][t] <= slots or sorted(both.tolist()) != list(range(slots)):
            raise ValueError("its slots are inconsistent")


def _learner(value: Any, forest: GrowingForest) -> Learner:
    """Make the training state of a growing forest.

    value: "learner" of the description: settings, strength, and state of the random numbers.
    forest: that is trained further.
    Raises: ValueError where a value is not valid.
    """
    if not isinstance(value, dict):
        raise ValueError("it has no training state")
    settings, strength = _made(LearnSettings, value.get("settings")), value.get("strength")
    reached = strength.get("1") if isinstance(strength, dict) else np.nan
    if reached is not None and not (isinstance(reached, int | float) and np.isfinite(reached)):
        raise ValueError("its strength is not valid")
    rng = np.random.default_rng()
    try:
        rng.bit_generator.state = value["random"]
    except (TypeError, ValueError, KeyError, OverflowError):
        raise ValueError("its random numbers are not valid") from None
    return Learner(forest, rng, settings, reached)
