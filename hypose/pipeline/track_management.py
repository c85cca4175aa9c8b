"""Manage people's tracks: follow where they stand in the visual hull before they are tracked, name them, and find those
whom no tracked body explains, who return, or who were exchanged.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.frame import Colours, Frame, Keypoints, Silhouettes
from hypose.evidence.people import FEWEST_VIEWS, HullPerson, Other, own_frame, people_seen, without
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject import TrackedSubject
from hypose.pipeline.track_loop import TrackedPerson, body_shape
from hypose.tracking.frame_evidence import PreparedFrame, mean_overlap, prepare
from hypose.tracking.part_colours import NO_CLOTHES, appearance_in, likeness
from hypose.tracking.start_search import starts_in_frame

if TYPE_CHECKING:
    from hypose.evidence.association import PersonTrack


# ---- places in the visual hull --------------------------------------------------------------------------------------


@dataclass(eq=False)
class Path:
    """Path of a person in the hull over time.

    found: by frame number, the part of the hull that is this person.
    """

    found: dict[int, HullPerson] = field(default_factory=dict)

    def expected(self, frame: int) -> Array:
        """Predict where (2,) m the person stands in a later frame, from the latest motion."""
        known = sorted(self.found)[-4:]
        last = self.found[known[-1]].axis
        if len(known) < 3:
            return last
        speed = (last - self.found[known[0]].axis) / (known[-1] - known[0])
        return last + speed * (frame - known[-1])

    def axis(self, frame: int, within: float = np.inf) -> Array:
        """Return where (2,) m the person stood in the nearest frame in which they were found; NaN where that is more
        than `within` frames away.
        """
        nearest = min(self.found, key=lambda k: abs(k - frame))
        return self.found[nearest].axis if abs(nearest - frame) <= within else np.full(2, np.nan)


def follow_places(
    frame_at: Callable[[int], Frame],
    numbers: Sequence[int],
    frame_rate: float,
    known: Callable[[int], Sequence[Other]] = lambda t: (),
) -> list[Path]:
    """Find the paths of people through the frames `numbers` (ascending), longest path first.

    frame_at: function that reads a frame by its number.
    frame_rate: Hz.
    known: function of a frame number that gives the people who are tracked already; parts near them that are too small
        for a person, such as limbs, are left out.
    """
    from scipy.optimize import linear_sum_assignment  # takes long to import

    paths: list[Path] = []
    for t in numbers:
        frame = frame_at(t)
        if not frame.of(Silhouettes):
            continue
        others = known(t)
        here = [h for h in people_seen(frame, others) if h.tall or not others]
        known_hulls = [(h.litres, h.hull.height) for p in paths for h in p.found.values()]
        litres, height = np.median(known_hulls, axis=0) if known_hulls else (0.0, 1.0)
        # ignore remains of a person's hull; children have a smaller volume, but are less tall too
        here = [h for h in here if h.litres > SETTINGS.path_part * litres * min(1.0, (h.hull.height / height) ** 3)]
        alive = [
            p
            for p in paths
            if t - max(p.found) <= max(SETTINGS.path_gone_s * frame_rate, 2 * max(np.diff([*numbers, t + 1])))
        ]
        taken: set[int] = set()
        if alive and here:
            away = np.array([[float(np.linalg.norm(p.expected(t) - h.axis)) for h in here] for p in alive])
            reach = np.array(
                [[SETTINGS.path_slack + SETTINGS.path_surprise * (t - max(p.found)) / frame_rate] for p in alive]
            )
            for a, b in zip(*linear_sum_assignment(np.where(away < reach, away, 1e3)), strict=True):
                if away[a, b] < reach[a, 0]:
                    alive[a].found[t] = here[b]
                    taken.add(int(b))
        paths += [Path({t: h}) for k, h in enumerate(here) if k not in taken]
    return sorted(paths, key=lambda p: (-len(p.found), -np.median([h.litres for h in p.found.values()])))


def lasting(paths: Sequence[Path], looks: Sequence[int]) -> list[Path]:
    """Select the paths that are found in half of the frames `looks`: of two people whose arms touch, the hull separates
    one in every other look.
    """
    return [p for p in paths if sum(t in p.found for t in looks) >= max(2, 0.5 * len(looks))]


# ---- who stands where ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class KnownPerson:
    """Prior knowledge of a person, from a [[person]] of recording.toml.

    height: m.
    body: the person's own body.
    place: (2,) m where the person stands at `time`.
    time: s from the first tracked frame; negative before it.
    """

    name: str
    height: float | None = None
    body: Body | None = None
    place: tuple[float, float] | None = None
    time: float = 0.0

    @property
    def early(self) -> bool:
        """Whether the place is too long before the first frame to identify the person."""
        return self.place is not None and self.time < -SETTINGS.people_start_s

    @property
    def not_found(self) -> str:
        """The sentence that this person was not found."""
        at = self.place
        where = "" if at is None else f" at [{at[0]:g}, {at[1]:g}] m, {self.time:g} s from the first frame"
        return f"no person was found who is {self.name}{where}"


def names_at_places(
    wanted: Sequence[KnownPerson],
    count: int,
    place: Callable[[int, int], Array],
    frame_rate: float,
    taken: Sequence[str] = (),
) -> list[str]:
    """Name the people who were found.

    count: number of people found.
    place: place(k, frame) gives where (2,) m the k-th stands, NaN where not known.
    frame_rate: Hz.
    taken: names of people who are known already.
    Returns: name per person. Wanted people without a usable place get the remaining people in their order; people about
        whom nothing is known are person-1, person-2 and so on.
    """
    free, names = [w for w in wanted if w.name not in taken], dict[int, str]()
    for one in free:
        if one.place is not None and not one.early:
            t = max(0, round(one.time * frame_rate))
            away = [float(np.linalg.norm(place(k, t) - np.array(one.place))) for k in range(count)]
            near = [k for k in range(count) if k not in names and away[k] < SETTINGS.tracked_placed_m]
            if near:
                names[min(near, key=lambda k: away[k])] = one.name
    used = {*taken, *(w.name for w in wanted)}
    numbered = (n for n in map("person-{}".format, itertools.count(1)) if n not in used)
    rest = itertools.chain((w.name for w in free if w.place is None or w.early), numbered)
    return [names[k] if k in names else next(rest) for k in range(count)]


def said_of_places(wanted: Sequence[KnownPerson], count: int) -> tuple[str, ...]:
    """Return a sentence for the user that given places are too early to tell who is who.

    wanted: people with their places.
    count: number of people found.
    Returns: one sentence; none where all places can be used, or one person was found.
    """
    early = [w for w in wanted if w.early]
    if not early or count < 2:
        return ()
    of = ", ".join(f"{w.name} {-w.time:.1f} s" for w in early)
    return (
        f"places of before the frames that are tracked ({of}) do not tell who is who there: give a place and time "
        "within them in recording.toml",
    )


# ---- people points -------------------------------------------------------------------------------------------------
# Key points of several people, sorted by person (hypose.evidence.association).


@dataclass(frozen=True)
class KeypointPeople:
    """Key points of several people, sorted by person.

    tracks: one track per person.
    names: (K) names of the key points.
    rig: pinhole cameras; the pixels of the key points are in their images.
    """

    tracks: Sequence[PersonTrack]
    names: tuple[str, ...]
    rig: CameraRig

    @property
    def nothing(self) -> Keypoints:
        """Key points of an empty frame: confidence 0."""
        return Keypoints(np.zeros((len(self.rig), len(self.names), 3)), self.names, self.rig)

    def lasting(self, total: int) -> list[int]:
        """List the numbers of the tracks that last at least a certain share of `total` frames
        (SETTINGS.points_least_share); where none does, the longest one.
        """
        long = [k for k, t in enumerate(self.tracks) if len(t) >= max(5, SETTINGS.points_least_share * total)]
        return long or sorted(range(len(self.tracks)), key=lambda k: -len(self.tracks[k]))[:1]

    def at(
        self, frame: int, place: Array, taken: Sequence[int], so_far: int | None = None
    ) -> tuple[int, Keypoints] | None:
        """Find the track of a person at a place (2,) m: the track `so_far` while it lasts, else the nearest that is not
        taken.

        Returns: number of the track and its key points; None where no track is near.
        """
        away = [float(np.linalg.norm(t.place(frame)[:2] - place)) for t in self.tracks]
        free = [k for k in range(len(away)) if k not in taken and away[k] < SETTINGS.people_near_m]
        if not free:
            return None
        best = so_far if so_far in free else min(free, key=lambda k: away[k])
        assert best is not None
        return best, self.of(best, frame)

    def of(self, track: int, frame: int) -> Keypoints:
        """Return the key points of one track in a frame of the clip."""
        t = self.tracks[track]
        if not 0 <= frame - t.first < len(t):
            return self.nothing
        return replace(self.nothing, points=t.points[frame - t.first, ..., :3].copy())


def per_frame(motion: Motion, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Select frames of a motion.

    rows: their numbers, or a (T,) mask.
    Returns: by name of the field, the selected rows of each array that has one row per frame, for `replace`.
    """
    return {k: v[rows] for k, v in vars(motion).items() if isinstance(v, np.ndarray) and len(v) == len(motion)}


# ---- wardrobe ------------------------------------------------------------------------------------------------------
# Identify people by their clothes after they were near each other, or away.


def _apart(a: TrackedPerson, b: TrackedPerson, t: int = -1) -> float:
    return float(np.linalg.norm(a.estimates[t].pose[:2] - b.estimates[t].pose[:2]))


def update_appearance(
    people: Sequence[TrackedPerson], seen: Sequence[Frame]
) -> list[tuple[TrackedPerson, TrackedPerson, int]]:
    """Update the model of each person's clothes after a frame was tracked, and find people whose tracks were exchanged
    when they met.

    people: those whose place is known are updated; nothing is done without pictures.
    seen: per person, the frame with the evidence of that person only.
    Returns: (person, other person, first frame in which each has the track of the other); empty: none.
    """
    there = [p for p in people if p.member.sure]
    for p, frame in zip(people, seen, strict=True):
        if not frame.of(Colours) or p not in there:
            continue
        w, near = p.appearance, [q for q in there if q is not p and _apart(p, q) < SETTINGS.wardrobe_near_m]
        for q in near:  # the frame in which they were nearest so far
            if q.name not in w.met or _apart(p, q) <= _apart(p, q, w.met[q.name]):
                w.met[q.name] = len(p.estimates) - 1
        if near:
            w.lately, w.looks = NO_CLOTHES, 0
            continue
        w.lately, w.looks = w.lately + appearance_in(p.subject.body, p.estimates[-1].pose, frame), w.looks + 1
        if not w.met:
            w.settle()
    return _exchanged(there)


def _exchanged(there: Sequence[TrackedPerson]) -> list[tuple[TrackedPerson, TrackedPerson, int]]:
    out = []
    for i, p in enumerate(there):
        a = p.appearance
        for q in there[:i]:
            b = q.appearance
            if min(a.looks, b.looks) < SETTINGS.wardrobe_looks or not (q.name in a.met and p.name in b.met):
                continue
            own = likeness(a.worn, a.lately) + likeness(b.worn, b.lately)
            other = likeness(a.worn, b.lately) + likeness(b.worn, a.lately)
            if other > own + SETTINGS.wardrobe_clearly:  # False where one of them has not been seen (NaN)
                out.append((p, q, min(a.met[q.name], b.met[p.name])))
                a.lately, b.lately = b.lately, a.lately
            del a.met[q.name], b.met[p.name]
    for p in there:  # forget meetings with people who have left
        names = {q.name for q in there}
        w = p.appearance
        if w.looks >= SETTINGS.wardrobe_looks and not names & set(w.met):
            w.settle()
    return out


def swap_identities(
    p: TrackedPerson, q: TrackedPerson, since: int, reported: str = "as their clothes showed afterwards"
) -> None:
    """Exchange two people from frame `since` on: their estimates, places and tracks; the frames since then are marked
    as hidden.

    reported: how the exchange is known, as the end of a sentence.
    """
    now = len(p.estimates)
    for name in ("estimates", "present"):
        mine, theirs = getattr(p, name), getattr(q, name)
        mine[since:], theirs[since:] = theirs[since:], mine[since:]
    a, b = p.member, q.member
    p.member = replace(a, state=a.tracker.start(b.state.pose), present=b.present)
    q.member = replace(b, state=b.tracker.start(a.state.pose), present=a.present)
    p.gone, q.gone, p.track, q.track = q.gone, p.gone, q.track, p.track
    for one, other in ((p, q), (q, p)):
        one.hidden[since:] = [True] * (now - since)
        one.said.append(f"taken for {other.name} from frame {since} to {now - 1}, {reported}")


def explained_by(people: Sequence[TrackedPerson], silhouettes: Silhouettes) -> list[Other]:
    """Return what each person whose place is known covers in the views."""
    known = [(p.member.tracker.body, p.estimates[-1].pose) for p in people if p.member.sure]
    return [Other(body_shape(body, pose, silhouettes.rig)) for body, pose in known]


def birth_candidates(known: Sequence[Other], silhouettes: Silhouettes, least: int = FEWEST_VIEWS) -> bool:
    """Return whether the masks show enough that no known person explains, so that a search for another one is worth it.

    known: what the known people cover in the views; empty: True is returned.
    silhouettes: masks of all people; every other pixel is used.
    least: number of views that must show it; where fewer views are usable, all of these must.
    """
    if not known:
        return True
    s, rig = silhouettes, silhouettes.rig.scaled(0.5)
    thin, known = Silhouettes(s.masks[:, ::2, ::2], rig, s.usable, s.reasons), [o.thinned(rig) for o in known]
    boxes = np.concatenate([o.shape.boxes for o in known])
    sizes = (boxes[:, 1] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 2])
    usual = float(np.median(sizes[sizes > 0])) if (sizes > 0).any() else 0.0
    views = thin.usable & (without(thin, known).areas > SETTINGS.newcomer_left_share * usual)
    return int(views.sum()) >= min(least, int(thin.usable.sum()))


def frames_together(frame_rate: float) -> int:
    """Return the number of frames after which two people in one place are taken for one; frame_rate: Hz."""
    return max(2, round(SETTINGS.people_together_s * frame_rate))


def part_doubles(people: Sequence[TrackedPerson], frame_rate: float) -> None:
    """Mark a person as gone who stays in one place with another one, whose body explains the evidence better.

    frame_rate: Hz.
    """
    frames = frames_together(frame_rate)
    known = [p for p in people if p.member.present and len(p.estimates) >= frames]
    for i, a in enumerate(known):
        for b in known[:i]:
            latest = a.estimates[-frames:], b.estimates[-frames:]
            places = [np.stack([e.pose[:3] for e in estimates]) for estimates in latest]
            apart = np.linalg.norm(places[0] - places[1], axis=1)
            if a.member.present and b.member.present and (apart < SETTINGS.newcomer_one_place_m).all():
                costs = [np.mean([np.nan_to_num(e.cost, nan=1.0) for e in estimates]) for estimates in latest]
                worse = a if costs[0] >= costs[1] else b
                worse.member = replace(worse.member, present=False)


def without_doubles(people: Sequence[TrackedPerson], frame: Frame) -> dict[str, TrackedSubject]:
    """Remove people who are found twice at the start, where a hull falls into two parts.

    Of two people in one place, or side by side where one explains nothing of their own, the one stays whose body
    explains the masks better.
    Returns: subjects by name; the name is that of the first.
    """
    kept: dict[str, TrackedPerson] = {}
    for p in people:
        for name, q in kept.items():
            away = float(np.linalg.norm(p.subject.start[:3] - q.subject.start[:3]))  # between the roots
            rest = [o for o in people if o is not p and o is not q]
            alone = (
                min(_explains(a, [*rest, b], frame) for a, b in ((p, q), (q, p)))
                if away < SETTINGS.people_near_m
                else 1.0
            )
            if away < SETTINGS.newcomer_one_place_m or alone < SETTINGS.newcomer_nothing:
                kept[name] = max((q, p), key=lambda o, rest=rest: _explains(o, rest, frame))
                break
        else:
            kept[p.name] = p
    return {name: p.subject for name, p in kept.items()}


def _explains(p: TrackedPerson, others: Sequence[TrackedPerson], frame: Frame) -> float:
    """Compute the mean IoU of a person at the start with what the others leave of the masks; 0 where
    that is nothing.
    """
    body, start, s = p.subject.body, p.subject.start, frame.silhouettes
    assert s is not None
    hide = [Other(body_shape(o.subject.body, o.subject.start, s.rig)) for o in others]
    prepared = prepare(own_frame(frame, body_shape(body, start, s.rig), hide), body, start)
    return mean_overlap(body, start, prepared)


def not_parts(found: Sequence[HullPerson], people: Sequence[TrackedPerson]) -> list[HullPerson]:
    """Leave out parts of the hull that may be a limb of a tracked person.

    found: possible people in the hull.
    people: tracked people.
    Returns: the tall ones, and the others that stand farther than SETTINGS.people_near_m from every tracked person
        whose place is known.
    """
    at = [p.estimates[-1].pose[:2] for p in people if p.member.sure]
    return [h for h in found if h.tall or all(np.linalg.norm(h.axis - q) > SETTINGS.people_near_m for q in at)]


def candidate_evidence(
    person: HullPerson, frame: Frame, known: Sequence[Other], neighbours: Sequence[HullPerson] = ()
) -> Frame:
    """Return the frame with the evidence of one person in the hull; what others cover is left out.

    known: people who are tracked already.
    neighbours: other people in the hull.
    """
    s = frame.silhouettes
    assert s is not None
    rest = [Other(p.shape(s.rig), SETTINGS.path_others_widened) for p in neighbours if p is not person]
    return own_frame(frame, person.shape(s.rig), [*known, *rest])


def found_again(p: TrackedPerson, own: Frame) -> tuple[PreparedFrame, Array]:
    """Fit the pose of a person, whose body is known, to new evidence, starting from the visual hull of this
    evidence.

    p: the person.
    own: frame as evidence for one person in the hull, see `candidate_evidence`.
    Returns: the prepared evidence, and the pose (D,).
    Raises: EvidenceError where the evidence shows no person.
    """
    body = p.subject.body
    prepared = prepare(own, body, np.zeros(body.skeleton.dof))
    return prepared, starts_in_frame(body, prepared, body.stature)[0].pose


def returned(
    person: HullPerson, own: Frame, people: Sequence[TrackedPerson], frame_rate: float
) -> tuple[TrackedPerson, Array] | None:
    """Find which of the people who are away is the person in the hull.

    The following is compared. Place: no person walks faster than SETTINGS.newcomer_walking from where they were last
    seen. Clothes, where pictures show them: not too different. Body: about as tall as the hull. Of several, the one
    whose clothes are most alike and whose body overlaps the masks best.
    Returns: the person and the pose (D,) now; None: none of them.
    """
    best: tuple[float, TrackedPerson, Array] | None = None
    for p in people:
        if p.member.sure:
            continue
        backwards = enumerate(zip(p.estimates[::-1], p.present[::-1], strict=True))
        seen = next(((estimate.pose, since) for since, (estimate, there) in backwards if there), None)
        if seen is not None:
            reach = SETTINGS.people_near_m + SETTINGS.newcomer_walking * max(1, seen[1]) / frame_rate
            if np.linalg.norm(seen[0][:2] - person.axis) > reach:
                continue
        with contextlib.suppress(EvidenceError):
            prepared, pose = found_again(p, own)
            known, seen_now = p.appearance, appearance_in(p.subject.body, pose, own)
            like = likeness(known.worn if known.met else known.worn + known.lately, seen_now)
            like = like if np.isfinite(like) else 1.0  # the clothes of one of them are not known
            score = mean_overlap(p.subject.body, pose, prepared) + like
            if like > SETTINGS.wardrobe_unlike and (best is None or score > best[0]):
                best = (score, p, pose)
    if best is None:
        return None
    higher = person.hull.height - best[1].subject.body.stature
    return (best[1], best[2]) if SETTINGS.newcomer_higher_m[0] < higher < SETTINGS.newcomer_higher_m[1] else None


def identity_switches(
    person: HullPerson, people: Sequence[TrackedPerson], frame_rate: float
) -> tuple[TrackedPerson, int] | None:
    """Find the tracked person who stood where a person is found now, but whose track then moved away faster than people
    walk.

    The track was drawn to a person who came near before that one was found.
    Returns: the person, and the frame from which the track is wrong; None: there is no such person.

    Why not solve the frame of the jump again instead: that only delays the jump by one frame (seed 451).
    """
    for q in people:
        if not q.member.sure:
            continue
        at = np.array([e.pose[:2] for e in q.estimates[-max(2, round(SETTINGS.newcomer_drawn_s * frame_rate)) :]])
        near = np.flatnonzero(np.linalg.norm(at - person.axis, axis=1) < SETTINGS.people_near_m / 2)
        frames = len(at) - 1 - near[-1] if len(near) else 0
        if frames and np.linalg.norm(at[-1] - at[near[-1]]) > max(
            SETTINGS.people_near_m, SETTINGS.newcomer_walking * frames / frame_rate
        ):
            return q, len(q.estimates) - int(frames)
    return None


def back_again(
    person: HullPerson, own: Frame, people: Sequence[TrackedPerson], frame_rate: float
) -> tuple[TrackedPerson, Array] | None:
    """Find the person who is back in the hull, and correct a track that was drawn away from there.

    Where another person's track was drawn away (`identity_switches`), that person is the result, and the frames since
    then are exchanged or marked.
    Returns: the person and the pose (D,) now; None: no known person.
    """
    back, drawn = returned(person, own, people, frame_rate), identity_switches(person, people, frame_rate)
    if drawn is None:
        return back
    who, since = drawn
    with contextlib.suppress(EvidenceError):
        pose = found_again(who, own)[1]
        if back is None:
            who.mark_mistaken(since, "because another person was found where they had stood")
        else:
            swap_identities(back[0], who, since, "because this one was found where the other had stood")
        return who, pose
    return back


def untracked_note(candidates: Sequence[Array]) -> tuple[str, ...]:
    """Return a sentence on people or objects to which no body could be fitted; none where there are none.

    candidates: as `TrackingSession.candidates` after the last frame.
    """
    at = ", ".join(f"[{c[0]:.1f}, {c[1]:.1f}]" for c in candidates if c[2] > 1)
    return (f"a person or an object at {at} m is not tracked, since no body could be fitted to it",) if at else ()
