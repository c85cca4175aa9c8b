"""Find people live in the masks, in any pose.

The search takes a second or two in another thread, while new masks are kept. Then the kept frames are tracked faster
than they came, until the present is reached.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.body.skeleton import Skeleton
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.shared_masks import Other
from hypose.inference.hypotheses import BEFORE
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.person_paths import follow_places
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import tracker_of
from hypose.pipeline.track_management import birth_candidates, candidate_evidence
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.frame_evidence import mean_overlap, prepare
from hypose.tracking.several import Member, step_together
from hypose.tracking.start_search import starts_in_frame, weigh_starts
from hypose.tracking.tracker import Tracker, TrackerState

STATE_EMPTY, STATE_SEARCHING = "no_person", "looking"
"""Values of `LiveSearch.phase`."""


@dataclass(frozen=True)
class LivePersonOptions:
    """Options of tracking a person live.

    track: recipe and seed.
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

    body: body of the track.
    state: state of the tracker.
    time: of the state, s.
    step_s: time of the last step, s.
    """

    body: Body
    state: TrackerState
    time: float
    step_s: float


@dataclass(frozen=True)
class _Look:
    """One frame of a search, and the people who are tracked in it already."""

    frame: Frame
    others: Sequence[Other]


class LiveSearch:
    """Search for people in live masks. Call `look` with every frame that may show a person who is not tracked yet; it
    never waits.

    executor: runs the search.
    several: there may be more than one person, so each is searched in the mask that the others leave.
    """

    def __init__(self, options: LivePersonOptions, executor: Executor, several: bool) -> None:
        self.options, self.several = options, several
        self.phase = STATE_EMPTY
        self._executor = executor
        self._first: list[_Look] = []
        self._waiting: deque[_Look] = deque()
        self._lock = threading.Lock()
        self._search: Future[None] | None = None
        self._found: list[FoundPerson] = []
        self._failed, self._not_before = 0, -np.inf

    def take(self) -> list[FoundPerson]:
        """Return the people who were found since the last call."""
        with self._lock:
            found, self._found = self._found, []
            if found:
                self._search, self._first, self.phase = None, [], STATE_EMPTY
                self._failed, self._not_before = 0, -np.inf
        return found

    def look(self, frame: Frame, others: Sequence[Other], most: int, body: Body | None, height: float | None) -> None:
        """Keep a frame for the search, and start the search when there are enough.

        others: people who are tracked already.
        most: most people to search.
        body, height: of the new person, where known; height in m.
        """
        with self._lock:
            if not self._found:
                self._look(_Look(frame, others), most, body, height)

    def _look(self, look: _Look, most: int, body: Body | None, height: float | None) -> None:
        frame = look.frame
        if self._search is not None and self._search.done():
            failed = self._search.exception()
            if failed is not None and not isinstance(failed, EvidenceError):
                raise failed
            self._search, self._first = None, []
            self._waiting.clear()
            if look.others:  # search less often: the tracked people need the processor
                self._failed += 1
                self._not_before = frame.time + min(SETTINGS.search_again_s * 2**self._failed, SETTINGS.search_seldom_s)
        if frame.time < self._not_before:
            return
        kept = self._waiting if self._search is not None else self._first
        if kept and frame.time - kept[-1].frame.time < 0.9 / SETTINGS.search_slowly_hz:
            return
        if not _largest_person(look):
            if self._search is None:
                self.phase, self._first = STATE_EMPTY, []
            return
        if self._search is not None:
            if len(self._waiting) < SETTINGS.search_longest:
                self._waiting.append(look)
            return
        if self._first and frame.time - self._first[-1].frame.time > SETTINGS.search_gap_s:
            self._first = []
        self._first.append(look)
        self.phase = STATE_SEARCHING
        if len(self._first) == SETTINGS.search_decide:
            self._search = self._executor.submit(self._find, self._first, most, body or human(), height)

    def _find(self, looks: list[_Look], most: int, template: Body, height: float | None) -> None:
        """Find starts in the first frames and track them through the frames since then; runs in another thread."""
        options, zero = self.options, np.zeros(template.skeleton.dof)
        members = list[Member]()
        for frames in _each_alone(looks, most) if self.several else [[k.frame for k in looks]]:
            prepared = [prepare(f, template, zero) for f in frames]
            best = weigh_starts(starts_in_frame(template, prepared[0], height), prepared[1:]).best
            if mean_overlap(best.body, best.pose, prepared[0]) >= SETTINGS.search_plain:
                slow = options.tracker(best.body, SETTINGS.search_slowly_hz)
                members.append(Member(slow, slow.start(best.pose)))
        if not members:
            raise EvidenceError("No body explains the masks.")

        def step(members: Sequence[Member], look: _Look) -> list[Member]:
            return step_together(members, look.frame, others=look.others, alone=not self.several)[0]

        last, step_s, spent = looks[0].frame.time, 1 / SETTINGS.search_slowly_hz, 0.0
        for look in looks:
            members, last = step(members, look), look.frame.time
        while True:
            with self._lock:
                # skip frames where a step takes longer than the time between them, else the present is never reached
                while len(self._waiting) > 1 and self._waiting[1].frame.time - last < min(
                    1.5 * spent, SETTINGS.search_gap_s
                ):
                    self._waiting.popleft()
                if not self._waiting:
                    self._found = [FoundPerson(m.tracker.body, m.state, last, step_s) for m in members]
                    return
                look = self._waiting.popleft()
            begin, before_s, step_s = time.monotonic(), step_s, look.frame.time - last
            share = 0.0 if step_s > SETTINGS.search_gap_s else step_s / before_s
            members = [replace(m, state=paced(m.state, share, m.tracker.body.skeleton)) for m in members]
            members = step(members, look)
            last, spent = look.frame.time, time.monotonic() - begin


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


def _largest_person(look: _Look) -> bool:
    """Return whether enough views show something of the size of a person in addition to the known people."""
    for s in look.frame.of(Silhouettes):
        if look.others:
            return birth_candidates(look.others, s)
        large = s.areas > SETTINGS.search_least_area * s.rig.sizes.prod(1)
        return int((large & s.usable).sum()) >= look.frame.fewest_views
    return False


def _each_alone(looks: Sequence[_Look], most: int) -> list[list[Frame]]:
    """Make the evidence of each new person in the hull of the first frame; those who are not in most of the frames are
    left out.
    """
    paths = follow_places(
        lambda t: looks[t].frame, range(len(looks)), SETTINGS.search_slowly_hz, lambda t: looks[t].others
    )
    out = list[list[Frame]]()
    for path in [p for p in paths if 0 in p.found and len(p.found) > len(looks) // 2][:most]:
        at = [(looks[t], path.found[t], [p.found[t] for p in paths if t in p.found]) for t in path.found]
        out.append([candidate_evidence(one, look.frame, look.others, all_) for look, one, all_ in at])
    return out
