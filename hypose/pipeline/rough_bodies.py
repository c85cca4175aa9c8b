"""Bodies, roughly, of people who are in each other's masks, so that each can be fitted to what the others leave.

Hulls of people near each other run together: what of them hides somebody is a guess, and it is the arms and feet that
tell front from back. So everybody is first tracked by the template in their size, on what the hulls leave, and then
looked for again on what the others' bodies leave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError
from hypose.evidence import depth_people
from hypose.evidence.frame import Frame
from hypose.evidence.hull_people import HullPerson
from hypose.evidence.shared_masks import Other
from hypose.geometry import Array
from hypose.pipeline.hull_paths import Path
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.start_choice import best_ways, way_of
from hypose.tracking.several import nobody_in, shape_of, visible_share
from hypose.tracking.start_search import Start


@dataclass(frozen=True)
class RoughTrack:
    """Somebody, roughly: the body, and their poses (D,) by frame number; rivals: other starts, with their frames'
    numbers."""

    body: Body
    poses: Mapping[int, Array]
    rivals: tuple[tuple[int, Start], ...] = ()

    def other(self, number: int, rig: CameraRig) -> Other | None:
        """What of the views they hide in a frame; None when they are not known there."""
        pose = self.poses.get(number)
        return None if pose is None else Other(shape_of(self.body, pose, rig), SETTINGS.path_others_widened)

    def starts(self, numbers: Sequence[int]) -> tuple[tuple[int, Start], ...]:
        """Where they are in the first of the frames `numbers`, and the rivals, each with its place among these."""
        first = Start(self.body, self.poses[numbers[0]], np.inf)
        near = [(int(np.abs(np.array(numbers) - t).argmin()), s) for t, s in self.rivals]
        return (0, first), *near


def frame_of_person(
    frame: Frame, number: int, who: int, paths: Sequence[Path], rough: Sequence[RoughTrack | None] | None = None
) -> Frame:
    """Frame `number` as evidence for one of the people on paths alone; what the others hide, by their rough bodies
    where these are known, else by their hulls, is left out."""
    s = frame.silhouettes
    if s is None:
        return frame
    here = paths[who].found.get(number)
    if here is None:
        return nobody_in(frame)
    others = [
        other
        for k, p in enumerate(paths)
        if k != who and (other := _hiding(None if rough is None else rough[k], p.found.get(number), number, s.rig))
    ]
    return depth_people.own_frame(frame, here.shape(s.rig), others)


def _hiding(rough: RoughTrack | None, hull: HullPerson | None, number: int, rig: CameraRig) -> Other | None:
    known = None if rough is None else rough.other(number, rig)
    return known or (
        None if hull is None else Other(hull.shape(rig, SETTINGS.path_core_m), SETTINGS.path_others_widened)
    )


def least_hidden(own: Mapping[int, Frame]) -> list[int]:
    """In which of the frames a person is seen well, by all views but one; those least hidden, when they are few."""
    return seen_well({t: visible_share(frame) for t, frame in own.items()})


def seen_well(shares: Mapping[int, NDArray[np.float64]]) -> list[int]:
    """The same, by how much of the person each view shows in each of the frames (C,)."""
    numbers = sorted(shares)
    share = np.array([np.sort(shares[t]) for t in numbers])
    if not share.size:
        return numbers
    good = np.flatnonzero(share[:, min(1, share.shape[1] - 1)] > SETTINGS.rough_hidden)
    if len(good) < SETTINGS.rough_few_seen:
        good = np.sort(np.argsort(-share.sum(1), kind="stable")[: SETTINGS.rough_few_seen])
    return [numbers[k] for k in good]


def rough_bodies(
    frame_at: Callable[[int], Frame],
    numbers: Sequence[int],
    paths: Sequence[Path],
    rate: float,
    templates: Sequence[tuple[Body, float | None]],
    seed: int = 0,
) -> list[RoughTrack | None]:
    """Everybody on paths in the frames `numbers`, at `rate` Hz; None for whom no start explains. templates: of each,
    with the height, m, where it is known."""
    return [
        _rough(frame_at, [t for t in numbers if t in p.found], k, paths, rate, *templates[k], seed)
        for k, p in enumerate(paths)
    ]


def _rough(
    frame_at: Callable[[int], Frame],
    numbers: Sequence[int],
    who: int,
    paths: Sequence[Path],
    rate: float,
    template: Body,
    height: float | None,
    seed: int,
) -> RoughTrack | None:
    own = {t: frame_of_person(frame_at(t), t, who, paths) for t in numbers}
    seen = least_hidden(own)[: SETTINGS.rough_tried]
    try:
        found = best_ways(template, [own[t] for t in seen], rate, height=height, seed=seed, shared=len(paths) > 1)
    except HyposeError:
        return None
    start, at = found.starts.best, found.at
    if found.ways:  # a start that is wrong at first is put right on its way: it is gone again from where it fits best
        costs = found.ways[0].costs
        at = int(np.where(np.isfinite(costs), costs, np.inf).argmin())
        start = replace(start, pose=found.ways[0].poses[at])
    way = way_of(start, numbers.index(seen[at]), [own[t] for t in numbers], rate, seed)
    if way is None or way.cost > SETTINGS.rough_lost:
        return None
    rivals = tuple((seen[w.at], w.start) for w in found.ways[1 : 1 + SETTINGS.rough_rivals])
    return RoughTrack(start.body, dict(zip(numbers, way.poses, strict=True)), rivals)
