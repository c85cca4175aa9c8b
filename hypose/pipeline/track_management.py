"""Manage people's tracks: find people whom no tracked body explains, who return, or who were exchanged."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.people import FEWEST_VIEWS, HullPerson, Other, own_frame, without
from hypose.geometry import Array
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import TrackedPerson
from hypose.tracking.appearance import appearance_in, no_appearance
from hypose.tracking.frame_evidence import PreparedFrame, mean_overlap, prepare
from hypose.tracking.several import shape_of
from hypose.tracking.start_search import start_from_hull
from hypose.tracking.tracker import FrameEstimate

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
        if frame.colours is None or p not in there:
            continue
        w, near = p.appearance, [q for q in there if q is not p and _apart(p, q) < SETTINGS.wardrobe_near_m]
        for q in near:
            _remember(p, q)
        if near:
            w.lately, w.looks = no_appearance(), 0
            continue
        w.lately, w.looks = w.lately + appearance_in(p.subject.body, p.estimates[-1].pose, frame), w.looks + 1
        if not w.met:
            w.settle()
    return _exchanged(there)


def _remember(p: TrackedPerson, q: TrackedPerson) -> None:
    """Record that two people met, and the frame in which they were nearest so far."""
    now, met = len(p.estimates) - 1, p.appearance.met
    if q.name not in met or _apart(p, q) <= _apart(p, q, met[q.name]):
        met[q.name] = now


def _exchanged(there: Sequence[TrackedPerson]) -> list[tuple[TrackedPerson, TrackedPerson, int]]:
    out = []
    for i, p in enumerate(there):
        a = p.appearance
        for q in there[:i]:
            b = q.appearance
            if min(a.looks, b.looks) < SETTINGS.wardrobe_looks or not (q.name in a.met and p.name in b.met):
                continue
            own = a.worn.likeness(a.lately) + b.worn.likeness(b.lately)
            other = a.worn.likeness(b.lately) + b.worn.likeness(a.lately)
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
    return [Other(p.member.shape(silhouettes.rig, p.estimates[-1].pose)) for p in people if p.member.sure]


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


def doubles(people: Sequence[Sequence[FrameEstimate]]) -> set[int]:
    """Find people who stay in one place with another person whose body explains the evidence better.

    people: latest estimates of each person, of the same frames where both have them; empty: the person is left out.
    Returns: their indices.
    """
    worse = set[int]()
    for i, a in enumerate(people):
        for j, b in enumerate(people[:i]):
            if not a or not b or worse & {i, j}:
                continue
            both = min(len(a), len(b))
            away = np.stack([e.pose[:3] for e in a[-both:]]) - np.stack([e.pose[:3] for e in b[-both:]])
            if (np.linalg.norm(away, axis=1) < SETTINGS.newcomer_one_place_m).all():
                costs = [np.mean([np.nan_to_num(e.cost, nan=1.0) for e in p]) for p in (a, b)]
                worse.add(i if costs[0] >= costs[1] else j)
    return worse


def part_doubles(people: Sequence[TrackedPerson], frames: int) -> None:
    """Mark the worse of two bodies as gone that stay in one place for so many frames."""
    known = [p.estimates[-frames:] if p.member.present and len(p.estimates) >= frames else () for p in people]
    for k in doubles(known):
        people[k].member = replace(people[k].member, present=False)


def without_doubles(people: Sequence[TrackedPerson], frame: Frame) -> dict[str, TrackedSubject]:
    """Remove people who are found twice at the start, where a hull falls into two parts.

    Of two people in one place, or side by side where one explains nothing of their own, the one stays whose body
    explains the masks better.
    Returns: subjects by name; the name is that of the first.
    """
    kept: dict[str, TrackedPerson] = {}
    for p in people:
        for name, q in kept.items():
            away, rest = _away(p, q), [o for o in people if o is not p and o is not q]
            alone = (
                min(_explains(a, [*rest, b], frame) for a, b in ((p, q), (q, p)))
                if away < SETTINGS.newcomer_reach
                else 1.0
            )
            if away < SETTINGS.newcomer_one_place_m or alone < SETTINGS.newcomer_nothing:
                kept[name] = max((q, p), key=lambda o, rest=rest: _explains(o, rest, frame))
                break
        else:
            kept[p.name] = p
    return {name: p.subject for name, p in kept.items()}


def _away(p: TrackedPerson, q: TrackedPerson) -> float:
    """Compute the distance between the roots of two people at their starts, m."""
    return float(np.linalg.norm(p.subject.start[:3] - q.subject.start[:3]))


def _explains(p: TrackedPerson, others: Sequence[TrackedPerson], frame: Frame) -> float:
    """Compute the mean IoU of a person at the start with what the others leave of the masks; 0 where
    that is nothing.
    """
    body, start, s = p.subject.body, p.subject.start, frame.silhouettes
    assert s is not None
    hide = [Other(shape_of(o.subject.body, o.subject.start, s.rig)) for o in others]
    prepared = prepare(own_frame(frame, shape_of(body, start, s.rig), hide), body, start)
    return mean_overlap(body, start, prepared)


def not_parts(found: Sequence[HullPerson], people: Sequence[TrackedPerson]) -> list[HullPerson]:
    """Leave out parts of the hull that may be a limb of a tracked person.

    found: possible people in the hull.
    people: tracked people.
    Returns: the tall ones, and the others that stand farther than SETTINGS.newcomer_reach from every tracked person
        whose place is known.
    """
    at = [p.estimates[-1].pose[:2] for p in people if p.member.sure]
    return [h for h in found if h.tall or all(np.linalg.norm(h.axis - q) > SETTINGS.newcomer_reach for q in at)]


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
    return prepared, start_from_hull(body, prepared).pose


def returned(
    person: HullPerson, own: Frame, people: Sequence[TrackedPerson], frame_rate: float
) -> tuple[TrackedPerson, Array] | None:
    """Find which of the people who are away is the person in the hull.

    The following is compared. Place: no person walks faster than SETTINGS.newcomer_walking from where they were last
    seen. Clothes, where pictures show them: not too different. Body: about as tall as the hull. Of several, the one
    whose clothes are most
            alike
            and whose body overlaps the masks best.
    Returns: the person and the pose (D,) now; None: none of them.
    """
    best: tuple[float, TrackedPerson, Array] | None = None
    for p in people:
        if p.member.sure:
            continue
        seen = p.last_seen
        if seen is not None:
            reach = SETTINGS.newcomer_reach + SETTINGS.newcomer_walking * max(1, seen[1]) / frame_rate
            if np.linalg.norm(seen[0][:2] - person.axis) > reach:
                continue
        with contextlib.suppress(EvidenceError):
            prepared, pose = found_again(p, own)
            known, seen_now = p.appearance, appearance_in(p.subject.body, pose, own)
            like = (known.worn if known.met else known.worn + known.lately).likeness(seen_now)
            like = like if np.isfinite(like) else 1.0  # the clothes of one of them are not known
            score = mean_overlap(p.subject.body, pose, prepared) + like
            if like > SETTINGS.wardrobe_unlike and (best is None or score > best[0]):
                best = (score, p, pose)
    if best is None:
        return None
    higher = person.hull.height - best[1].subject.body.stature
    return (best[1], best[2]) if -SETTINGS.newcomer_shorter_m < higher < SETTINGS.newcomer_taller_m else None


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
        near = np.flatnonzero(np.linalg.norm(at - person.axis, axis=1) < SETTINGS.newcomer_reach / 2)
        frames = len(at) - 1 - near[-1] if len(near) else 0
        if frames and np.linalg.norm(at[-1] - at[near[-1]]) > max(
            SETTINGS.newcomer_reach, SETTINGS.newcomer_walking * frames / frame_rate
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
