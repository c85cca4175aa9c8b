"""Track one or more people live: find each one in any pose (`LiveSearch`), track it (`LiveTrack`) in what the others
leave of the masks, give it up and find it again (`LivePeople`).

`LivePeople.step` never waits. A search takes a second or two in another thread, while new masks are kept; then the kept
frames are tracked faster than they came, until the present is reached. Left and right are compared in parallel with
tracking. Bodies and camera offsets are estimated in a process of its own from the masks; a fitted body is used where it
explains the masks as well as the one before.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.people import Other
from hypose.geometry import Array
from hypose.inference.hypotheses import BEFORE
from hypose.pipeline.frame_anomalies import looked_at, mask_change
from hypose.pipeline.live.background_work import BackgroundWork, KeptFrame
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_loop import Member, TrackedPerson, TrackingSession, step_together, tracker_of
from hypose.pipeline.track_management import (
    birth_candidates,
    candidate_evidence,
    explained_by,
    follow_places,
    part_doubles,
)
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.covariance_calibration import beyond_usual, with_fitted_joints
from hypose.tracking.error_model import as_mixture, judged
from hypose.tracking.frame_evidence import mean_overlap, prepare
from hypose.tracking.refinement import SETTLING, refine
from hypose.tracking.start_search import starts_in_frame, weigh_starts
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState, motion_of

STATE_EMPTY, STATE_SEARCHING, STATE_TRACKING, STATE_LOST = "no_person", "looking", "following", "lost"
"""Values of `LivePeople.phase`; `LiveSearch.phase` has the first two."""


@dataclass(frozen=True)
class LivePersonOptions:
    """Options of tracking a person live.

    track: options of tracking, of which recipe and seed are used.
    height: m, where known.
    body: the person's own body, where known; then none is fitted.
    """

    track: TrackOptions = TrackOptions()
    height: float | None = None
    body: Body | None = None

    def tracker(self, body: Body, rate: float) -> Tracker:
        """Build the tracker of a body for frames of a rate, Hz."""
        return tracker_of(TrackedSubject(body, None, np.zeros(body.skeleton.dof), ()), self.track, rate)


@dataclass(frozen=True)
class FoundPerson:
    """Person who was found and tracked to the present.

    member: tracker and its state.
    time: time of the state, s.
    step_s: time of the last step, s.
    """

    member: Member
    time: float
    step_s: float


_Look = tuple[Frame, Sequence[Other]]
"""One frame of a search, and the people who are tracked in it already."""


class LiveSearch:
    """Search for people in live masks. Call `take` and then `look` with every frame that may show a person who is not
    tracked yet; they never wait.

    executor: runs the search.
    several: there may be more than one person, so each is searched in the mask that the others leave.
    """

    def __init__(self, options: LivePersonOptions, executor: Executor, several: bool) -> None:
        self.options, self.several = options, several
        self.phase = STATE_EMPTY
        self._executor = executor
        self._kept: deque[_Look] = deque()  # while a search runs, it takes the frames from here
        self._search: Future[list[FoundPerson]] | None = None
        self._last, self._crowded, self._failed, self._not_before = -np.inf, False, 0, -np.inf

    def take(self) -> list[FoundPerson]:
        """Return the people who were found since the last call."""
        if self._search is None or not self._search.done():
            return []
        search, self._search = self._search, None
        self._kept.clear()
        try:
            found = search.result()
        except EvidenceError:
            if self._crowded:  # search less often: the tracked people need the processor
                self._failed += 1
                self._not_before = self._last + min(SETTINGS.search_again_s * 2**self._failed, SETTINGS.search_seldom_s)
            return []
        self.phase, self._failed = STATE_EMPTY, 0
        return found

    def look(self, frame: Frame, others: Sequence[Other], most: int, body: Body | None, height: float | None) -> None:
        """Keep a frame for the search, and start the search when there are enough.

        others: people who are tracked already.
        most: most people to search.
        body, height: body and height of the new person, where known; height in m.
        """
        passed = frame.time - self._last
        if frame.time < self._not_before or passed < 0.9 / SETTINGS.search_slowly_hz:
            return
        shown, searching = _largest_person(frame, others), self._search is not None
        if not searching and (not shown or passed > SETTINGS.search_gap_s):
            self._kept.clear()
            self.phase = STATE_EMPTY
        if not shown or len(self._kept) >= SETTINGS.search_longest:
            return
        self._kept.append((frame, others))
        self._last, self._crowded, self.phase = frame.time, bool(others), STATE_SEARCHING
        if not searching and len(self._kept) == SETTINGS.search_decide:
            first = [self._kept.popleft() for _ in range(SETTINGS.search_decide)]
            self._search = self._executor.submit(self._find, first, most, body or human(), height)

    def _find(self, looks: list[_Look], most: int, template: Body, height: float | None) -> list[FoundPerson]:
        """Find starts in the first frames and track them through the frames since then; runs in another thread.

        Raises: EvidenceError where no body explains the masks.
        """
        options, zero = self.options, np.zeros(template.skeleton.dof)
        members = list[Member]()
        for frames in _each_alone(looks, most) if self.several else [[frame for frame, _ in looks]]:
            prepared = [prepare(f, template, zero) for f in frames]
            best = weigh_starts(starts_in_frame(template, prepared[0], height), prepared[1:]).best
            if mean_overlap(best.body, best.pose, prepared[0]) >= SETTINGS.search_plain:
                slow = options.tracker(best.body, SETTINGS.search_slowly_hz)
                members.append(Member(slow, slow.start(best.pose)))
        if not members:
            raise EvidenceError("No body explains the masks.")
        alone, step_s, spent = not self.several, 1 / SETTINGS.search_slowly_hz, 0.0
        for frame, others in looks:
            members = step_together(members, frame, others=others, alone=alone)[0]
        last = looks[-1][0].time
        while self._kept:
            # skip frames where a step takes longer than the time between them, else the present is never reached
            within = min(1.5 * spent, SETTINGS.search_gap_s)
            while len(self._kept) > 1 and self._kept[1][0].time - last < within:
                self._kept.popleft()
            frame, others = self._kept.popleft()
            begin, before_s, step_s = time.monotonic(), step_s, frame.time - last
            share = 0.0 if step_s > SETTINGS.search_gap_s else step_s / before_s
            members = [replace(m, state=paced(m.state, share, m.tracker.body.skeleton)) for m in members]
            members = step_together(members, frame, others=others, alone=alone)[0]
            last, spent = frame.time, time.monotonic() - begin
        return [FoundPerson(m, last, step_s) for m in members]


def paced(state: TrackerState, share: float, skeleton: Skeleton) -> TrackerState:
    """Scale the velocities of a state for a frame that comes after `share` times the time of the step before. Why:
    velocities are per frame.
    """
    if abs(share - 1) < 0.02:
        return state
    share, h = min(share, 4.0), state.hypotheses
    if BEFORE in h.columns:
        step = h.values - skeleton.on_branch(h.columns[BEFORE], h.values)
        h = replace(h, columns={**h.columns, BEFORE: h.values - share * step})
    step = state.pose - skeleton.on_branch(state.previous, state.pose)
    return replace(state, previous=state.pose - share * step, hypotheses=h)


def _largest_person(frame: Frame, others: Sequence[Other]) -> bool:
    """Return whether enough views show something of the size of a person in addition to the known people."""
    for s in frame.of(Silhouettes):
        if others:
            return birth_candidates(others, s)
        large = s.areas > SETTINGS.search_least_area * s.rig.sizes.prod(1)
        return int((large & s.usable).sum()) >= frame.fewest_views
    return False


def _each_alone(looks: Sequence[_Look], most: int) -> list[list[Frame]]:
    """Make the evidence of each new person in the hull of the first frame; those who are not in most of the frames are
    left out.
    """
    paths = follow_places(lambda t: looks[t][0], range(len(looks)), SETTINGS.search_slowly_hz, lambda t: looks[t][1])
    out = list[list[Frame]]()
    for path in [p for p in paths if 0 in p.found and len(p.found) > len(looks) // 2][:most]:
        at = [(*looks[t], path.found[t], [p.found[t] for p in paths if t in p.found]) for t in path.found]
        out.append([candidate_evidence(one, frame, others, all_) for frame, others, one, all_ in at])
    return out


# ---- tracking ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LivePose:
    """Pose of one person in one live frame.

    person: number, from 1.
    frame: number of the frame.
    time: s.
    motion: motion of this frame alone, with pose, covariance, error probability and low-confidence joints.
    body: body of the pose.
    joints: (J, 3) m, world; after a change of the body they move to the new place smoothly.
    views: (C,) True for the cameras whose evidence was used.
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


def _together(rate: float) -> int:
    """Return the number of frames after which two people in one place are taken for one; rate: Hz."""
    return max(2, round(SETTINGS.people_together_s * rate))


class LiveTrack(TrackedPerson):
    """Live track of one person, for the session of `LivePeople`. For each frame call `prepare`, let the session track
    it, and call `look`; then `pose` gives the pose, and `judge` updates its error probabilities.

    found: body and state that the search found.
    number: number of the person, from 1.
    rig: cameras of the masks.
    rate: rate of the frames, Hz.
    executor: runs duels, in which the tracked pose is compared with the body whose sides are exchanged.
    work: fits body and offsets; None: neither is done.
    sync: the cameras' offsets are still to be found.
    shared: there may be other people in the masks.

    Attributes:
    body: the person's own body; None: not known yet.
    offsets: (C,) delays of the cameras, s; None: not known yet.
    given_up: the person has been lost for too long.
    estimates: of the last frames, which show whether two people stay in one place.
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
        body, state = found.member.tracker.body, found.member.state
        subject = TrackedSubject(body, None, state.pose, ())
        super().__init__(str(number), subject, Member(options.tracker(body, rate), state))
        self.number, self.rig, self.rate, self.options = number, rig, rate, options
        self.body: Body | None = options.body
        self.offsets: Array | None = None
        self._executor, self._work, self._sync_wanted = executor, work, sync
        self._errors = LiveErrorModel()
        self._time, self._step_s, self._usual_s = found.time, found.step_s, 1 / rate
        self._lost_since: float | None = None
        self._duel: _Duel | None = None
        self._fit: Future[Body | None] | None = None
        self._sync: Future[Array | None] | None = None
        self._kept: list[KeptFrame] = []
        self._shared = shared
        self._challenge, self._between = (found.time if shared else np.inf), SETTINGS.live_challenge_s
        self._shift: Array | None = None
        self._whole: Frame | None = None
        self._frame: Frame | None = None
        self.given_up = False

    def prepare(self, frame: Frame) -> None:
        """Prepare the track for the next frame, which shows all people: take over results of parallel work, and adapt
        tracker and velocities to the time since the last frame.
        """
        self._use_fitted_body()
        if self._duel is not None and self._duel.won.done():
            won, self._duel = self._duel.won.result(), None
            if won is not None:
                state, self._time = won
                self.member = replace(self.member, state=state)
        passed = frame.time - self._time
        self._keep_pace(min(passed, SETTINGS.search_gap_s))
        share = 0.0 if passed > SETTINGS.search_gap_s else passed / self._step_s
        self.member = replace(self.member, state=paced(self.member.state, share, self.member.tracker.body.skeleton))

    def take(self, estimate: FrameEstimate, member: Member) -> None:
        """Add a tracked frame."""
        self.member = member
        self.estimates.append(estimate)

    def look(self, whole: Frame, frame: Frame) -> None:
        """Begin or continue parallel work after a frame was tracked: comparing sides, fitting body and camera offsets.

        whole: frame with all people.
        frame: frame with the evidence of this person.
        """
        passed, estimate = frame.time - self._time, self.estimates[-1]
        self._whole, self._frame = whole, frame
        self._time, self._step_s = frame.time, max(passed, 1e-3)
        del self.estimates[: -_together(self.rate)]
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

    def pose(self) -> LivePose:
        """Return the pose of the last frame with the newest error probabilities; only after `look`."""
        frame, tracker = self._frame, self.member.tracker
        assert frame is not None
        motion = self._errors.reported(tracker, self.estimates[-1], frame)
        joints = np.asarray(motion.joints[0], np.float64)
        if self._shift is not None:
            joints = joints + self._shift
        return LivePose(
            self.number, frame.index, frame.time, motion, tracker.body, joints, frame.the(Silhouettes).usable
        )

    def judge(self) -> None:
        """Update the error probabilities from the last frame; call it after `pose`, in the order of the frames."""
        if self._frame is not None:
            self._errors.look(self.member.tracker, self.estimates[-1], self._frame, self._whole)

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
            body, pose = self.member.tracker.body, estimate.pose
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
        rate = self.member.tracker.settings.frame_rate
        if not 1 / SETTINGS.live_other < self._usual_s * rate < SETTINGS.live_other:
            pace = float(np.clip(1 / self._usual_s, SETTINGS.search_slowly_hz, self.rate))
            self.member = replace(self.member, tracker=self.options.tracker(self.member.tracker.body, pace))

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
        self._kept.append(KeptFrame.of(frame))
        passed = frame.time - self._kept[0].time
        rate = (len(self._kept) - 1) / max(passed, 1e-3)
        if wants_body and passed > SETTINGS.live_fitted_s:
            step = max(1, round(rate / SETTINGS.search_slowly_hz))
            some = self._kept[-round(SETTINGS.live_fitted_s * rate) :: step]
            self._fit = self._work.body(some, rate / step, self.options.height, self.options.track.seed)
        if passed > SETTINGS.live_sync_s:
            if wants_sync and not any(k.shared for k in self._kept):
                self._sync = self._work.offsets(self._kept, rate)
            self._kept = []

    def measure_again(self) -> None:
        """Fit the body again after the cameras' times changed, since it was fitted to masks of different instants."""
        if self.options.body is None:
            self.body, self._fit, self._kept = None, None, []

    def _use_fitted_body(self) -> None:
        """Use the fitted body where it explains the last frame as well as the body before."""
        frame, old, pose = self._frame, self.member.tracker.body, self.member.state.pose
        if self._fit is None or not self._fit.done() or frame is None:
            return
        body, self._fit = self._fit.result(), None
        if body is None or self.member.state.lost:
            return  # it is fitted again from later frames
        before = refine(old, pose[None], prepare(frame, old, pose), SETTLING)[0].pose
        moved = before.copy()  # the angles stay, and the mean of the joints stays in place
        moved[:3] += (old.joints(before) - body.joints(before)).mean(0)
        prepared = prepare(frame, body, moved)
        after = refine(body, moved[None], prepared, SETTLING)[0].pose
        if mean_overlap(body, after, prepared) < mean_overlap(old, before, prepare(frame, old, before)):
            return
        tracker = self.options.tracker(body, self.member.tracker.settings.frame_rate)
        state = replace(tracker.start(after, self.member.state.memory), frames=1, usual_iou=self.member.state.usual_iou)
        self._shift = old.joints(before) - body.joints(after)
        self.body, self.member, self._errors, self._duel = body, Member(tracker, state), LiveErrorModel(), None


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
        self._low_confidence: NDArray[np.bool_] | None = None

    def reported(self, tracker: Tracker, estimate: FrameEstimate, frame: Frame) -> Motion:
        """Return the estimate as a motion of one frame with error probabilities.

        All joints are of low confidence for a lost person, and for one just found, of whom only the place is known.
        """
        now = motion_of(tracker.body, np.array([frame.time]), [estimate])
        count = now.joints.shape[:2]
        p, low_confidence = self._p, self._low_confidence
        if p is None or low_confidence is None or estimate.lost:
            p = np.maximum(np.zeros(count, np.float32) if p is None else p, np.float32(0.5))
            low_confidence = np.ones(count, np.bool_)
        now = with_fitted_joints(now, frame.kind, self._beyond)
        now = replace(now, error_probability=p, low_confidence_joints=low_confidence)
        return now if frame.kind == "depth" else as_mixture(now)  # regions from depth include other places

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
            self._p, self._low_confidence = p[-1:], joints[-1:]


class LivePeople:
    """Live tracking of all people; call `step` with every frame. It never waits.

    rig: cameras of the masks.
    rate: rate of the frames, Hz.
    options: options of tracking; height and body in it are those of the first person.
    executor: runs searches for people, and duels, in which a pose is compared with the body whose sides are
        exchanged.
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
        self._session = TrackingSession([], rate, self)
        self.offsets: Array | None = None
        self._known: Body | None = options.body
        self._search = LiveSearch(options, executor, most > 1)

    @property
    def people(self) -> list[LiveTrack]:
        """Tracks of the people, in the order of their numbers."""
        return [p for p in self._session.people if isinstance(p, LiveTrack)]

    @property
    def alone(self) -> bool:
        """Whether all of the masks are evidence for one person."""
        return self.most == 1

    @property
    def phase(self) -> str:
        """Phase of the run, a word: the phase of the tracked people, or the phase of the search where no person is
        tracked.
        """
        if not self.people:
            return self._search.phase
        return STATE_LOST if all(p.member.state.lost for p in self.people) else STATE_TRACKING

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
        self._session.step(frame)
        return self.people

    def keypoints(self, people: Sequence[TrackedPerson], t: int, /) -> Sequence[Keypoints | None]:
        """Return no key points: live people are tracked by masks or depth."""
        return ()

    def manage(self, session: TrackingSession, frame: Frame, seen: Sequence[Frame], /) -> None:
        """Look after the people when a frame has been tracked: give up who was lost or found twice, and search others.

        seen: the frame as each person's tracker saw it.
        """
        people = self.people
        for p, own in zip(people, seen, strict=True):
            p.look(frame, own)
            if self.offsets is None and p.offsets is not None:
                self.offsets = p.offsets
            if p.given_up and self.alone:
                self._known = p.body  # the next person counts as the same one
        people = [p for p in people if not p.given_up]
        part_doubles(people, _together(self._rate))
        session.people = [p for p in people if p.member.present]
        if len(session.people) < self.most:
            self._look(frame)

    def _add(self, found: FoundPerson) -> None:
        numbers = {p.number for p in self.people}
        number = next(n for n in range(1, self.most + 1) if n not in numbers)
        body = self._known if not self.people else None
        options = replace(self._options, body=body, height=None if self.people else self._options.height)
        wants = self.offsets is None
        made = LiveTrack(
            found, number, self._rig, self._rate, options, self._executor, self._work, wants, not self.alone
        )
        by_number = sorted((*self.people, made), key=lambda p: p.number)
        self._session.people = [*by_number]

    def _look(self, frame: Frame) -> None:
        """Search another person in what the tracked people leave of the masks."""
        others = [other for s in frame.of(Silhouettes) for other in explained_by(self.people, s)]
        body, height = (None, None) if self.people else (self._known, self._options.height)
        if body is not None:
            height = body.stature
        self._search.look(frame, others, self.most - len(self.people), body, height)
