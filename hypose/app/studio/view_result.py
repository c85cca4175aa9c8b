"""A results folder as something to look at: the motion, and what lies around it (body, recording, truth)."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from hypose.app.jobs.truth import compare_with_truth
from hypose.app.reports.summary import DESCRIPTIONS, summarize
from hypose.app.studio.catalog import recording_above
from hypose.app.studio.view_bundle import Rivals, ViewResult, pictured
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import HyposeError, InputError
from hypose.io.files import read_json
from hypose.io.motions.results import ResultsFolder, load_body, load_joints_of_modes, load_motion
from hypose.io.recordings.recording import Recording, load_recording
from hypose.pipeline.verdict import Verdict, verdict_of
from hypose.tracking.recipes import citation_of

_T = TypeVar("_T")


def load_view(results: str | Path, recording: Recording | None = None) -> ViewResult:
    """What can be shown of a results folder, or of a motion.npz.

    recording: by default that in whose folder the results lie. A body, recording or truth that is absent or cannot be
    read leaves its part out, and a note says why; an InputError when there is no motion.
    """
    path = Path(results)
    if not path.exists():
        raise InputError(f"{path} does not exist; give the results folder that hypose track wrote.")
    folder = ResultsFolder(path if path.is_dir() else path.parent)
    motion = load_motion(folder.motion if path.is_dir() else path)
    if len(motion) == 0:
        raise InputError(f"{path} holds a motion of no frames, so there is nothing to show; track the recording again.")
    notes: list[str] = []

    def part(what: str, make: Callable[[], _T | None]) -> _T | None:
        try:
            return make()
        except HyposeError as error:
            notes.append(f"{what}: {error}")
            return None

    body = part("The body is not shown", lambda: _body(folder, motion))
    if recording is None:
        recording = part("The recording cannot be shown", lambda: find_recording(folder.path))
    first, truth = first_frame(motion), None
    if recording is not None:
        notes += recording.notes
        known = recording.folder / "truth.npz"
        if known.is_file() and motion.poses is not None:
            truth = part("The truth is not shown", lambda: compare_with_truth(known, motion, first))
    return in_recording(
        recording,
        motion,
        body,
        title=recording.name if recording is not None else folder.path.resolve().name,
        first_frame=first,
        files=[(n, w, p.stat().st_size) for n, w in DESCRIPTIONS.items() if (p := folder.file(n)).is_file()],
        notes=notes,
        citation=_citation(motion),
        truth=truth,
        complete=not folder.checkpoint.exists(),
        rivals=part("Other poses are not shown", lambda: _rivals(folder.file("modes.npz"), motion)),
        verdict=_verdict(folder.file("verdict.json"), motion),
    )


def in_recording(recording: Recording | None, motion: Motion, body: Body | None, **more: Any) -> ViewResult:
    """A motion with what its recording says of the cameras; more: other fields of a ViewResult."""
    if recording is None:
        return ViewResult(motion=motion, body=body, **more)
    shifts = [v.image_shift for v in recording.views]
    cameras = {"rig": recording.rig, "image_shifts": shifts, "pictures": pictured(recording)}
    return ViewResult(**{"title": recording.name, **cameras, "motion": motion, "body": body, **more})


def first_frame(motion: Motion) -> int:
    """The recording's frame of row 0, as far as a motion tells; others than hypose may have written it."""
    with contextlib.suppress(TypeError, KeyError, IndexError, ValueError, OverflowError):
        return int(motion.provenance["settings"]["frames"][0])
    return 0


def find_recording(results: Path) -> Recording | None:
    """The recording whose folder holds the results (results/RECIPE/ in it), None when there is none."""
    folder = recording_above(results)
    return None if folder is None else load_recording(folder)


def _citation(motion: Motion) -> str:
    """Where the method of a motion comes from, "" for one that is not known."""
    settings = motion.provenance.get("settings")
    refined = isinstance(settings, Mapping) and bool(settings.get("refine"))
    return citation_of(str(motion.provenance.get("recipe")), refined)


def _body(folder: ResultsFolder, motion: Motion) -> Body | None:
    path = folder.file("body.npz")
    if motion.poses is None or not path.is_file():
        return None
    body = load_body(path)
    if body.skeleton.joint_names != motion.skeleton.joint_names:
        raise InputError("body.npz and the motion belong to different bodies; track again.")
    return body


def _rivals(path: Path, motion: Motion) -> Rivals | None:
    """Where the modes of a track with one camera lie beside its motion, which is their first; else what the motion
    has kept."""
    if not path.is_file():
        return Rivals.of_motion(motion)
    joints, weights = load_joints_of_modes(path)
    return Rivals.of(joints, weights) if (len(joints), joints.shape[2]) == motion.joints.shape[:2] else None


def _verdict(path: Path, motion: Motion) -> Verdict | None:
    """As it was written when the motion was tracked, which knows what was found before; else from the motion."""
    with contextlib.suppress(InputError, ValueError, KeyError, TypeError):
        return Verdict.of_document(read_json(path, "a verdict"))
    return None if motion.doubtful is None else verdict_of(motion)


def quality_of(folder: Path, motion: Motion) -> dict[str, Any]:
    """What a list says of how good a result is: verdict (a word, None when nothing has looked), iou, sd_mm, lost (share
    of the frames)."""
    told, s = _verdict(folder / "verdict.json", motion), summarize(motion)
    lost = (s.lost + s.extrapolated) / max(1, s.frames)
    return {"verdict": told and told.word, "iou": s.iou, "sd_mm": s.sd_mm, "lost": lost}
