"""Track one or more people frame by frame: one loop with progress, interruption, checkpoints and resume.

`TrackingSession` is that loop. One person is a session of one, whose evidence is all that the frames show; several
people are tracked each in what the others leave (`hypose.pipeline.track_loop`), and a callback manages who comes and
leaves.

Pixels that other people's bodies cover are no evidence for a person (`hypose.evidence.people`). Within a frame
people are solved one after the other, and the first one alternates: it sees the others where they are predicted, the
last one where they have been solved.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError
from hypose.evidence.cues import OwnEvidence
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.people import PREDICTED_WIDENING, SOLVED_WIDENING, BodyShape, Other, own_frame
from hypose.geometry import Array
from hypose.inference.layer import Recipe
from hypose.io.motions.results import Checkpoint
from hypose.pipeline.frame_anomalies import looked_at, mask_change
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.part_colours import AppearanceModel
from hypose.tracking.recipes import recipe
from hypose.tracking.tracker import (
    FrameEstimate,
    Tracker,
    TrackerSettings,
    TrackerState,
    estimates_from_arrays,
    estimates_to_arrays,
)

# ---- several people in one frame ------------------------------------------------------------------------------------


BLIND = 2
"""Frames without evidence after which a person is searched for beyond the predicted place."""


@dataclass(frozen=True)
class Member:
    """One of several tracked people.

    tracker: how the person is tracked; state: after the last frame.
    present: false for a person who has left or has not come yet; such a person hides no other and is not searched for.
    """

    tracker: Tracker
    state: TrackerState
    present: bool = True

    @property
    def sure(self) -> bool:
        """Whether the tracker knows where the person is: present and not lost."""
        return self.present and not self.state.lost and self.state.blind <= BLIND


def body_shape(body: Body, pose: Array, rig: CameraRig) -> BodyShape:
    """Build a body at a pose (D,) as pinhole cameras see it."""
    return BodyShape(body.skin(pose), body.coarse.faces, rig)


def step_together(
    members: Sequence[Member],
    frame: Frame,
    keypoints: Sequence[Keypoints | None] = (),
    others: Sequence[Other] = (),
    alone: bool = False,
) -> tuple[list[Member], list[FrameEstimate], list[Frame]]:
    """Track all people in one frame.

    keypoints: key points of each person, already assigned; empty: the frame's key points are not used.
    others: further people who are there but not tracked.
    alone: there is one person, to whom all evidence of the frame belongs, key points too.
    Returns: the next members, their estimates, and the frame as each person saw it, without what others hide.
    """
    if alone:
        steps = [m.tracker.step(m.state, frame) for m in members]
        after = [replace(m, state=state) for m, (state, _) in zip(members, steps, strict=True)]
        return after, [estimate for _, estimate in steps], [frame] * len(members)
    count, after = len(members), list(members)
    estimates, seen = dict[int, FrameEstimate](), [frame] * count
    expected = [m.tracker.predicted(m.state) if m.present else m.state.pose for m in members]
    rigs = [s.rig for s in frame.of(Silhouettes)]
    shapes = [body_shape(m.tracker.body, q, r) for r in rigs for m, q in zip(members, expected, strict=True)]
    done = np.zeros(count, dtype=np.bool_)
    for i in ((frame.index + k) % max(count, 1) for k in range(count)):
        m = after[i]
        own = replace(frame, keypoints=keypoints[i] if keypoints else None)
        own = own if m.present else own.unseen()
        for _ in rigs if m.present else ():
            nearby = [
                Other(shapes[j], SOLVED_WIDENING if done[j] else PREDICTED_WIDENING)
                for j in range(count)
                if j != i and after[j].sure
            ]
            lost = m.state.lost or m.state.blind > BLIND
            own = own_frame(own, shapes[i], [*others, *nearby], anywhere=lost)
        state, estimates[i] = m.tracker.step(m.state, own)
        after[i], seen[i], done[i] = replace(m, state=state), own, True
        for rig in rigs if not done.all() else ():
            shapes[i] = body_shape(m.tracker.body, estimates[i].pose, rig)
    return after, [estimates[i] for i in range(count)], seen


_LOG = logging.getLogger(__name__)


# ---- session --------------------------------------------------------------------------------------------------------


StageProgress = Callable[[str, int, int], None]
"""Called often as progress(stage, done, total); raising KeyboardInterrupt in it stops the run and keeps its work."""


def tracker_of(
    subject: TrackedSubject,
    options: TrackOptions,
    frame_rate: float,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
) -> Tracker:
    """Build the tracker of a run.

    method: recipe that replaces the recipe of the options.
    own: evidence in addition to that of the frames.
    """
    about = {"frame_rate": frame_rate, "particles": options.particles, "refine": options.refine}
    made = method or recipe(options.recipe, subject.body, **about, **options.own)
    settings = TrackerSettings(evidence=options.looks_at, seed=options.seed, frame_rate=frame_rate)
    return Tracker(subject.body, made, settings, subject.keypoints, own)


@dataclass(eq=False)
class TrackedPerson:
    """State of a person who is tracked.

    name: name of the person; empty where there is only one.
    subject: body and start.
    member: tracker and its state after the last tracked frame.
    estimates: estimates of each frame so far.
    present: for each frame so far, whether the person is there.
    hidden: for each frame so far, whether others hide the person from all views but one.
    gone: number of frames since the person was last seen.
    track: number of the person's track of key points; None: not known yet.
    appearance: model of the clothes.
    said: sentences for the report.
    """

    name: str
    subject: TrackedSubject
    member: Member
    estimates: list[FrameEstimate] = field(default_factory=list)
    present: list[bool] = field(default_factory=list)
    hidden: list[bool] = field(default_factory=list)
    gone: int = 0
    track: int | None = None
    appearance: AppearanceModel = field(default_factory=AppearanceModel)
    said: list[str] = field(default_factory=list)

    @staticmethod
    def at_start(name: str, subject: TrackedSubject, tracker: Tracker) -> TrackedPerson:
        """Make the state of a person before the first frame."""
        start = tracker.start(subject.start if subject.rivals is None else subject.rivals)
        return TrackedPerson(name, subject, Member(tracker, start))

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

    def mark_mistaken(self, since: int, reported: str) -> None:
        """Mark the estimates from frame `since` on as lost, since another person was tracked instead.

        reported: how that is known, as the end of a sentence for the user.
        """
        last = len(self.estimates)
        self.estimates[since:] = [replace(e, lost=True) for e in self.estimates[since:]]
        self.hidden[since:] = [True] * (last - since)
        self.said.append(f"another person was taken for them from frame {since} to {last - 1}, {reported}")

    def take(self, estimate: FrameEstimate, member: Member) -> None:
        """Add a tracked frame, in which nothing hides the person.

        estimate: estimated pose in the frame, with its uncertainty.
        member: tracker and state after it.
        """
        self.member = member
        self.estimates.append(estimate)
        self.present.append(member.present)
        self.hidden.append(False)


class PeopleManager(Protocol):
    """Protocol of an object that manages people while they are tracked, of a recording or live."""

    @property
    def alone(self) -> bool:
        """Whether there is at most one person, to whom all evidence of a frame belongs."""
        ...

    def keypoints(self, people: Sequence[TrackedPerson], t: int, /) -> Sequence[Keypoints | None]:
        """Return the key points of each person in frame t; empty: people are tracked without key points."""
        ...

    def manage(self, session: TrackingSession, frame: Frame, seen: Sequence[Frame], /) -> None:
        """Add, exchange and end people after a frame (`session.settle` first); seen: the frame as each person's tracker
        saw it.
        """
        ...


@dataclass(eq=False)
class TrackingSession:
    """People who are tracked together frame by frame, from the frame after those that are tracked already.

    people: all with the same number of tracked frames.
    frame_rate: Hz.
    manager: manages several people; None: there is one person, to whom all evidence of the frames belongs.
    checkpoint: file for the state after a part of the frames; None: nothing is written.
    identity: identity of the run; a checkpoint of another run is refused.
    every: least number of frames between two checkpoints.
    progress: called with stage, done, total. A KeyboardInterrupt that it raises takes the frame back that is tracked.
    candidates: (4,) per possible new person of the last look: place (2,) m, failed fits, frame of the next fit.
    stopped: whether the user stopped `track`.
    """

    people: list[TrackedPerson]
    frame_rate: float
    manager: PeopleManager | None = None
    checkpoint: Path | None = None
    identity: Mapping[str, Any] = field(default_factory=dict)
    every: int = 25
    progress: StageProgress = lambda stage, done, total: None
    candidates: list[Array] = field(default_factory=list)
    stopped: bool = False
    _judging: list[Future[list[FrameEstimate]]] = field(default_factory=list)

    @property
    def done(self) -> int:
        """Number of tracked frames; 0 without people."""
        return len(self.people[0].estimates) if self.people else 0

    def track(self, frames: Iterator[Frame], last: Frame | None, total: int) -> HyposeError | None:
        """Track the frames that are not done, up to `total` frames.

        A KeyboardInterrupt that `progress` raises ends tracking and keeps the frames that are done; before the first
        one it is raised.
        frames: the frames from number `done` on.
        last: the frame before; None: there is none.
        Returns: the error that ended tracking after some frames, where there is a checkpoint that keeps them; None
            where all frames are done or the user stopped. Without a checkpoint the error is raised.

        Why a second thread: the statistics of a frame do not influence tracking, so they are computed while the next
        frame is tracked.
        """
        saved, error = self.done, None
        with ThreadPoolExecutor(1, thread_name_prefix="judge") as pool:
            try:
                for t in range(saved, total):
                    self.progress("track", t, total)
                    frame = next(frames)
                    with self._all_or_nothing():
                        self.step(frame, last, pool)
                    last = frame
                    # each checkpoint holds all frames, so it is written ever less often: the total work stays linear
                    if self.checkpoint is not None and t + 1 - saved >= max(self.every, saved // 20) and t + 1 < total:
                        self.save(self.checkpoint)
                        saved = t + 1
                self.progress("track", total, total)
            except KeyboardInterrupt:
                if not self.done:
                    raise
                self.stopped = True
            except HyposeError as problem:
                if self.checkpoint is not None and not self.done:
                    self.checkpoint.unlink(missing_ok=True)  # the same input fails again
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
        people, candidates, judging = list(self.people), self.candidates, list(self._judging)
        before = [p.snapshot() for p in people]
        try:
            yield
        except BaseException:
            self.people[:], self.candidates, self._judging = people, candidates, judging
            for p, values in zip(people, before, strict=True):
                vars(p).update(values)
            raise

    def step(self, frame: Frame, last: Frame | None = None, pool: ThreadPoolExecutor | None = None) -> None:
        """Track the next frame, of a recording or live.

        last: the frame before; None: there is none.
        pool: computes the statistics of the frame; None: they are not computed.
        """
        manager = self.manager
        points = () if manager is None else manager.keypoints(self.people, self.done)
        alone = manager is None or manager.alone
        members, estimates, seen = step_together([p.member for p in self.people], frame, points, alone=alone)
        self.settle()
        if pool is not None:
            self._judging = [pool.submit(copy_context().run, self._judged, frame, last, members, estimates, seen)]
        for p, member, estimate in zip(self.people, members, estimates, strict=True):
            p.take(estimate, member)
        if manager is not None:
            manager.manage(self, frame, seen)

    def _judged(
        self,
        frame: Frame,
        last: Frame | None,
        members: Sequence[Member],
        estimates: Sequence[FrameEstimate],
        seen: Sequence[Frame],
    ) -> list[FrameEstimate]:
        """Add the statistics of a frame to the estimates of all people, see `looked_at`."""
        change = mask_change(frame, last)  # of the complete masks, since the ignored part changes too
        return [
            looked_at(m.tracker, estimate, own, last, change)
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
        arrays: dict[str, Any] = {"candidates": np.array(self.candidates, dtype=np.float64).reshape(-1, 4)}
        about = []
        for k, p in enumerate(self.people):
            arrays |= {f"{k}_{n}": v for n, v in p.member.state.to_arrays().items()}
            arrays |= {f"{k}_subject_{n}": v for n, v in p.subject.to_arrays().items()}
            done = estimates_to_arrays(p.estimates) if p.estimates else {}
            arrays |= {f"{k}_done_{n}": v for n, v in done.items()}
            arrays |= {f"{k}_present": np.array(p.present), f"{k}_hidden": np.array(p.hidden)}
            arrays |= {f"{k}_{n}": v for n, v in p.appearance.arrays().items()}
            about.append({n: getattr(p, n) for n in ("name", "gone", "track", "said")})
            about[-1] |= {"there": p.member.present, "clothes": p.appearance.about}
        Checkpoint(self.done, arrays, {"people": about}, self.identity).save(path)

    def load(self, path: Path, tracker_of: Callable[[TrackedSubject], Tracker]) -> None:
        """Take the people over from the checkpoint of an interrupted run.

        tracker_of: makes the tracker of a person.
        Raises: InputError where the checkpoint is of another run.
        """
        saved, self.people = Checkpoint.load(path, self.identity), []
        for k, about in enumerate(saved.meta["people"]):
            own = {n.removeprefix(f"{k}_"): v for n, v in saved.arrays.items() if n.startswith(f"{k}_")}
            who, done, own = _split(own, "subject_", "done_")
            subject = TrackedSubject.from_arrays(who)
            member = Member(tracker_of(subject), TrackerState.from_arrays(own), bool(about["there"]))
            p = TrackedPerson(about["name"], subject, member, estimates=estimates_from_arrays(done) if done else [])
            p.present, p.hidden = own["present"].tolist(), own["hidden"].tolist()
            p.gone, p.track = int(about["gone"]), about["track"]
            p.appearance, p.said = AppearanceModel.of_arrays(own, about["clothes"]), list(about["said"])
            self.people.append(p)
        self.candidates = list(saved.arrays["candidates"])


def _split(arrays: Mapping[str, Array], *prefixes: str) -> list[dict[str, Array]]:
    """Sort arrays by the prefix of their names, which is removed; the last group has none of the prefixes."""
    groups = [{n.removeprefix(p): v for n, v in arrays.items() if n.startswith(p)} for p in prefixes]
    return [*groups, {n: v for n, v in arrays.items() if not n.startswith(prefixes)}]
