"""Track one or more people frame by frame: one loop with progress, interruption, checkpoints and resume.

`TrackingSession` is that loop. One person is a session of one, whose evidence is all that the frames show; several
people are tracked each in what the others leave (`hypose.tracking.several`), and a callback manages who comes and
leaves.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import HyposeError
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.prefetch import pack_once
from hypose.geometry import Array
from hypose.io.motions.results import Checkpoint, ResultsFolder
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.frame_anomalies import as_now, looked_at, mask_change
from hypose.pipeline.one_camera import FrameSource as FrameSource
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.appearance import AppearanceModel
from hypose.tracking.several import Member, step_together
from hypose.tracking.tracker import FrameEstimate, TrackerState, estimates_from_arrays, estimates_to_arrays

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class FrameList:
    """Frames in memory that can be tracked like a recording, e.g. of a synthetic scene or of your own cameras.

    frame_rate: Hz.
    """

    frames: Sequence[Frame]
    frame_rate: float = 25.0

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, 0 <= index < len."""
        return self.frames[index]


StageProgress = Callable[[str, int, int], None]
"""Called often as progress(stage, done, total); raising KeyboardInterrupt in it stops the run and keeps its work."""


class Deferred:
    """Progress function that holds back a KeyboardInterrupt until `settle` is called.

    Why: work that has begun is finished first, so a resumed run continues from the same state.
    """

    def __init__(self, progress: StageProgress) -> None:
        self._progress, self._stopped = progress, False

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report the progress of a stage; see StageProgress."""
        try:
            self._progress(stage, done, total)
        except KeyboardInterrupt:
            self._stopped = True

    def settle(self) -> None:
        """Raise the KeyboardInterrupt that was held back, if there was one."""
        if self._stopped:
            raise KeyboardInterrupt


@dataclass(eq=False)
class Followed:
    """State of a person who is tracked.

    name: of the person; empty where there is only one.
    subject: body and start.
    member: tracker and its state after the last tracked frame.
    results: folder of the person's results; None: nothing is written.
    asked_for: the result is wanted.
    estimates: of each frame so far.
    present: of each frame so far, whether the person is there.
    hidden: of each frame so far, whether others hide the person from all views but one.
    gone: number of frames since the person was last seen.
    track: number of the person's track of key points; None: not known yet.
    appearance: model of the clothes.
    said: sentences for the report.
    """

    name: str
    subject: TrackedSubject
    member: Member
    results: ResultsFolder | None = None
    asked_for: bool = True
    estimates: list[FrameEstimate] = field(default_factory=list)
    present: list[bool] = field(default_factory=list)
    hidden: list[bool] = field(default_factory=list)
    gone: int = 0
    track: int | None = None
    appearance: AppearanceModel = field(default_factory=AppearanceModel)
    said: list[str] = field(default_factory=list)

    @property
    def last_seen(self) -> tuple[Array, int] | None:
        """Pose (D,) in the last frame in which the person was there, and the frames since then; None: never."""
        for since, (estimate, there) in enumerate(zip(self.estimates[::-1], self.present[::-1], strict=True)):
            if there:
                return estimate.pose, since
        return None

    def snapshot(self) -> dict[str, Any]:
        """Copy the values of all fields, for `vars(self).update`; later changes of this person do not reach them."""
        values = {n: list(v) if isinstance(v, list) else v for n, v in vars(self).items()}
        return values | {"appearance": replace(self.appearance, met=dict(self.appearance.met))}

    def was_not(self, since: int, reported: str) -> None:
        """Mark that from frame `since` on another person was tracked instead; reported: how that is known."""
        last = len(self.estimates)
        self.estimates[since:] = [replace(e, lost=True) for e in self.estimates[since:]]
        self.hidden[since:] = [True] * (last - since)
        self.said.append(f"another person was taken for them from frame {since} to {last - 1}, {reported}")

    def take(self, estimate: FrameEstimate, member: Member, present: bool = True, hidden: bool = False) -> None:
        """Add a tracked frame; member: the state after it."""
        self.member = member
        self.estimates.append(estimate)
        self.present.append(present)
        self.hidden.append(hidden)


def _ignore(frame: Frame, seen: Sequence[Frame]) -> None:
    """Manage no tracks: the people stay those of the start."""


@dataclass(eq=False)
class TrackingSession:
    """People who are tracked together frame by frame, from the frame after those that are tracked already.

    people: all with the same number of tracked frames.
    alone: one person, to whom all evidence of the frames belongs.
    frame_rate: Hz.
    checkpoint: file for the state after a part of the frames; None: nothing is written.
    identity: identity of the run; a checkpoint of another run is refused.
    every: least number of frames between two checkpoints.
    keypoints: called with a frame's number, gives the key points of each person, in the order of `people`; None: those
        of the frame.
    manage: called after each frame as manage(frame, seen), seen: the frame as each person's tracker saw it; it may
        add, exchange and end people (`settle` first).
    held: progress of what `manage` does; an interruption in it counts after the frame.
    coming: (4,) per possible new person of the last look: place (2,) m, failed fits, frame of the next fit.
    stopped: the user stopped `track`.
    """

    people: list[Followed]
    alone: bool
    frame_rate: float
    checkpoint: Path | None = None
    identity: Mapping[str, Any] = field(default_factory=dict)
    every: int = 25
    keypoints: Callable[[int], Sequence[Keypoints | None]] | None = None
    manage: Callable[[Frame, Sequence[Frame]], None] = _ignore
    held: Deferred = field(default_factory=lambda: Deferred(lambda stage, done, total: None))
    coming: list[Array] = field(default_factory=list)
    stopped: bool = False
    _judging: list[Future[list[FrameEstimate]]] = field(default_factory=list)

    @property
    def done(self) -> int:
        """Number of tracked frames."""
        return len(self.people[0].estimates)

    def track(
        self, frames: Iterator[Frame], last: Frame | None, total: int, progress: StageProgress
    ) -> HyposeError | None:
        """Track the frames that are not done, up to `total` frames.

        frames: the frames from number `done` on.
        last: the frame before; None: there is none.
        progress: called with "track", done, total. A KeyboardInterrupt that it raises ends tracking and keeps the
            frames that are done; before the first one it is raised.
        Returns: the error that ended tracking after some frames, where there is a checkpoint that keeps them; None
            where all frames are done or the user stopped. Without a checkpoint the error is raised.

        Why a second thread: the statistics of a frame do not influence tracking, so they are computed while the next
        frame is tracked.
        """
        saved, error = self.done, None
        with ThreadPoolExecutor(1, thread_name_prefix="judge") as pool:
            try:
                for t in range(saved, total):
                    progress("track", t, total)
                    frame = next(frames)
                    with self._all_or_nothing():
                        self.step(frame, last, pool)
                    self.held.settle()
                    last = frame
                    # each checkpoint holds all frames, so it is written ever less often: the total work stays linear
                    if self.checkpoint is not None and t + 1 - saved >= max(self.every, saved // 20) and t + 1 < total:
                        self.save(self.checkpoint)
                        saved = t + 1
                progress("track", total, total)
            except KeyboardInterrupt:
                if not self.done:
                    raise
                self.stopped = True
            except HyposeError as problem:
                if not self.done or self.checkpoint is None:
                    raise
                error = problem
            self.settle()
        if self.checkpoint is not None:
            with contextlib.suppress(*(() if error is None else (HyposeError,))):  # the first error counts
                self.save(self.checkpoint)
        return error

    @contextlib.contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        """Take back a frame that an error or a KeyboardInterrupt ended half way, so a resumed run does it whole."""
        people, coming, judging = list(self.people), self.coming, list(self._judging)
        before = [p.snapshot() for p in people]
        try:
            yield
        except BaseException:
            self.people[:], self.coming, self._judging = people, coming, judging
            for p, values in zip(people, before, strict=True):
                vars(p).update(values)
            raise

    def step(self, frame: Frame, last: Frame | None, pool: ThreadPoolExecutor) -> None:
        """Track the next frame; its statistics are computed in `pool`.

        last: the frame before; None: there is none.
        """
        members = [p.member for p in self.people]
        points = () if self.keypoints is None else self.keypoints(self.done)
        if self.alone:
            state, estimate = members[0].tracker.step(members[0].state, frame)
            members, estimates, seen = [replace(members[0], state=state)], [estimate], [frame]
        else:
            members, estimates, seen = step_together(members, frame, points)
        self.settle()
        self._judging = [pool.submit(copy_context().run, self._judged, frame, last, members, estimates, seen)]
        for p, member, estimate, own in zip(self.people, members, estimates, seen, strict=True):
            if self.alone:
                p.take(estimate, member)
                continue
            there, shown = p.member.present, own.visible_share
            p.gone = p.gone + 1 if member.state.lost or member.state.blind > 0 else 0
            if there and p.gone > SETTINGS.people_gone_s * self.frame_rate:
                member, there = replace(member, present=False), False
                since = len(p.present) - p.gone + 1
                p.present[since:] = [False] * len(p.present[since:])
                p.hidden[since:] = [False] * len(p.hidden[since:])
            hidden = there and len(shown) and (shown > SETTINGS.rough_hidden).sum() < frame.fewest_views
            p.take(estimate, member, there, bool(hidden))
        self.manage(frame, seen)

    def _judged(
        self,
        frame: Frame,
        last: Frame | None,
        members: Sequence[Member],
        estimates: Sequence[FrameEstimate],
        seen: Sequence[Frame],
    ) -> list[FrameEstimate]:
        """Add the statistics of a frame to the estimates of all people, see `looked_at`."""
        if self.alone:
            return [looked_at(members[0].tracker, estimates[0], frame, last)]
        for masks in frame.of(Silhouettes):
            pack_once(masks)
        change = mask_change(frame, last)  # of the complete masks, since the ignored part changes too
        return [
            looked_at(m.tracker, estimate, own, None if last is None else as_now(own, last), change)
            for m, estimate, own in zip(members, estimates, seen, strict=True)
        ]

    def settle(self) -> None:
        """Wait for the statistics of the last frame; call it before the estimates are changed or read whole."""
        while self._judging:
            for p, e in zip(self.people, self._judging[-1].result(), strict=True):
                p.estimates[-1] = e
                _LOG.debug(
                    "frame %d %s: cost %.3f, %d views%s", self.done - 1, p.name, e.cost, e.n_views, " lost" * e.lost
                )
            self._judging.pop()

    def save(self, path: Path) -> None:
        """Write the state of all people as a checkpoint."""
        self.settle()
        arrays: dict[str, Any] = {"coming": np.array(self.coming, dtype=np.float64).reshape(-1, 4)}
        about = []
        for k, p in enumerate(self.people):
            arrays |= {f"{k}_{n}": v for n, v in p.member.state.to_arrays().items()}
            arrays |= {f"{k}_done_{n}": v for n, v in estimates_to_arrays(p.estimates).items()}
            arrays |= {f"{k}_present": np.array(p.present), f"{k}_hidden": np.array(p.hidden)}
            arrays |= {f"{k}_{n}": v for n, v in p.appearance.arrays().items()}
            about.append({n: getattr(p, n) for n in ("name", "gone", "track", "asked_for", "said")})
            about[-1] |= {"there": p.member.present, "clothes": p.appearance.about}
        Checkpoint(self.done, arrays, {"people": about}, self.identity).save(path)

    def load(self, path: Path, start_of: Callable[[str], Followed | None]) -> bool:
        """Continue from the checkpoint of an interrupted run.

        start_of: gives a person by name as at the start; None: not known any more.
        Returns: whether there was a checkpoint with people who are all known.
        Raises: InputError where it is of another run.
        """
        if not path.exists():
            return False
        saved, people = Checkpoint.load(path, self.identity), list[Followed]()
        for k, about in enumerate(saved.meta.get("people", ())):
            p = start_of(about["name"])
            if p is None:
                return False
            own = {n.removeprefix(f"{k}_"): v for n, v in saved.arrays.items() if n.startswith(f"{k}_")}
            done = {n.removeprefix("done_"): v for n, v in own.items() if n.startswith("done_")}
            state = TrackerState.from_arrays({n: v for n, v in own.items() if not n.startswith("done_")})
            p.member = replace(p.member, state=state, present=bool(about["there"]))
            p.estimates = estimates_from_arrays(done)
            p.present, p.hidden = own["present"].tolist(), own["hidden"].tolist()
            p.gone, p.track, p.asked_for = int(about["gone"]), about["track"], about["asked_for"]
            p.appearance, p.said = AppearanceModel.of_arrays(own, about["clothes"]), list(about["said"])
            people.append(p)
        self.people, self.coming = people, list(saved.arrays.get("coming", ()))
        return bool(people)
