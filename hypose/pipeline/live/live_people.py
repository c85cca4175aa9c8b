"""People, live: found, each followed by a `LivePerson` in what the others leave of the masks, given up, found again."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.evidence.ahead import pack_once
from hypose.evidence.frame import Frame
from hypose.evidence.shared_masks import PREDICTED, SOLVED, Other, own_silhouettes
from hypose.geometry import Array
from hypose.pipeline.live.background_work import BackgroundWork
from hypose.pipeline.live.live_person import LivePerson, Stepped
from hypose.pipeline.live.live_search import Found, LivePersonOptions, LiveSearch
from hypose.tracking.several import shape_of

FOLLOWING, LOST = "following", "lost"
"""What `LivePeople.phase` can be beside what a search is doing."""
_TOGETHER_M, _TOGETHER_S = 0.2, 0.3
"""m, s: two bodies whose roots stay so near to each other for so long are one person"""


class LivePeople:
    """`step` with every frame; it never waits. rig: of the masks; rate: Hz of the frames; options: height and body are
    those of who comes while nobody is followed; beside: runs searches and duels; work: fits bodies and offsets, None:
    neither is done; most: so many are followed at once; with one, all of the masks are theirs. offsets (C,) s: of the
    cameras, None: not known yet."""

    def __init__(
        self,
        rig: CameraRig,
        rate: float,
        options: LivePersonOptions,
        beside: Executor,
        work: BackgroundWork | None,
        most: int = 1,
    ) -> None:
        self._rig, self._rate, self._options, self._beside, self._work = rig, rate, options, beside, work
        self.most = most
        self.people: list[LivePerson] = []
        self.offsets: Array | None = None
        self._known: Body | None = options.body
        self._search = LiveSearch(options, beside, most > 1)
        self._near: dict[tuple[int, int], deque[tuple[float, float, float]]] = {}

    @property
    def phase(self) -> str:
        """Of those who are followed, else of the search."""
        if not self.people:
            return self._search.phase
        return LOST if all(p.state.lost for p in self.people) else FOLLOWING

    @property
    def fitted(self) -> bool:
        """Has everybody who is followed a body of their own?"""
        return bool(self.people) and all(p.body is not None for p in self.people)

    def measure_again(self) -> None:
        """See `LivePerson.measure_again`."""
        self._known = self._options.body
        for p in self.people:
            p.measure_again()

    def step(self, frame: Frame) -> list[Stepped]:
        """Everybody who is followed, by their numbers."""
        for found in self._search.take():
            self._welcome(found)
        if self.most == 1 and self.people:
            one = self.people[0].step(frame)
            stepped = [] if one is None else [one]
        else:
            stepped = self._step_together(frame)
            stepped = self._one_of_two(frame.time, stepped)
        there = {s.person for s in stepped}
        for p in self.people:
            if self.offsets is None and p.offsets is not None:
                self.offsets = p.offsets
            if p.number not in there and self.most == 1:
                self._known = p.body  # who comes back is the same person
        self.people = [p for p in self.people if p.number in there]
        if len(self.people) < self.most:
            self._look(frame, stepped)
        return stepped

    def _welcome(self, found: Found) -> None:
        numbers = {p.number for p in self.people}
        number = next(n for n in range(1, self.most + 1) if n not in numbers)
        body = self._known if not self.people else None
        options = replace(self._options, body=body, height=None if self.people else self._options.height)
        wants = self.offsets is None
        made = LivePerson(found, number, self._rig, self._rate, options, self._beside, self._work, wants, self.most > 1)
        self.people = sorted([*self.people, made], key=lambda p: p.number)

    def _look(self, frame: Frame, stepped: list[Stepped]) -> None:
        """Somebody more, in what those who are followed leave."""
        s = frame.silhouettes
        known = {p.number for p in self.people if p.sure}
        others = (
            []
            if s is None
            else [Other(shape_of(o.tracker.body, o.estimate.pose, s.rig)) for o in stepped if o.person in known]
        )
        body, height = (None, None) if self.people else (self._known, self._options.height)
        if body is not None:
            height = body.stature
        self._search.look(frame, others, self.most - len(self.people), body, height)

    def _step_together(self, frame: Frame) -> list[Stepped]:
        """As `hypose.tracking.several.step_together`: one after the other, and who comes first alternates."""
        s, count = frame.silhouettes, len(self.people)
        assert s is not None
        shapes = {p.number: shape_of(p.tracker.body, p.expected(frame.time), s.rig) for p in self.people}
        widened = dict.fromkeys(shapes, PREDICTED)
        sure = {p.number for p in self.people if p.sure}
        out: dict[int, Stepped] = {}
        for p in (self.people[(frame.index + k) % count] for k in range(count)):
            others = [Other(shapes[n], widened[n]) for n in sure if n != p.number]
            own = own_silhouettes(s, shapes[p.number], others, anywhere=p.number not in sure)
            pack_once(own)
            stepped = p.step(replace(frame, silhouettes=own), frame)
            if stepped is None:
                sure.discard(p.number)
                continue
            shapes[p.number] = shape_of(p.tracker.body, stepped.estimate.pose, s.rig)
            widened[p.number] = SOLVED
            out[p.number] = stepped
        return [out[n] for n in sorted(out)]

    def _one_of_two(self, time: float, stepped: list[Stepped]) -> list[Stepped]:
        """Of two bodies in one place for long, the one that explains less is nobody."""
        cost = {s.person: float(np.nan_to_num(s.estimate.cost, nan=1.0)) for s in stepped}
        at: dict[int, Array] = {s.person: s.estimate.pose[:3] for s in stepped}
        self._near = {k: v for k, v in self._near.items() if at.keys() >= set(k)}
        for a, b in ((a, b) for a in at for b in at if a < b):
            near = self._near.setdefault((a, b), deque())
            if np.linalg.norm(at[a] - at[b]) >= _TOGETHER_M:
                near.clear()
                continue
            near.append((time, cost[a], cost[b]))
            if time - near[0][0] >= _TOGETHER_S:
                worse = a if sum(n[1] for n in near) > sum(n[2] for n in near) else b
                return [s for s in stepped if s.person != worse]
        return stepped
