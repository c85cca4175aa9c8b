"""Who is who after people were near each other, or away, by the clothes that they wore before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hypose.evidence.frame import Frame
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.tracked_people import Followed
from hypose.tracking.appearance import Clothes, clothes_in, nothing_seen


def _apart(a: Followed, b: Followed, t: int = -1) -> float:
    return float(np.linalg.norm(a.estimates[t].pose[:2] - b.estimates[t].pose[:2]))


def look_at_clothes(people: Sequence[Followed], seen: Sequence[Frame]) -> list[tuple[Followed, Followed, int]]:
    """Looks at everybody in a frame that has just been tracked; seen: as each saw it. Returns who has been exchanged
    with whom, and from which frame on."""
    there = [p for p in people if p.member.sure]
    for p, frame in zip(people, seen, strict=True):
        if frame.colours is None or p not in there:
            continue
        w, near = p.wardrobe, [q for q in there if q is not p and _apart(p, q) < SETTINGS.wardrobe_near_m]
        for q in near:
            _remember(p, q)
        if near:
            w.lately, w.looks = nothing_seen(), 0
            continue
        w.lately, w.looks = w.lately + clothes_in(p.subject.body, p.estimates[-1].pose, frame), w.looks + 1
        if not w.met:
            w.settle()
    return _exchanged(there)


def _remember(p: Followed, q: Followed) -> None:
    """That they have met, and where they were nearest so far."""
    now, met = len(p.estimates) - 1, p.wardrobe.met
    if q.name not in met or _apart(p, q) <= _apart(p, q, met[q.name]):
        met[q.name] = now


def _exchanged(there: Sequence[Followed]) -> list[tuple[Followed, Followed, int]]:
    out = []
    for i, p in enumerate(there):
        a = p.wardrobe
        for q in there[:i]:
            b = q.wardrobe
            if min(a.looks, b.looks) < SETTINGS.wardrobe_looks or not (q.name in a.met and p.name in b.met):
                continue
            own = a.worn.likeness(a.lately) + b.worn.likeness(b.lately)
            other = a.worn.likeness(b.lately) + b.worn.likeness(a.lately)
            if other > own + SETTINGS.wardrobe_clearly:  # not where one of them has not been seen
                out.append((p, q, min(a.met[q.name], b.met[p.name])))
                a.lately, b.lately = b.lately, a.lately
            del a.met[q.name], b.met[p.name]
    for p in there:  # whom they met and who has left since
        names = {q.name for q in there}
        w = p.wardrobe
        if w.looks >= SETTINGS.wardrobe_looks and not names & set(w.met):
            w.settle()
    return out


def exchange(p: Followed, q: Followed, since: int, told: str = "as their clothes told afterwards") -> None:
    """Each goes on as the other, from a frame on; what was estimated since then is the other's, and doubtful. told: by
    what, in words."""
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
        one.said.append(f"taken for {other.name} from frame {since} to {now - 1}, {told}")


def same_clothes(p: Followed, seen: Clothes) -> float:
    """Likeness of somebody who comes with one who is away; 1 where nothing is known of either."""
    like = (p.wardrobe.worn + p.wardrobe.lately if not p.wardrobe.met else p.wardrobe.worn).likeness(seen)
    return like if np.isfinite(like) else 1.0
