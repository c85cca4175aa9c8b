"""What a run finds out before it tracks, kept beside its checkpoint: the subject, and the backgrounds of the views.

It belongs to one run (its identity), and goes when the run is complete.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import HyposeError
from hypose.evidence.background import BackgroundModel
from hypose.inference.hypotheses import Hypotheses
from hypose.io.motions.results import Checkpoint, ResultsFolder, file_identity, load_body, save_body
from hypose.pipeline.first_frame import Subject
from hypose.tracking.keypoint_evidence import KeypointModel

SUBJECT = "subject.npz"
_OPTIONAL = ("sd", "view", "beside")
_MODEL = ("joint", "offset", "known", *_OPTIONAL)


def keep_subject(subject: Subject, results: ResultsFolder, identity: Mapping[str, Any]) -> None:
    """Write body.npz, and subject.npz with everything else."""
    body = results.file("body.npz")
    save_body(subject.body, body)
    arrays = {"start": subject.start}
    meta: dict[str, Any] = {"notes": list(subject.notes), "body": file_identity(body)["sha256"]}
    if subject.rivals is not None:
        arrays |= {"rivals": subject.rivals.values, "rivals_weights": subject.rivals.log_weights}
    if subject.unsure is not None:
        arrays["unsure"] = subject.unsure
    if subject.keypoints is not None:
        model = subject.keypoints
        arrays |= {name: np.asarray(v) for name in _MODEL if (v := getattr(model, name)) is not None}
        meta["keypoints"] = list(model.names)
    Checkpoint(0, arrays, meta, identity).save(results.file(SUBJECT))


def kept_subject(results: ResultsFolder, identity: Mapping[str, Any]) -> Subject | None:
    """The subject that the same run kept; None when there is none, or its body is gone or another one."""
    body = results.file("body.npz")
    try:
        saved = Checkpoint.load(results.file(SUBJECT), identity)
        if saved.meta["body"] != file_identity(body)["sha256"]:
            return None
        model = None
        if "keypoints" in saved.meta:
            a = saved.arrays
            names, known = tuple(saved.meta["keypoints"]), a["known"].astype(np.bool_)
            model = KeypointModel(names, a["joint"].astype(np.int64), a["offset"], known, *map(a.get, _OPTIONAL))
        a, rivals = saved.arrays, None
        if "rivals" in a:
            rivals = Hypotheses(a["rivals"], a["rivals_weights"])
        return Subject(load_body(body), model, a["start"], tuple(saved.meta["notes"]), rivals, a.get("unsure"))
    except (HyposeError, KeyError, TypeError):
        return None


def keep_backgrounds(backgrounds: Sequence[BackgroundModel | None], path: Path, identity: Mapping[str, Any]) -> None:
    """Write the backgrounds of the views (None: a view with masks of its own)."""
    arrays: dict[str, np.ndarray] = {}
    notes: list[str | None] = []
    for n, one in enumerate(backgrounds):
        notes.append(None if one is None else one.note)
        if one is not None:
            arrays |= {f"mean_{n}": one.mean, f"sd_{n}": one.sd, f"valid_{n}": one.valid}
    Checkpoint(0, arrays, {"notes": notes}, identity).save(path)


def kept_backgrounds(path: Path, identity: Mapping[str, Any]) -> tuple[BackgroundModel | None, ...] | None:
    """The backgrounds that the same run kept; None when there are none."""
    try:
        saved = Checkpoint.load(path, identity)
        return tuple(_background(saved.arrays, n, note) for n, note in enumerate(saved.meta["notes"]))
    except (HyposeError, KeyError, TypeError):
        return None


def _background(arrays: Mapping[str, np.ndarray], view: int, note: str | None) -> BackgroundModel | None:
    if note is None:
        return None
    mean, sd = (arrays[f"{k}_{view}"].astype(np.float32) for k in ("mean", "sd"))
    return BackgroundModel(mean, sd, arrays[f"valid_{view}"].astype(np.bool_), note)
