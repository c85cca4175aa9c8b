"""Tracks a person through the pictures of one camera: start, tracker, Motion with all modes; checkpoints, resume."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import HyposeError, InputError
from hypose.io.motions.bodies import load_body, save_body
from hypose.io.motions.modes import Modes, from_arrays, joined, save_modes, to_arrays
from hypose.io.motions.results import Checkpoint, ResultsFolder, save_motion
from hypose.io.recordings.provenance import identity
from hypose.io.recordings.recording import Recording
from hypose.monocular.settings import MonoSettings
from hypose.monocular.tracker import MonoTracker
from hypose.monocular.types import MonoEstimate, MonoFrame, MonoHypotheses, MonoState
from hypose.pipeline.mono_clip import modes_of, solve_clip
from hypose.pipeline.mono_start import Clicks, find_start, keypoints_on, load_clicks
from hypose.pipeline.mono_stream import MonoStream
from hypose.pipeline.track_loop import Progress

CITATION = (
    "Sminchisescu & Triggs 2001, A robust multiple hypothesis approach to monocular human motion tracking, with a "
    "constant-velocity prediction, calibrated regions and mirrored limbs at the start."
)
MODES = "modes.npz"
POINT_STARTS = ("auto", "keypoints")
"""Starts that are no file of clicks."""
_BODY = "body.npz"
_STATE = ("poses", "velocities", "covariances", "weights", "costs", "evidence", "labels")


@dataclass(frozen=True)
class MonoOptions:
    """What a user chooses. evidence: one of mono_stream.CUES; start: 'auto' or 'keypoints' (a detector's), or the path
    of a file of clicks; height m; floor: its height in the world, m, None when it is not known; hypotheses: how many
    are followed; subject: where the given body comes from; smooth: solve the whole clip at the end
    (mono_clip.solve_clip); checkpoint_every: frames."""

    evidence: str = "auto"
    start: str = "auto"
    height: float | None = None
    floor: float | None = None
    hypotheses: int = 7
    seed: int = 0
    subject: str | None = None
    smooth: bool = True
    checkpoint_every: int = 50

    @property
    def recipe(self) -> str:
        """The name under which results and provenance are kept."""
        return "monocular"

    def settings(self) -> dict[str, Any]:
        """The choices that decide the result."""
        return {k: v for k, v in asdict(self).items() if k != "checkpoint_every"}

    def tracker_settings(self, frame_rate: float, *, keypoints: bool) -> MonoSettings:
        """The tracker's settings. keypoints: every frame has them; they tell mirrored limbs apart sooner or later, so
        these are tried while tracking, too."""
        usual = MonoSettings(frame_rate=frame_rate)
        return replace(usual, search=replace(usual.search, hypotheses=self.hypotheses, flips=keypoints))


@dataclass(frozen=True)
class MonoResult:
    """motion of the best hypotheses, or of the whole clip when it was solved; all modes; the subject's body; complete:
    every frame was tracked and the clip solved; notes."""

    motion: Motion
    modes: Modes
    body: Body
    complete: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Rows:
    """Of T finished frames: all modes, and lost (T,) of the best mode."""

    modes: Modes
    lost: np.ndarray

    def __len__(self) -> int:
        return len(self.lost)


def clicks_of(options: MonoOptions, recording: Recording) -> Clicks | None:
    """The clicks that a track starts from; None when it starts from key points."""
    return None if options.start in POINT_STARTS else load_clicks(options.start, recording)


def track_stream(
    stream: MonoStream,
    options: MonoOptions,
    *,
    body: Body | None = None,
    results: ResultsFolder | None = None,
    record: Mapping[str, Any] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> MonoResult:
    """Tracks all frames of a stream.

    body: the person's own, taken as it is (default: found with the start, from the template). With `results` a
    checkpoint is written every `checkpoint_every` frames, and motion.npz and modes.npz at the end or when interrupted
    (KeyboardInterrupt, for example from progress). `record` is the provenance; its identity must match for `resume`. An
    InputError when there is nothing to start from.
    """
    report = progress or (lambda stage, done, total: None)
    total, recording = len(stream), stream.recording
    settings = options.tracker_settings(recording.frame_rate, keypoints=len(stream.keypoint_names) > 0)
    key = identity(record or {})
    body, state, done, notes = _begin(stream, options, settings, body, results, resume, key, report)
    tracker = MonoTracker(body, stream.camera, settings, floor=options.floor)
    parts = [] if done is None else [done]
    count = 0 if done is None else len(done)

    def keep() -> None:
        if results is not None and parts:
            _save_checkpoint(results, state, _join(parts), key, notes)

    try:
        for index in range(count, total):
            report("track", index, total)
            seen = _frame(stream, body, index)
            state, estimate = tracker.step(state, seen, np.random.default_rng([options.seed, seen.index]))
            parts.append(_rows(body, estimate))
            count += 1
            if count % options.checkpoint_every == 0 and count < total:
                keep()
        report("track", total, total)
        found = _result(body, _join(parts), recording, record, True, notes)
        if options.smooth:
            keep()
            read = partial(_frame, stream, body)
            motion = solve_clip(tracker, found.motion, found.modes, state.hypotheses, read, options.seed, report)
            found = replace(found, motion=motion)
    except KeyboardInterrupt:
        if not parts:
            raise
        keep()
        found = _result(body, _join(parts), recording, record, False, notes)
    except HyposeError as error:
        if not parts or results is None:
            raise
        with contextlib.suppress(HyposeError):  # the first error is the one to tell
            keep()
            _save(_result(body, _join(parts), recording, record, False, notes), results)
        raise type(error)(f"{error} The {count} frames before are kept in {results.path}; see --resume.") from error
    if results is not None:
        _save(found, results)
        if found.complete:
            results.checkpoint.unlink(missing_ok=True)
    return found


def _frame(stream: MonoStream, body: Body, index: int) -> MonoFrame:
    frame, seen = stream.frame(index), stream.keypoints(index)
    return frame if seen is None else replace(frame, points=keypoints_on(body, stream.keypoint_names, seen))


def _begin(
    stream: MonoStream,
    options: MonoOptions,
    settings: MonoSettings,
    given: Body | None,
    results: ResultsFolder | None,
    resume: bool,
    key: Mapping[str, Any],
    report: Progress,
) -> tuple[Body, MonoState, _Rows | None, tuple[str, ...]]:
    """Body, first state, what is already tracked, and notes: from a checkpoint, or from the start's points."""
    if resume and results is not None and results.checkpoint.exists():
        saved = Checkpoint.load(results.checkpoint, key)
        state, rows = _from_checkpoint(saved, str(results.checkpoint))
        return load_body(results.file(_BODY)), state, rows, tuple(saved.meta["notes"])
    report("subject", 0, 1)
    clicks = clicks_of(options, stream.recording)
    fit, notes = find_start(
        stream, clicks=clicks, body=given, height=options.height, floor=options.floor, settings=settings
    )
    report("subject", 1, 1)
    if results is not None:
        save_body(fit.body, results.file(_BODY))
    return fit.body, MonoState(0, fit.hypotheses, None), None, (*stream.notes, *notes)


def depth_note(motion: Motion, modes: Modes, body: Body) -> str:
    """A sentence that says how uncertain the depth is, in mm, and how many poses are still possible."""
    depth = 1e3 * float(np.nanmedian(modes.depth_sd))
    whole = 3 * np.asarray(motion.joint_sd) ** 2
    across = 1e3 * float(np.nanmedian(np.sqrt(np.maximum(whole - modes.depth_sd**2, 0.0) / 2)))
    rival = modes.alive > 1
    spread = 0.0
    if rival.any():
        apart = np.linalg.norm(modes.joints[:, 1:] - modes.joints[:, :1], axis=-1)
        spread = 1e3 * float(np.nanmedian(np.nanmax(apart[rival], axis=(1, 2))))
    others = np.median(modes.alive) - 1
    return (
        f"one camera does not measure depth: along its line of sight a joint is known to +-{depth:.0f} mm (1 sd, "
        f"median), across it to +-{across:.0f} mm; beside the best pose {others:.0f} others explain the pictures "
        f"nearly as well (median), whose joints lie up to {spread:.0f} mm elsewhere: see {MODES}"
    )


def _rows(body: Body, estimate: MonoEstimate) -> _Rows:
    return _Rows(modes_of(body, estimate), np.array([estimate.lost]))


def _join(parts: list[_Rows]) -> _Rows:
    modes = joined([p.modes for p in parts])
    return _Rows(modes, np.concatenate([p.lost for p in parts]))


def _result(
    body: Body,
    rows: _Rows,
    recording: Recording,
    record: Mapping[str, Any] | None,
    complete: bool,
    notes: tuple[str, ...],
) -> MonoResult:
    t = len(rows)
    poses = rows.modes.poses[:, 0]
    motion = Motion(
        body.skeleton,
        np.arange(t) / recording.frame_rate,
        body.joints(poses),
        poses,
        rows.modes.joint_covariance.astype(np.float32),
        rows.lost,
        np.zeros(t, dtype=bool),
        np.ones(t, dtype=np.int64),
        np.full(t, np.nan),  # costs of pictures are no overlap of silhouettes; those of the modes are in modes.npz
        record or {},
    )
    return MonoResult(motion, rows.modes, body, complete, (*notes, depth_note(motion, rows.modes, body)))


def _save(found: MonoResult, results: ResultsFolder) -> None:
    save_motion(found.motion, results.motion)
    save_modes(found.modes, results.file(MODES))


def _save_checkpoint(
    results: ResultsFolder, state: MonoState, rows: _Rows, key: Mapping[str, Any], notes: tuple[str, ...]
) -> None:
    arrays = {f"h_{name}": np.asarray(getattr(state.hypotheses, name)) for name in _STATE}
    assert state.grey is not None
    arrays |= {"grey": state.grey, "frames": np.array(state.frames)}
    arrays |= {f"done_{k}": v for k, v in to_arrays(rows.modes).items()}
    arrays["lost"] = rows.lost
    Checkpoint(len(rows), arrays, {"notes": list(notes)}, key).save(results.checkpoint)


def _from_checkpoint(saved: Checkpoint, source: str) -> tuple[MonoState, _Rows]:
    a = saved.arrays
    try:
        values = [np.asarray(a[f"h_{name}"]) for name in _STATE[:-1]]
        hypotheses = MonoHypotheses(*values, labels=np.asarray(a["h_labels"], dtype=np.int8))
        state = MonoState(int(a["frames"]), hypotheses, np.asarray(a["grey"], dtype=np.uint8))
        done = {k.removeprefix("done_"): np.asarray(v) for k, v in a.items() if k.startswith("done_")}
        return state, _Rows(from_arrays(done, source), np.asarray(a["lost"], dtype=bool))
    except KeyError as missing:
        raise InputError(f"{source} is no checkpoint of a monocular track ({missing} is missing); run again.") from None
