"""Match the skeletons of all sensors to persons, register the sensors by the persons that they share, and fuse live.

Persons are matched by the distance of their trunks in the common frame. The common frame is that of the first sensor
that saw a person, and stays so when that sensor dies. A sensor that comes back is registered again, since it may have
been moved; it keeps its transform where that puts its persons on those of the other sensors, or where no other sensor
sees a person.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from hypose.evidence.frame import SensorReport
from hypose.fusion.align import Aligner, AlignSettings, Instant, SensorBody
from hypose.fusion.fit import FitState, fit_step, start_fit
from hypose.fusion.joints import MIRROR, TRUNK_JOINTS
from hypose.fusion.register import register, robust_motion
from hypose.geometry import Array, transform


@dataclass(frozen=True)
class PeopleSettings:
    """Settings of the matching of persons; distances in m, durations in s.

    gate: largest distance of a skeleton from the trunk of a person to be matched.
    faithful: by how much another person must be nearer than the one to whom the sensor's person belonged before.
    birth: number of instants after which a new person is reported.
    linger: time for which an unseen person is still reported.
    forget: time for which an unseen person is remembered.
    blind: further time for which persons are remembered while no sensor reports at all, so that a pause of the whole
        machine creates no new person.
    window: length of the time window of skeletons from which a sensor is registered.
    note: time between two skeletons that are kept in this window.
    refit: time between two registrations of a sensor.
    attempt: time between two attempts to register an unregistered sensor.
    shots: least number of shared instants for a registration.
    residual: largest median distance of a registration.
    distinct: largest ratio of the score of the best pairing of persons to that of the next best.
    strays: number of instants without a match after which a sensor counts as moved.
    most: largest number of persons.
    """

    gate: float = 0.6
    faithful: float = 0.2
    birth: int = 3
    linger: float = 0.3
    forget: float = 1.0
    blind: float = 10.0
    window: float = 5.0
    note: float = 0.1
    refit: float = 1.0
    attempt: float = 0.2
    shots: int = 5
    residual: float = 0.15
    distinct: float = 0.7
    strays: int = 20
    most: int = 16


@dataclass(frozen=True)
class SeenPerson:
    """One person at one instant.

    id: number of the person, never used twice.
    bodies: the person's skeleton in each sensor's frame, by sensor name.
    placed: positions (15, 3) m of the same skeletons in the common frame, by sensor name.
    """

    id: int
    bodies: Mapping[str, SensorBody]
    placed: Mapping[str, Array]


@dataclass
class _Person:
    id: int
    centre: Array
    velocity: Array
    time: float
    joints: Array  # (15, 3) in the common frame, NaN where never seen
    members: dict[str, SensorBody]
    placed: dict[str, Array]
    last: dict[str, int]  # sensor -> its number of this person
    frames: int = 0
    apart: dict[int, int] = field(default_factory=dict)
    blind: float = 0.0  # s since `time` in which no sensor reported


class _Link:
    """Transform of one sensor to the common frame, and the data from which it is estimated."""

    def __init__(self) -> None:
        self.motion: Array | None = None
        self.before: Array | None = None  # where it stood before it died
        self.trusted = False  # may found persons
        self.anchor = False  # stays where it is
        self.known = False  # the caller gave its position
        self.life = 0
        self.residual = np.nan
        self.strays = 0
        self.shots: deque[tuple[float, dict[int, Array], dict[int, Array]]] = deque(maxlen=40)
        self.pairs: deque[tuple[float, Array, Array]] = deque(maxlen=100)
        self.tried = self.fitted = self.noted = -np.inf

    def lose(self) -> None:
        """Discard the transform: the sensor may have been moved."""
        self.before = self.motion if self.motion is not None else self.before
        self.motion, self.trusted, self.anchor, self.strays = None, False, False, 0
        self.shots.clear()
        self.pairs.clear()


class PeopleTracker:
    """Tracker of persons over several sensors; call `update` for every instant in order.

    settings: settings of the matching.
    transforms: common_from_sensor (4, 4) by sensor name, of sensors whose position is known; these are not estimated.
    """

    def __init__(self, settings: PeopleSettings | None = None, transforms: Mapping[str, Array] | None = None) -> None:
        self.settings = settings or PeopleSettings()
        self._links: dict[str, _Link] = {}
        for name, motion in (transforms or {}).items():
            link = self._links[name] = _Link()
            link.motion, link.trusted, link.anchor, link.known = np.array(motion), True, True, True
        self._people: list[_Person] = []
        self._last_id = 0
        self._tried = self._before = -np.inf

    @property
    def transforms(self) -> dict[str, Array]:
        """common_from_sensor (4, 4) of every registered sensor, by name."""
        return {n: link.motion for n, link in self._links.items() if link.motion is not None}

    @property
    def residuals(self) -> dict[str, float]:
        """Median distance (m) of each registered sensor's joints to those of the other sensors, by name; NaN where
        unknown.
        """
        return {n: float(link.residual) for n, link in self._links.items() if link.motion is not None}

    def update(self, instant: Instant) -> list[SeenPerson]:
        """Match the skeletons of one instant, and return the persons, oldest first."""
        s, now = self.settings, instant.time
        views = {v.name: v for v in instant.sensors}
        for name in [n for n, link in self._links.items() if n not in views and not link.known]:
            del self._links[name]
        for v in instant.sensors:
            link = self._links.setdefault(v.name, _Link())
            if v.life != link.life:
                link.life = v.life
                if not link.known:
                    link.lose()
        if all(link.motion is None and link.before is None for link in self._links.values()):
            first = next((v.name for v in instant.sensors if v.bodies), None)
            if first is not None:
                link = self._links[first]
                link.motion, link.trusted, link.anchor = np.eye(4), True, True
        placed = [v.name for v in instant.sensors if v.alive and self._links[v.name].motion is not None]
        if placed and not any(self._links[n].anchor for n in placed):
            self._links[placed[0]].anchor = True  # one stays fixed, else all drift together
        step, self._before = now - self._before, now
        blind = not placed or step > s.linger
        for p in self._people:
            p.members, p.placed = {}, {}
            p.blind = min(p.blind + step, s.blind) if blind else p.blind
        for name in sorted(views, key=lambda n: not (self._links[n].anchor and self._links[n].trusted)):
            if views[name].bodies and self._links[name].motion is not None:
                self._match(name, views[name].bodies, now)
        if not any(p.members for p in self._people):
            self._take_back_alone(instant)
        for p in self._people:
            if p.members:
                self._renew(p, now)
        self._people = [
            p for p in self._people if now - p.time - p.blind <= (s.forget if p.frames >= s.birth else s.linger)
        ]
        self._merge()
        for v in instant.sensors:
            if v.bodies:
                self._place(v.name, v.bodies, now)
        return [
            SeenPerson(p.id, p.members, p.placed)
            for p in self._people
            if p.frames >= s.birth and now - p.time <= s.linger
        ]

    # ---- matching ----

    def _match(self, name: str, bodies: Sequence[SensorBody], now: float) -> None:
        """Assign the skeletons of one registered sensor to persons; those without a person become new ones.

        name: name of the sensor.
        bodies: its skeletons.
        now: s of the host's clock.
        """
        s, link = self.settings, self._links[name]
        assert link.motion is not None
        placed = [transform(link.motion, b.positions) for b in bodies]
        centres = [trunk_centre(j) for j in placed]
        free = [i for i, c in enumerate(centres) if c is not None]
        matched = 0
        if self._people and free:
            at = np.stack([p.centre + p.velocity * min(now - p.time, 0.2) for p in self._people])
            distance = np.linalg.norm(at[:, None] - np.array([centres[i] for i in free])[None], axis=-1)
            own = np.array([[p.last.get(name) == bodies[i].person for i in free] for p in self._people])
            cost = np.where(distance <= s.gate, distance - s.faithful * own, 1e3)
            rows, columns = linear_sum_assignment(cost)
            for r, c in zip(rows.tolist(), columns.tolist(), strict=True):
                if cost[r, c] < 1e2:
                    self._people[r].members[name] = bodies[free[c]]
                    self._people[r].placed[name] = placed[free[c]]
                    matched += 1
                    free[c] = -1
        left = [i for i in free if i >= 0]
        # others see persons, but none where this sensor puts them: it was moved
        others = any(m != name for p in self._people for m in p.members) or any(
            now - p.time < s.linger and p.last.keys() - {name} for p in self._people
        )
        link.strays = 0 if matched or not left or not others else link.strays + 1
        if matched:
            link.trusted = True
        if link.strays > s.strays:
            link.lose()
            return
        if not link.trusted:
            return
        for i in left:
            centre = centres[i]
            if centre is not None and len(self._people) < s.most:
                self._last_id += 1
                here, there = {name: bodies[i]}, {name: placed[i]}
                self._people.append(_Person(self._last_id, centre, np.zeros(3), now, placed[i], here, there, {}))

    def _take_back_alone(self, instant: Instant) -> None:
        """Restore the last transform of a sensor that came back, where no registered sensor is alive."""
        if any(w.alive and self._links[w.name].motion is not None for w in instant.sensors):
            return
        for v in instant.sensors:
            link = self._links[v.name]
            if v.bodies and link.motion is None and link.before is not None:
                link.motion, link.trusted, link.anchor = link.before, True, True
                self._match(v.name, v.bodies, instant.time)
                return

    def _renew(self, p: _Person, now: float) -> None:
        """Update place, velocity and joints of a person from its skeletons of this instant; now: s of the host's
        clock.
        """
        names = list(p.members)
        swapped = [is_swapped(p.placed[n], p.joints) for n in names]
        stacked = np.array([p.placed[n][MIRROR] if s else p.placed[n] for n, s in zip(names, swapped, strict=True)])
        w = np.array([p.members[n].state for n in names], dtype=np.float64)
        w[swapped] = w[swapped][:, MIRROR]
        stacked = np.where(w[..., None] > 0, stacked, 0.0)
        total = w.sum(0)
        summed = (stacked * w[..., None]).sum(0)
        mean = np.where(total[:, None] > 0, summed / np.maximum(total, 1)[:, None], np.nan)
        for n, name in enumerate(names):
            p.last[name] = p.members[name].person
            link = self._links[name]
            if len(names) > 1 and not link.anchor and now - link.noted >= self.settings.note:
                # a pair of skeletons (this sensor's, the mean of all others) for the next registration of the sensor
                weight = (total - w[n])[:, None]
                if (weight[_TRUNK] > 0).sum() >= 4:
                    others = (summed - stacked[n] * w[n][:, None]) / np.maximum(weight, 1)
                    own = p.members[name].positions
                    link.noted = now
                    link.pairs.append((now, own[MIRROR] if swapped[n] else own, np.where(weight > 0, others, np.nan)))
        p.joints = np.where(total[:, None] > 0, mean, p.joints)
        centre = trunk_centre(mean)
        if centre is not None:
            step = now - p.time
            if 0 < step < 0.5 and p.frames:
                p.velocity = p.velocity + min(1.0, step / 0.15) * ((centre - p.centre) / step - p.velocity)
                p.velocity *= min(1.0, 8.0 / max(float(np.linalg.norm(p.velocity)), 1e-9))
            p.centre = centre
        p.time, p.blind = now, 0.0
        p.frames += 1

    def _merge(self) -> None:
        """Merge two persons of different sensors that have been in the same place for half a second (15 instants)."""
        for i, a in enumerate(self._people):
            for b in self._people[i + 1 :]:
                near = float(np.abs(a.centre - b.centre).max()) < 0.25 and not (a.members.keys() & b.members.keys())
                if not near or not b.members or not a.members:
                    a.apart.pop(b.id, None)
                    continue
                a.apart[b.id] = a.apart.get(b.id, 0) + 1
                if a.apart[b.id] >= 15:
                    a.members |= b.members
                    a.last |= b.last
                    self._people.remove(b)
                    return

    # ---- registration ----

    def _place(self, name: str, bodies: Sequence[SensorBody], now: float) -> None:
        """Register a sensor, or refit its registration, where that is due.

        A sensor without a transform is tried at its last place, then by pairing persons; a registered one is refitted
        to the pairs of the last seconds.

        name: name of the sensor.
        bodies: its skeletons.
        now: s of the host's clock.
        """
        link, s = self._links[name], self.settings
        if link.motion is not None:
            recent = [(target, body) for at, body, target in link.pairs if at >= now - s.window]
            if link.anchor or now - link.fitted < s.refit or len(recent) < 10:
                return
            link.fitted, both = now, np.array(recent[:: max(1, len(recent) // 40)])
            # on all joints: the trunk is too small for its joints' constant errors (scenes A, B of the simulator, seeds
            # 0 to 2: 49.6, 43.3 mm by the trunk, 44.8, 40.3 by all)
            fit = register(both, iterations=8)
            if fit.registered[1] and fit.residual[1] < s.residual:
                link.motion, link.residual = fit.common_from_sensor[1], float(fit.residual[1])
            return
        seen = {p.id: p.joints for p in self._people if p.members and p.frames >= s.birth}
        if not seen:
            return
        link.shots.append((now, {b.person: b.positions for b in bodies}, seen))
        # one sensor at a time, so that no frame is late
        if len(link.shots) < s.shots or now - link.tried < s.attempt or now <= self._tried:
            return
        link.tried = self._tried = now
        shots = [(bodies, people) for at, bodies, people in link.shots if at >= now - s.window]
        score = np.inf if link.before is None else place_score(link.before, shots)
        if link.before is not None and score < s.residual:
            found = link.before, score
        else:
            found = find_place(shots, s.shots, s.residual, s.distinct)
        if found is not None:
            link.motion, link.residual = found
            link.trusted, link.fitted, link.strays = True, now, 0
            link.shots.clear()


def is_swapped(joints: Array, like: Array) -> bool:
    """Return whether joints are nearer to another skeleton after exchanging left and right, because the sensor sees the
    back.

    joints, like: (15, 3) m of both skeletons, in the same frame.
    """
    a, b = joints - like, joints[MIRROR] - like
    both = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])  # only the joints that all three have
    return bool((b[both] ** 2).sum() < (a[both] ** 2).sum())


# ---- places of sensors -----------------------------------------------------------------------------------------------
# Where a sensor stands, found from the persons that it shares with others, when identities are unknown.


# One instant: skeletons (15, 3) of a sensor in its frame, by its numbers of persons; and the tracked persons in the
# common frame, by their ids.
_SensorInstant = tuple[Mapping[int, Array], Mapping[int, Array]]
_TRUNK = np.array(TRUNK_JOINTS)
# Number of instants per pairing in the quick first test.
_LOOK = 4


def find_place(
    shots: Sequence[_SensorInstant], fewest: int, residual: float, distinct: float
) -> tuple[Array, float] | None:
    """Find the transform of a sensor by pairing its persons with the tracked persons, whose identities are unknown.

    shots: instants, each with the sensor's persons and the tracked persons.
    fewest: least number of instants that a pairing must share.
    residual: largest score, m.
    distinct: largest ratio of the best score to that of the next best different pairing.
    Returns: common_from_sensor (4, 4) and its score in m (median distance of the joints plus the distance of persons
        that match no tracked one); None where no pairing is clearly the best.

    Every pairing of one of the sensor's persons with one tracked person gives a transform; the best one puts all
    persons on tracked persons. All pairings are tried on a few instants, the best six on all.
    """
    some = list(shots)[:: max(1, len(shots) // 12)]
    pairs, skeletons = [], []
    for b, p in sorted({(b, p) for bodies, people in some for b in bodies for p in people}):
        both = [(bodies[b], people[p]) for bodies, people in some if b in bodies and p in people]
        if len(both) >= min(fewest, len(some)):
            pairs.append((b, p))
            skeletons.append((np.stack([x for x, _ in both]), np.stack([y for _, y in both])))
    few = some[:: max(1, len(some) // 5)]
    theirs, ours = (_trunk_centres([shot[k] for shot in few]) for k in (0, 1))
    # a person that only one side sees gives no information: count as many as both can share
    shared = np.minimum(np.isfinite(theirs[..., 0]).sum(1), np.isfinite(ours[..., 0]).sum(1))
    counted = np.arange(theirs.shape[1]) < shared[:, None]

    def tried(i: int, exchanged: bool, instants: slice, iterations: int, penalty: float) -> tuple[float, Array] | None:
        """Score a pairing and its transform; None with fewer than 20 common joints."""
        source, target = (a[instants] for a in skeletons[i])
        source, target = (source[:, MIRROR] if exchanged else source).reshape(-1, 3), target.reshape(-1, 3)
        use = np.isfinite(source[:, 0]) & np.isfinite(target[:, 0])
        if int(use.sum()) < 20:
            return None
        motion, apart = robust_motion(source[use], target[use], np.ones(int(use.sum())), iterations)
        d = np.linalg.norm(transform(motion, theirs)[:, :, None] - ours[:, None], axis=-1)
        nearest = np.sort(np.where(np.isfinite(d), d, np.inf).min(2), axis=1)[counted]
        # the mean distance of persons from tracked ones counts from 0.1 m, which is noise
        away = max(0.0, float(np.minimum(nearest, 0.5).mean()) - 0.1) if len(nearest) else 0.0
        return penalty * apart + away, motion

    quick = list[tuple[float, int, bool]]()
    # also with its sides exchanged; correct sides are the rule, so exchanged ones must fit clearly better
    for exchanged, penalty in ((False, 1.0), (True, 1.4)):
        for i, (body, _) in enumerate(skeletons):
            step = max(1, len(body) // _LOOK)
            if (fit := tried(i, exchanged, slice(None, 2 * _LOOK * step, step), 1, penalty)) is not None:
                quick.append((fit[0], i, exchanged))
    fits = [(i, tried(i, exchanged, slice(None), 4, 1.0)) for _, i, exchanged in sorted(quick)[:6]]
    found = sorted([(*fit, *pairs[i]) for i, fit in fits if fit is not None], key=lambda f: f[0])
    if not found:
        return None
    score, motion, b, p = found[0]
    # another pairing that gives the same transform is no rival
    rivals = [f for f in found[1:] if (f[2] == b) != (f[3] == p)]
    if score > residual or (rivals and score > distinct * rivals[0][0]):
        return None
    return motion, score


def _trunk_centres(instants: Sequence[Mapping[int, Array]]) -> Array:
    """Compute the trunk centres (S, P, 3), m, of the persons of each instant; NaN for those that are missing."""
    found = [[c for joints in people.values() if (c := trunk_centre(joints)) is not None] for people in instants]
    out = np.full((len(found), max([1, *map(len, found)]), 3), np.nan)
    for n, centres in enumerate(found):
        out[n, : len(centres)] = np.array(centres).reshape(-1, 3)
    return out


def place_score(motion: Array, shots: Sequence[_SensorInstant]) -> float:
    """Compute the median distance of the joints of a sensor's persons to those of the tracked persons, for a given
    transform.

    motion: common_from_sensor (4, 4).
    shots: instants, each with the sensor's persons and the tracked persons.
    Returns: m, infinite where they share no instant. Persons that only one side sees do not count.
    """
    scores = []
    for bodies, people in shots:
        if not bodies or not people:
            continue
        there = transform(motion, np.stack(list(bodies.values())))
        d = np.linalg.norm(there[:, None] - np.stack(list(people.values()))[None], axis=-1)
        known = np.isfinite(d)
        middle = np.ma.median(np.ma.masked_array(np.where(known, d, 0.0), ~known), axis=-1).filled(np.inf)
        scores.append(float(np.sort(middle.min(1))[: min(len(bodies), len(people))].mean()))
    return float(np.median(scores)) if scores else np.inf


def trunk_centre(joints: Array) -> Array | None:
    """Compute the mean (3,) of the trunk joints of a skeleton (15, 3); None where fewer than three of
    them are known.
    """
    known = _TRUNK[np.isfinite(joints[_TRUNK, 0])]
    # each missing joint shifts the plain mean by some centimetres, which is less than the gate
    return joints[known].mean(0) if len(known) >= 3 else None


# ---- live fusion ---------------------------------------------------------------------------------------------------
# Fuse skeletons live: reports of sensors go in, one skeleton per person comes out at a steady rate with bounded
# latency.
#
# `align` handles clocks, rates, late and dead sensors; `people` finds identities and the positions of the sensors;
# `fit` fuses one skeleton. Nothing here waits or uses sockets: the caller gives the time, so that the live server,
# tests and benchmarks run the same code.


@dataclass(frozen=True)
class LiveSkeleton:
    """One fused person in an output frame.

    id: identifier of the person.
    joints: (15, 3) m, joints.COMMON in the frame of the first sensor.
    sd: (15,) m per axis.
    sensors: names of the sensors that see the person now.
    shares: (15, K) share of each of `LiveFrame.sensors` in each joint.
    seen: whether a sensor sees the person now; else the joints are predicted.
    """

    id: int
    joints: Array
    sd: Array
    sensors: tuple[str, ...]
    shares: Array
    seen: bool


@dataclass(frozen=True)
class LiveFrame:
    """One output frame.

    index: number of the frame, from 0.
    time: s on the host's clock that the frame describes.
    people: one skeleton per person.
    sensors: names of the sensors known so far.
    """

    index: int
    time: float
    people: tuple[LiveSkeleton, ...]
    sensors: tuple[str, ...]


class LiveFuser:
    """Live fusion of the skeletons of several people from several sensors.

    settings: settings of the output instants.

    Call `push` for every report as it arrives, and `poll` at the time `aligner.due()` or more often. All times are s of
    one monotonic host clock.
    """

    def __init__(self, settings: AlignSettings | None = None) -> None:
        self.aligner, self.people = Aligner(settings), PeopleTracker()
        self._states: dict[int, FitState] = {}
        _warm_up()

    def push(self, report: SensorReport, now: float | None = None) -> bool:
        """Add one report of one sensor.

        now: arrival on the host's monotonic clock, s; by default that of the report.
        Returns: False where the report was not used, because it is too late or its time is implausible.
        Raises: InputError for an unknown joint set, coordinates that are not metres, or too many sensors or persons.
        """
        return self.aligner.push(report, now)

    def poll(self, now: float) -> list[LiveFrame]:
        """Return the frames that are ready at host time `now`, in order."""
        return [self._fuse(instant) for instant in self.aligner.poll(now)]

    def frames(self, reports: Iterable[SensorReport]) -> Iterator[LiveFrame]:
        """Yield the fused frames of a sequence of reports, live (an iterator that waits for the next report) or
        recorded.

        Raises: InputError as `Aligner.push`; reports that cannot be used are skipped.
        """
        for r in reports:
            self.push(r)
            yield from self.poll(r.time if r.arrival is None else r.arrival)

    def _fuse(self, instant: Instant) -> LiveFrame:
        people = self.people.update(instant)
        alive = {p.id for p in people}
        self._states = {i: s for i, s in self._states.items() if i in alive}
        names = tuple(v.name for v in instant.sensors)
        return LiveFrame(
            instant.index, instant.time, tuple(self._person(p, names, instant.time) for p in people), names
        )

    def _person(self, p: SeenPerson, names: tuple[str, ...], now: float) -> LiveSkeleton:
        """Fuse one person at an instant.

        p: the person's skeletons.
        names: names of all sensors.
        now: s of the host's clock.
        """
        positions, eyes = np.full((len(names), 15, 3), np.nan), np.full((len(names), 3), np.nan)
        state = np.zeros((len(names), 15), dtype=np.uint8)
        for k, name in enumerate(names):
            if name in p.placed:
                positions[k], state[k] = p.placed[name], p.bodies[name].state
                eyes[k] = self.people.transforms[name][:3, 3]
        self._states[p.id], estimate = fit_step(self._states.get(p.id) or start_fit(), positions, state, now, eyes)
        sd = np.sqrt(estimate.variance + estimate.systematic)
        return LiveSkeleton(p.id, estimate.joints, sd, tuple(p.bodies), estimate.shares, bool(p.bodies))


def _warm_up() -> None:
    """Compile the code that a frame needs, so that the first frame is not late."""
    standing = np.linspace(0, 1, 45).reshape(1, 15, 3)
    state = start_fit()
    for n in range(2):
        state, _ = fit_step(state, standing, np.full((1, 15), 2, dtype=np.uint8), n / 30, np.zeros((1, 3)))
