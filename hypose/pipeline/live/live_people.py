"""Track one or more people live: find each one, track it (`LiveTrack`) in what the others leave of the masks, give it
up and find it again.

`step` never waits. Left and right are compared in parallel with tracking. Bodies and camera offsets are estimated in a
process of its own from the masks; a fitted body is used where it explains the masks as well as the one before.
"""

from __future__ import annotations

import queue
from collections import deque
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.shared_masks import Other
from hypose.geometry import Array
from hypose.pipeline.frame_anomalies import looked_at, mask_change
from hypose.pipeline.live.background_work import BackgroundWork, PackedMasks
from hypose.pipeline.live.live_search import FoundPerson, LivePersonOptions, LiveSearch, paced
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_management import doubles
from hypose.tracking.covariance_calibration import beyond_usual, with_fitted_joints
from hypose.tracking.error_model import as_mixture, judged
from hypose.tracking.frame_evidence import mean_overlap, prepare
from hypose.tracking.refinement import SETTLING, refine
from hypose.tracking.several import BLIND, Member, shape_of, step_together
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState, motion_of


@dataclass(frozen=True)
class LivePose:
    """Pose of one person in one live frame.

    person: number, from 1.
    frame: number of the frame.
    time: s.
    motion: motion of this frame alone, with pose, covariance, error probability and low-confidence joints.
    body: body of the pose.
    joints: (J, 3) m, world; after a change of the body they move to the new place smoothly.
    views: (C,) True for the cameras that were used.
    """

    person: int
    frame: int
    time: float
    motion: Motion
    body: Body
    joints: Array
    views: NDArray[np.bool_]

    @property
    def lost(self) -> bool:
        """Whether the person was lost in this frame, so that the pose is only a guess."""
        return bool(self.motion.lost[0])


@dataclass(frozen=True)
class _Duel:
    """Comparison of the tracked body with the body whose sides are exchanged, which is tracked in parallel.

    frames: frames, and what the tracked body costs in them.
    won: state to continue from and its time; None where it lost.
    """

    frames: queue.SimpleQueue[tuple[Frame, float]]
    won: Future[tuple[TrackerState, float] | None]


@dataclass(frozen=True)
class _Now:
    """Last tracked frame of a person.

    whole: frame with all people in it.
    frame: evidence of this person only.
    tracker: by which it was tracked.
    """

    whole: Frame
    frame: Frame
    tracker: Tracker
    estimate: FrameEstimate


class LiveTrack:
    """Live track of one person. In each frame the tracker continues from `state_at`, and `take` receives the result.

    found: body and state that the search found.
    number: see `LivePose`.
    rig: cameras of the masks.
    rate: of the frames, Hz.
    executor: runs duels, see `_Duel`.
    work: fits body and offsets; None: neither is done.
    sync: the cameras' offsets are still to be found.
    shared: there may be other people in the masks.

    Attributes:
    body: the person's own body; None: not known yet.
    offsets: (C,) delays of the cameras, s; None: not known yet.
    given_up: the person has been lost for too long.
    """

    def __init__(
        self,
        found: FoundPerson,
        number: int,
        rig: CameraRig,
        rate: float,
        options: LivePersonOptions,
        executor: Executor,
        work: BackgroundWork | None,
        sync: bool = True,
        shared: bool = False,
    ) -> None:
        self.number, self.rig, self.rate, self.options = number, rig, rate, options
        self.body: Body | None = options.body
        self.offsets: Array | None = None
        self.tracker, self.state = options.tracker(found.body, rate), found.state
        self._executor, self._work, self._sync_wanted = executor, work, sync
        self._errors = LiveErrorModel()
        self._time, self._step_s, self._usual_s = found.time, found.step_s, 1 / rate
        self._lost_since: float | None = None
        self._duel: _Duel | None = None
        self._fit: Future[Body | None] | None = None
        self._sync: Future[Array | None] | None = None
        self._kept: list[PackedMasks] = []
        self._shared = shared
        self._challenge, self._between = (found.time if shared else np.inf), SETTINGS.live_challenge_s
        self._shift: Array | None = None
        self._now: _Now | None = None
        self._recent = deque[tuple[float, FrameEstimate]]()
        self.given_up = False

    @property
    def sure(self) -> bool:
        """Whether the person's place is known."""
        return not self.state.lost and self.state.blind <= BLIND

    def expected(self, time: float) -> Array:
        """Predict the pose (D,) at a time, s."""
        return self.tracker.predicted(self.state_at(time))

    def state_at(self, time: float) -> TrackerState:
        """Return the tracker's state with its velocities scaled for a frame at a time, s."""
        passed = time - self._time
        share = 0.0 if passed > SETTINGS.search_gap_s else passed / self._step_s
        return paced(self.state, share, self.tracker.body.skeleton)

    def take(self, whole: Frame, frame: Frame, state: TrackerState, estimate: FrameEstimate) -> None:
        """Receive the result of a frame.

        whole: frame with all people.
        frame: frame with the evidence of this person.
        state: of the tracker after it.
        """
        passed = frame.time - self._time
        self._now, self.state = _Now(whole, frame, self.tracker, estimate), state
        self._time, self._step_s = frame.time, max(passed, 1e-3)
        self._recent.append((frame.time, estimate))
        while len(self._recent) > 1 and self._recent[1][0] <= frame.time - SETTINGS.people_together_s:
            self._recent.popleft()
        if self._shift is not None:
            shift = self._shift * np.exp(-passed / SETTINGS.live_ease_s)
            self._shift = shift if np.abs(shift).max() > 1e-4 else None
        self._compare_sides(frame, estimate)
        if estimate.lost:
            self._lost_since = frame.time if self._lost_since is None else self._lost_since
            self.given_up = frame.time - self._lost_since > SETTINGS.live_give_up_s
        else:
            self._lost_since = None
            self._measure(frame)

    @property
    def recent(self) -> list[FrameEstimate]:
        """Estimates of the last SETTINGS.people_together_s seconds; empty where the person has not been tracked for so
        long.
        """
        long = self._recent and self._time - self._recent[0][0] >= SETTINGS.people_together_s
        return [e for _, e in self._recent] if long else []

    @property
    def estimate(self) -> FrameEstimate:
        """Estimate of the last frame; only after `take`."""
        assert self._now is not None
        return self._now.estimate

    def pose(self) -> LivePose:
        """Return the pose of the last frame with the newest error probabilities; only after `take`."""
        assert self._now is not None
        now, tracker = self._now.frame, self._now.tracker
        motion = self._errors.reported(tracker, self._now.estimate, now)
        joints = np.asarray(motion.joints[0], np.float64)
        if self._shift is not None:
            joints = joints + self._shift
        return LivePose(self.number, now.index, now.time, motion, tracker.body, joints, now.usable_views)

    def judge(self) -> None:
        """Update the error probabilities from the last frame; call it after `pose`, in the order of the frames."""
        if self._now is not None:
            self._errors.look(self._now.tracker, self._now.estimate, self._now.frame, self._now.whole)

    def prepare(self, frame: Frame) -> None:
        """Prepare the track for the next frame, which shows all people: take over results of parallel work, and adapt
        the tracker to the frame rate.
        """
        self._use_fitted_body()
        if self._duel is not None and self._duel.won.done():
            won, self._duel = self._duel.won.result(), None
            if won is not None:
                self.state, self._time = won
        self._keep_pace(min(frame.time - self._time, SETTINGS.search_gap_s))

    def _compare_sides(self, frame: Frame, estimate: FrameEstimate) -> None:
        """Start or continue a duel: where the body with exchanged sides explains a frame better, it is tracked in
        parallel for some frames.
        """
        if self._duel is not None:
            self._duel.frames.put((frame, estimate.cost))
        elif not estimate.lost and (estimate.exchanged > 0 or frame.time >= self._challenge):
            if frame.time >= self._challenge:
                self._between *= 2
                self._challenge = frame.time + self._between
            frames: queue.SimpleQueue[tuple[Frame, float]] = queue.SimpleQueue()
            body, pose = self.tracker.body, estimate.pose
            self._duel = _Duel(frames, self._executor.submit(self._sides_won, body, pose, frame, frames))

    def _sides_won(
        self, body: Body, pose: Array, first: Frame, frames: queue.SimpleQueue[tuple[Frame, float]]
    ) -> tuple[TrackerState, float] | None:
        """Track the body with exchanged sides in another thread, on the same frames at half their rate, until it wins
        or loses.

        Returns: state and time where it costs less than the tracked body, else None.
        """
        slow, give_up = (
            self.options.tracker(body, SETTINGS.search_slowly_hz),
            SETTINGS.live_shared if self._shared else SETTINGS.live_give_up,
        )
        state, last = slow.start(slow.rival(pose, first)), first.time
        won = best = 0.0
        for _ in range(SETTINGS.live_duel):
            try:
                frame, cost = frames.get(timeout=SETTINGS.search_gap_s)
                while frame.time - last < 0.9 / SETTINGS.search_slowly_hz:
                    frame, cost = frames.get(timeout=SETTINGS.search_gap_s)
            except queue.Empty:
                return None
            state, estimate = slow.step(state, frame)
            last = frame.time
            won += float(np.nan_to_num(cost - estimate.cost))
            best = max(best, won)
            if won < best - give_up:
                return None
            if won > SETTINGS.live_won:
                return state, last
        return None

    def _keep_pace(self, passed: float) -> None:
        """Replace the tracker by one for another frame rate where frames come at another rate than it expects."""
        self._usual_s += SETTINGS.live_pace * (passed - self._usual_s)
        rate = self.tracker.settings.frame_rate
        if not 1 / SETTINGS.live_other < self._usual_s * rate < SETTINGS.live_other:
            pace = float(np.clip(1 / self._usual_s, SETTINGS.search_slowly_hz, self.rate))
            self.tracker = self.options.tracker(self.tracker.body, pace)

    def _measure(self, frame: Frame) -> None:
        """Keep masks, and start the fits of body and camera offsets when there are enough."""
        if self._work is None:
            return
        if self._sync is not None and self._sync.done() and self.offsets is None:
            found = self._sync.result()
            self.offsets = np.zeros(len(self.rig)) if found is None else found
        wants_body, wants_sync = self.body is None and self._fit is None, self._sync_wanted and self._sync is None
        if not wants_body and not wants_sync:
            self._kept = []
            return
        self._kept.append(PackedMasks.of(frame))
        passed = frame.time - self._kept[0].time
        rate = (len(self._kept) - 1) / max(passed, 1e-3)
        if wants_body and passed > SETTINGS.live_fitted_s:
            step = max(1, round(rate / SETTINGS.search_slowly_hz))
            some = self._kept[-round(SETTINGS.live_fitted_s * rate) :: step]
            self._fit = self._work.body(some, self.rig, rate / step, self.options.height, self.options.track.seed)
        if passed > SETTINGS.live_sync_s:
            if wants_sync and not any(k.ignored is not None for k in self._kept):
                self._sync = self._work.offsets(self._kept, self.rig, rate)
            self._kept = []

    def measure_again(self) -> None:
        """Fit the body again after the cameras' times changed, since it was fitted to masks of different instants."""
        if self.options.body is None:
            self.body, self._fit, self._kept = None, None, []

    def _use_fitted_body(self) -> None:
        """Use the fitted body where it explains the last frame as well as the body before."""
        if self._fit is None or not self._fit.done() or self._now is None:
            return
        body, self._fit = self._fit.result(), None
        if body is None or self.state.lost:
            return  # it is fitted again from later frames
        frame, old = self._now.frame, self.tracker.body
        before = refine(old, self.state.pose[None], prepare(frame, old, self.state.pose), SETTLING)[0].pose
        moved = on_body(before, old, body)
        prepared = prepare(frame, body, moved)
        after = refine(body, moved[None], prepared, SETTLING)[0].pose
        if mean_overlap(body, after, prepared) < mean_overlap(old, before, prepare(frame, old, before)):
            return
        tracker = self.options.tracker(body, self.tracker.settings.frame_rate)
        state = replace(tracker.start(after, self.state.memory), frames=1, usual_iou=self.state.usual_iou)
        self._shift = old.joints(before) - body.joints(after)
        self.body, self.tracker, self.state, self._errors, self._duel = body, tracker, state, LiveErrorModel(), None


def on_body(pose: Array, before: Body, body: Body) -> Array:
    """Transfer a pose (D,) to another body with the same joints: angles stay, and the mean of the joints stays in
    place.
    """
    moved = pose.copy()
    moved[:3] += (before.joints(pose) - body.joints(pose)).mean(0)
    return moved


class LiveErrorModel:
    """Error model of one live body. For every frame in order call `reported`, then `look`: the first uses the newest
    error probabilities, the second computes the next ones.
    """

    def __init__(self) -> None:
        self._audited: deque[tuple[float, FrameEstimate]] = deque()
        self._before: Frame | None = None
        self._looked = -np.inf
        self._beyond = 0.0
        self._p: NDArray[np.float32] | None = None
        self._doubtful: NDArray[np.bool_] | None = None

    def reported(self, tracker: Tracker, estimate: FrameEstimate, frame: Frame) -> Motion:
        """Return the estimate as a motion of one frame with error probabilities.

        All joints are of low confidence for a lost person, and for one just found, of whom only the place is known.
        """
        now = motion_of(tracker.body, np.array([frame.time]), [estimate])
        count = now.joints.shape[:2]
        p, low_confidence = self._p, self._doubtful
        if p is None or low_confidence is None or estimate.lost:
            p = np.maximum(np.zeros(count, np.float32) if p is None else p, np.float32(0.5))
            low_confidence = np.ones(count, np.bool_)
        now = with_fitted_joints(now, frame.kind, self._beyond)
        now = replace(now, error_probability=p, low_confidence_joints=low_confidence)
        return as_mixture(now) if frame.depth is None else now  # regions from depth include other places

    def look(self, tracker: Tracker, estimate: FrameEstimate, frame: Frame, whole: Frame | None = None) -> None:
        """Compute features of the frame, if that is due, and error probabilities from those of the last seconds.

        whole: frame with all people in it.
        """
        known = self._audited
        look = self._p is None or frame.time - self._looked > 0.95 * SETTINGS.live_every_s
        if look or frame.time - known[-1][0] > 0.95 / SETTINGS.live_audit_hz:
            whole = whole or frame
            change = mask_change(whole, self._before)
            known.append((frame.time, looked_at(tracker, estimate, frame, self._before, change)))
            self._before = whole
            while known[0][0] < frame.time - SETTINGS.live_window_s:
                known.popleft()
        if look:
            self._looked = frame.time
            window = motion_of(tracker.body, np.array([t for t, _ in known]), [e for _, e in known])
            audits = np.stack([e.audit for _, e in known])
            p, joints = judged(window, window.joints, audits, known=frame.kind)
            self._beyond = beyond_usual(audits, frame.kind)
            self._p, self._doubtful = p[-1:], joints[-1:]


STATE_TRACKING, STATE_LOST = "following", "lost"
"""Values of `LivePeople.phase` in addition to those of a search."""


class LivePeople:
    """Live tracking of all people; call `step` with every frame. It never waits.

    rig: cameras of the masks.
    rate: of the frames, Hz.
    options: height and body are those of the first person.
    executor: runs searches and duels.
    work: fits bodies and offsets; None: neither is done.
    most: most people at once; with one, all of the masks are evidence for that person.
    offsets: (C,) delays of the cameras, s; None: not known yet.
    """

    def __init__(
        self,
        rig: CameraRig,
        rate: float,
        options: LivePersonOptions,
        executor: Executor,
        work: BackgroundWork | None,
        most: int = 1,
    ) -> None:
        self._rig, self._rate, self._options, self._executor, self._work = rig, rate, options, executor, work
        self.most = most
        self.people: list[LiveTrack] = []
        self.offsets: Array | None = None
        self._known: Body | None = options.body
        self._search = LiveSearch(options, executor, most > 1)

    @property
    def phase(self) -> str:
        """Phase: that of the tracked people, else of the search."""
        if not self.people:
            return self._search.phase
        return STATE_LOST if all(p.state.lost for p in self.people) else STATE_TRACKING

    @property
    def fitted(self) -> bool:
        """Whether all tracked people have a body of their own."""
        return bool(self.people) and all(p.body is not None for p in self.people)

    def measure_again(self) -> None:
        """Fit the bodies again, see `LiveTrack.measure_again`."""
        self._known = self._options.body
        for p in self.people:
            p.measure_again()

    def step(self, frame: Frame) -> list[LiveTrack]:
        """Track a frame; return the tracks of all people who are in it, in the order of their numbers."""
        for found in self._search.take():
            self._add(found)
        for p in self.people:
            p.prepare(frame)
        members = [Member(p.tracker, p.state_at(frame.time)) for p in self.people]
        members, estimates, seen = step_together(members, frame, alone=self.most == 1)
        for p, member, estimate, own in zip(self.people, members, estimates, seen, strict=True):
            p.take(frame, own, member.state, estimate)
            if self.offsets is None and p.offsets is not None:
                self.offsets = p.offsets
            if p.given_up and self.most == 1:
                self._known = p.body  # the next person counts as the same one
        self.people = [p for p in self.people if not p.given_up]
        worse = doubles([p.recent for p in self.people])
        self.people = [p for k, p in enumerate(self.people) if k not in worse]
        if len(self.people) < self.most:
            self._look(frame)
        return self.people

    def _add(self, found: FoundPerson) -> None:
        numbers = {p.number for p in self.people}
        number = next(n for n in range(1, self.most + 1) if n not in numbers)
        body = self._known if not self.people else None
        options = replace(self._options, body=body, height=None if self.people else self._options.height)
        wants = self.offsets is None
        made = LiveTrack(
            found, number, self._rig, self._rate, options, self._executor, self._work, wants, self.most > 1
        )
        self.people = sorted([*self.people, made], key=lambda p: p.number)

    def _look(self, frame: Frame) -> None:
        """Search another person in what the tracked people leave of the masks."""
        known = [p for p in self.people if p.sure]
        others = [Other(shape_of(p.tracker.body, p.estimate.pose, s.rig)) for s in frame.of(Silhouettes) for p in known]
        body, height = (None, None) if self.people else (self._known, self._options.height)
        if body is not None:
            height = body.stature
        self._search.look(frame, others, self.most - len(self.people), body, height)
