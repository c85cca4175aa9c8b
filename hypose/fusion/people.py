"""Which skeleton of which sensor is which person: sensors are registered to each other by the persons they share, persons
are matched by the distance of their trunks in the common frame.

The common frame is that of the first sensor that saw somebody, and stays it when that sensor dies. A sensor that comes
back keeps its place if its skeletons still fall on the persons of the others, and is registered anew if not.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from hypose.evidence.frame import SensorJoints
from hypose.fusion.align import Instant, SensorBody
from hypose.fusion.joints import COMMON, MIRROR, TRUNK
from hypose.fusion.register import register
from hypose.geometry import Array, procrustes, transform

_TRUNK = np.array(TRUNK)


@dataclass(frozen=True)
class PeopleSettings:
    """gate m: a skeleton further from a person's trunk is not that person; faithful m: how much nearer another person
    must be than the one a sensor's person was before; birth: instants before a new person is believed; linger, forget s:
    how long a person nobody sees is still reported, and remembered; window s of skeletons that a registration rests on,
    renewed every refit s; attempt s between tries to register; shots: fewest shared instants; residual m: largest median
    distance of a registration; distinct: ratio to the next best pairing; strays: instants without a match after which a
    sensor has been moved; most: persons."""

    gate: float = 0.6
    faithful: float = 0.2
    birth: int = 3
    linger: float = 0.3
    forget: float = 1.0
    window: float = 5.0
    refit: float = 1.0
    attempt: float = 0.2
    shots: int = 5
    residual: float = 0.15
    distinct: float = 0.7
    strays: int = 20
    most: int = 16


@dataclass(frozen=True)
class SeenPerson:
    """A person at one instant: id, never used twice; joints: its skeletons as SensorJoints, each in its sensor's frame;
    seen: some sensor sees it now."""

    id: int
    joints: SensorJoints
    seen: bool


@dataclass
class _Person:
    id: int
    centre: Array
    velocity: Array
    time: float
    joints: Array  # (15, 3) in the common frame, NaN where never seen
    members: dict[str, SensorBody]
    last: dict[str, int]  # sensor -> its number of this person
    frames: int = 0
    apart: dict[int, int] | None = None


class _Link:
    """One sensor's place: common_from_sensor, and what it is estimated from."""

    def __init__(self) -> None:
        self.motion: Array | None = None
        self.trusted = False  # may found persons
        self.anchor = False
        self.life = 0
        self.residual = np.nan
        self.strays = 0
        self.shots: deque[tuple[float, dict[int, Array], dict[int, Array]]] = deque(maxlen=40)
        self.pairs: deque[tuple[float, Array, Array]] = deque(maxlen=160)
        self.tried = self.fitted = self.noted = -np.inf

    def lose(self) -> None:
        """The sensor stands elsewhere: begin anew."""
        self.motion, self.trusted, self.anchor, self.strays = None, False, False, 0
        self.shots.clear()
        self.pairs.clear()


class PeopleTracker:
    """Follows persons over sensors; call `update` for every instant in order."""

    def __init__(self, settings: PeopleSettings | None = None) -> None:
        self.settings = settings or PeopleSettings()
        self._links: dict[str, _Link] = {}
        self._people: list[_Person] = []
        self._last_id = 0

    @property
    def transforms(self) -> dict[str, Array]:
        """common_from_sensor (4, 4) of every registered sensor."""
        return {n: link.motion for n, link in self._links.items() if link.motion is not None}

    @property
    def residuals(self) -> dict[str, float]:
        """Median distance (m) of each registered sensor's joints to those of the others; NaN where not known."""
        return {n: float(link.residual) for n, link in self._links.items() if link.motion is not None}

    def update(self, instant: Instant) -> list[SeenPerson]:
        """The persons at this instant, oldest first."""
        s, now = self.settings, instant.time
        views = {v.name: v for v in instant.sensors}
        for name in [n for n in self._links if n not in views]:
            del self._links[name]
        for v in instant.sensors:
            link = self._links.setdefault(v.name, _Link())
            if v.life != link.life:
                link.life, link.trusted, link.strays = v.life, False, 0
                link.pairs.clear()
                link.shots.clear()
        if all(link.motion is None for link in self._links.values()):
            first = next((v.name for v in instant.sensors if v.bodies), None)
            if first is not None:
                link = self._links[first]
                link.motion, link.trusted, link.anchor = np.eye(4), True, True
        for p in self._people:
            p.members = {}
        order = sorted(views, key=lambda n: not (self._links[n].anchor and self._links[n].trusted))
        for name in order:
            if views[name].bodies and self._links[name].motion is not None:
                self._match(name, views[name].bodies, now)
        if not any(p.members for p in self._people):
            self._take_back_alone(instant)
        for p in self._people:
            if p.members:
                self._renew(p, now)
        self._people = [p for p in self._people if now - p.time <= (s.forget if p.frames >= s.birth else s.linger)]
        self._merge()
        for v in instant.sensors:
            if v.bodies:
                self._place(v.name, v.bodies, now)
        names = tuple(views)
        return [
            SeenPerson(p.id, _sensor_joints(p, names, now), bool(p.members))
            for p in self._people
            if p.frames >= s.birth and now - p.time <= s.linger
        ]

    # ---- matching ----

    def _match(self, name: str, bodies: Sequence[SensorBody], now: float) -> None:
        s, link = self.settings, self._links[name]
        assert link.motion is not None
        placed = [transform(link.motion, b.positions) for b in bodies]
        centres = [_centre(j) for j in placed]
        free = [i for i, c in enumerate(centres) if c is not None]
        matched = 0
        if self._people and free:
            at = np.stack([p.centre + p.velocity * min(now - p.time, 0.2) for p in self._people])
            distance = np.linalg.norm(at[:, None] - np.stack([centres[i] for i in free])[None], axis=-1)  # type: ignore[arg-type]
            own = np.array([[p.last.get(name) == bodies[i].person for i in free] for p in self._people])
            cost = np.where(distance <= s.gate, distance - s.faithful * own, 1e3)
            rows, columns = linear_sum_assignment(cost)
            for r, c in zip(rows.tolist(), columns.tolist(), strict=True):
                if cost[r, c] < 1e2:
                    self._people[r].members[name] = bodies[free[c]]
                    matched += 1
                    free[c] = -1
        left = [i for i in free if i >= 0]
        # persons that others see, but none where this sensor says: it has been moved
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
                self._people.append(
                    _Person(self._last_id, centre, np.zeros(3), now, placed[i], {name: bodies[i]}, {}, apart={})
                )

    def _take_back_alone(self, instant: Instant) -> None:
        """When no trusted sensor sees anybody, one that came back is believed where it stood."""
        for v in instant.sensors:
            link = self._links[v.name]
            if v.bodies and link.motion is not None and not link.trusted:
                if any(w.alive and self._links[w.name].trusted for w in instant.sensors):
                    return
                link.trusted = True
                self._match(v.name, v.bodies, instant.time)
                return

    def _renew(self, p: _Person, now: float) -> None:
        joints, weight = [], []
        for name, body in p.members.items():
            motion = self._links[name].motion
            assert motion is not None
            placed = unswapped(transform(motion, body.positions), p.joints)
            joints.append(placed)
            weight.append(body.state)
            p.last[name] = body.person
        stacked, w = np.stack(joints), np.stack(weight).astype(np.float64)
        total = w.sum(0)
        mean = (np.where(w[..., None] > 0, stacked, 0.0) * w[..., None]).sum(0) / np.maximum(total, 1)[:, None]
        for n, name in enumerate(p.members):
            self._note(name, p.members[name], stacked[n], w[n], mean, total, now, p)
        p.joints = np.where(total[:, None] > 0, mean, p.joints)
        centre = _centre(np.where(total[:, None] > 0, mean, np.nan))
        if centre is not None:
            step = now - p.time
            if 0 < step < 0.5 and p.frames:
                p.velocity = p.velocity + min(1.0, step / 0.15) * ((centre - p.centre) / step - p.velocity)
                speed = float(np.linalg.norm(p.velocity))
                p.velocity *= min(1.0, 8.0 / max(speed, 1e-9))
            p.centre = centre
        p.time = now
        p.frames += 1

    def _note(
        self, name: str, body: SensorBody, own: Array, w: Array, mean: Array, total: Array, now: float, p: _Person
    ) -> None:
        """Keep a pair (this sensor's joints, those of all others) for the next registration of the sensor."""
        link = self._links[name]
        rest = total - w
        if link.anchor or not (rest[_TRUNK] > 0).sum() >= 4 or now - link.noted < 0.03:
            return
        link.noted = now
        others = (mean * total[:, None] - np.where(w[:, None] > 0, own, 0.0) * w[:, None]) / np.maximum(rest, 1)[
            :, None
        ]
        others = np.where(rest[:, None] > 0, others, np.nan)
        # the labels as the others see them
        link.pairs.append((now, _relabelled(body.positions, own, self._links[name].motion), others))

    def _merge(self) -> None:
        """Two persons in one place, of different sensors, for half a second: one person."""
        for i, a in enumerate(self._people):
            for b in self._people[i + 1 :]:
                near = float(np.abs(a.centre - b.centre).max()) < 0.25 and not (a.members.keys() & b.members.keys())
                assert a.apart is not None
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
        link, s = self._links[name], self.settings
        if link.motion is not None:
            if not link.anchor and now - link.fitted >= s.refit and len(link.pairs) >= 10:
                self._refit(link, now)
            return
        seen = {p.id: p.joints for p in self._people if p.members and p.frames >= s.birth}
        if not seen:
            return
        link.shots.append((now, {b.person: b.positions for b in bodies}, seen))
        if len(link.shots) >= s.shots and now - link.tried >= s.attempt:
            link.tried = now
            self._try(link, now)

    def _refit(self, link: _Link, now: float) -> None:
        s = self.settings
        while link.pairs and link.pairs[0][0] < now - s.window:
            link.pairs.popleft()
        link.fitted = now
        if len(link.pairs) < 10:
            return
        stride = max(1, len(link.pairs) // 40)
        chosen = list(link.pairs)[::stride]
        both = np.stack([np.stack([target, body]) for _, body, target in chosen])
        found = register(both, joints=TRUNK, iterations=8)
        if found.registered[1] and found.residual[1] < s.residual:
            link.motion, link.residual = found.common_from_sensor[1], float(found.residual[1])

    def _try(self, link: _Link, now: float) -> None:
        """Every pairing of one of its persons with one of ours gives a place; the best one puts all on their persons."""
        s = self.settings
        while link.shots and link.shots[0][0] < now - s.window:
            link.shots.popleft()
        shots = list(link.shots)[:: max(1, len(link.shots) // 12)]
        found: list[tuple[float, int, int, Array]] = []
        pairs = {(b, p) for _, bodies, people in shots for b in bodies for p in people}
        for b, p in sorted(pairs):
            body = [bodies[b] for _, bodies, people in shots if b in bodies and p in people]
            ours = [people[p] for _, bodies, people in shots if b in bodies and p in people]
            if len(body) < min(s.shots, len(shots)):
                continue
            best = _fit(np.stack(body), np.stack(ours))
            if best is not None:
                motion, residual = best
                found.append((residual + _misplaced(motion, shots), b, p, motion))
        if not found:
            return
        found.sort(key=lambda f: f[0])
        score, b, p, motion = found[0]
        # another pairing that says the same is no rival
        rivals = [f for f in found[1:] if (f[1] == b) != (f[2] == p)]
        if score > s.residual or (rivals and score > s.distinct * rivals[0][0]):
            return
        link.motion, link.residual, link.trusted, link.fitted, link.strays = motion, score, True, now, 0
        link.shots.clear()


def unswapped(joints: Array, like: Array) -> Array:
    """Joints (15, 3), with left and right exchanged if that makes them more like another skeleton in the same frame:
    a sensor that sees the back takes it for the front."""
    mirrored = joints[MIRROR]
    a, b = np.linalg.norm(joints - like, axis=-1), np.linalg.norm(mirrored - like, axis=-1)
    both = np.isfinite(a) & np.isfinite(b)
    return mirrored if b[both].sum() < a[both].sum() - 1e-9 else joints


def _relabelled(positions: Array, placed: Array, motion: Array | None) -> Array:
    """The sensor's positions with the labels that `placed` has."""
    assert motion is not None
    same = transform(motion, positions)
    fine = np.isfinite(same) & np.isfinite(placed)
    return positions if np.allclose(same[fine], placed[fine]) else positions[MIRROR]


def _centre(joints: Array) -> Array | None:
    trunk = joints[_TRUNK]
    known = np.isfinite(trunk[:, 0])
    if int(known.sum()) < 3:
        return None
    # each joint missing would move a plain mean by some centimetres, which the gate takes
    return trunk[known].mean(0)


def _fit(body: Array, ours: Array) -> tuple[Array, float] | None:
    """common_from_sensor and the median distance from skeletons (T, 15, 3), tried with both sides' labels."""
    best: tuple[Array, float] | None = None
    for mirrored in (False, True):
        source = (body[:, MIRROR] if mirrored else body).reshape(-1, 3)
        target = ours.reshape(-1, 3)
        use = np.isfinite(source[:, 0]) & np.isfinite(target[:, 0])
        if int(use.sum()) < 20:
            continue
        a, b = source[use], target[use]
        weight = None
        for _ in range(3):
            motion = procrustes(a, b, weight)[0]
            distance = np.linalg.norm(transform(motion, a) - b, axis=-1)
            weight = 1 / (1 + (distance / 0.06) ** 2)
        residual = float(np.median(distance))
        # an honest sensor is the rule: swapped sides must fit clearly better
        if best is None or residual < 0.7 * best[1]:
            best = motion, residual
    return best


def _misplaced(motion: Array, shots: Sequence[tuple[float, dict[int, Array], dict[int, Array]]]) -> float:
    """Mean distance (m, each at most 0.5) of the sensor's persons to the nearest of ours, beyond what noise explains."""
    far = []
    for _, bodies, people in shots:
        ours = [c for j in people.values() if (c := _centre(j)) is not None]
        theirs = [c for j in bodies.values() if (c := _centre(transform(motion, j))) is not None]
        # whom only one side sees says nothing: as many as both can share
        if ours and theirs:
            d = np.linalg.norm(np.stack(theirs)[:, None] - np.stack(ours)[None], axis=-1).min(1)
            far.append(np.minimum(np.sort(d)[: min(len(ours), len(theirs))], 0.5).mean())
    return max(0.0, float(np.mean(far)) - 0.1) if far else 0.0


def _sensor_joints(p: _Person, names: tuple[str, ...], now: float) -> SensorJoints:
    positions = np.full((len(names), 15, 3), np.nan)
    state: NDArray[np.uint8] = np.zeros((len(names), 15), dtype=np.uint8)
    times = np.full(len(names), np.nan)
    for k, name in enumerate(names):
        body = p.members.get(name)
        if body is not None:
            positions[k], state[k], times[k] = body.positions, body.state, now
    return SensorJoints(positions, state, times, COMMON, names)
