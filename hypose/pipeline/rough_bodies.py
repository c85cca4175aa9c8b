"""Track people roughly who hide each other in the masks, so that each body can then be fitted to what the others leave.

Hulls of people near each other merge, so which part hides a person is a guess, and only arms and feet show front and
back. So each person is first tracked with the template, scaled to their size, on what the others' hulls leave. Then
bodies are fitted on what the others' rough bodies leave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.anthropometry import prior_mean
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError
from hypose.evidence import depth_people
from hypose.evidence.cues import surface_evidence
from hypose.evidence.depth_people import own_frame
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.hull_people import HullPerson
from hypose.evidence.shared_masks import SOLVED_WIDENING, Other
from hypose.fitting.articulated import SolveSettings
from hypose.geometry import Array
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.person_paths import Path, Wanted
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.start_choice import best_ways, way_of
from hypose.pipeline.subject_from_motion import different_poses
from hypose.pipeline.track_loop import Followed
from hypose.tracking.frame_evidence import mean_overlap, prepare
from hypose.tracking.refinement import refine
from hypose.tracking.several import shape_of, step_together
from hypose.tracking.shape_refinement import Known, refine_shape
from hypose.tracking.start_search import Start
from hypose.tracking.tracker import FrameEstimate


@dataclass(frozen=True)
class RoughTrack:
    """Rough track of one person.

    body: body that was used.
    poses: (D,) by frame number.
    rivals: other possible starts with their frame numbers.
    """

    body: Body
    poses: Mapping[int, Array]
    rivals: tuple[tuple[int, Start], ...] = ()

    def other(self, number: int, rig: CameraRig) -> Other | None:
        """Return what this person hides from the views in a frame; None where the pose is not known."""
        pose = self.poses.get(number)
        return None if pose is None else Other(shape_of(self.body, pose, rig), SETTINGS.path_others_widened)

    def starts(self, numbers: Sequence[int]) -> tuple[tuple[int, Start], ...]:
        """Return the start in the first of the frames `numbers` and the rivals, each with an index into `numbers`."""
        first = Start(self.body, self.poses[numbers[0]], np.inf)
        near = [(int(np.abs(np.array(numbers) - t).argmin()), s) for t, s in self.rivals]
        return (0, first), *near


def frame_of_person(
    frame: Frame, number: int, who: int, paths: Sequence[Path], rough: Sequence[RoughTrack | None] | None = None
) -> Frame:
    """Return frame `number` as evidence for one of the people on paths; what the others hide is left out.

    The others are known by their rough bodies, else by their hulls.
    """
    s = frame.silhouettes
    if s is None:
        return frame
    here = paths[who].found.get(number)
    if here is None:
        return frame.unseen()
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


def least_hidden(shares: Mapping[int, NDArray[np.float64]]) -> list[int]:
    """Select the frames in which all views but one see a person well; where these are few, the least hidden ones.

    shares: by frame number, the visible share of the person in each view (C,).
    """
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
    """Track all people on paths roughly through the frames `numbers`.

    rate: of these frames, Hz.
    templates: per person the template, and the height (m) where known.
    Returns: one track per person; None where no start explains the masks.
    """
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
    seen = least_hidden({t: frame.visible_share for t, frame in own.items()})[: SETTINGS.rough_tried]
    try:
        found = best_ways(template, [own[t] for t in seen], rate, height=height, seed=seed, shared=len(paths) > 1)
    except HyposeError:
        return None
    start, at = found.starts.best, found.at
    if found.ways:  # tracking corrects a wrong start: track again from the frame that fits best
        costs = found.ways[0].costs
        at = int(np.where(np.isfinite(costs), costs, np.inf).argmin())
        start = replace(start, pose=found.ways[0].poses[at])
    way = way_of(start, numbers.index(seen[at]), [own[t] for t in numbers], rate, seed)
    if way is None or way.cost > SETTINGS.rough_lost:
        return None
    rivals = tuple((seen[w.at], w.start) for w in found.ways[1 : 1 + SETTINGS.rough_rivals])
    return RoughTrack(start.body, dict(zip(numbers, way.poses, strict=True)), rivals)


# ---- bodies again --------------------------------------------------------------------------------------------------
# Fit bodies of people in shared masks again when the bodies of all people are known.
#
# In the first fit the others are hulls, or bodies of the template's shape; where these hide too much or too little,
# arms and legs become too long or too short. So all people are tracked together through the same frames, forwards and
# backwards, and each body is fitted to what the fitted bodies of the others leave of the masks.


AGAIN = "the body was fitted again when the bodies of the others were known"
_Trial = dict[int, tuple[FrameEstimate, NDArray[np.float64]]]
"""By frame number, a person's estimate and the visible share of the person in each view (C,)."""


def fitted_again(
    people: Sequence[Followed],
    frame_at: Callable[[int], Frame],
    numbers: Sequence[int],
    known: Callable[[str], Wanted],
) -> dict[int, TrackedSubject]:
    """Fit bodies again that were fitted once to shared masks, now that the bodies of all people are known.

    people: at their starts in the first of the frames `numbers`.
    known: gives the prior knowledge of a person by name.
    Returns: by index of the person, the subject with new body and start; where that explains the masks no better, the
        old subject with a note.
    """
    once = [k for k, p in enumerate(people) if known(p.name).body is None and AGAIN not in p.subject.notes]
    if len(people) < 2 or not once:
        return {}
    members, ways = [p.member for p in people], list[list[_Trial]]()
    for order in (numbers, numbers[::-1]):
        members = [replace(m, state=m.tracker.start(m.state.pose)) for m in members]
        ways.append([{} for _ in people])
        for t in order:
            members, estimates, seen = step_together(members, frame_at(t))
            for k, (estimate, own) in enumerate(zip(estimates, seen, strict=True)):
                if not estimate.lost and np.isfinite(estimate.cost):
                    ways[-1][k][t] = estimate, own.visible_share
    found = [_put_right(there, back, numbers) for there, back in zip(*ways, strict=True)]

    def own_at(who: int, t: int) -> Frame:
        frame = frame_at(t)
        rig = frame.the(Silhouettes).rig
        shapes = {k: shape_of(p.subject.body, found[k][t][0].pose, rig) for k, p in enumerate(people) if t in found[k]}
        return own_frame(frame, shapes[who], [Other(s, SOLVED_WIDENING) for k, s in shapes.items() if k != who])

    return {
        k: _again(people[k].subject, found[k], own_at, k, known(people[k].name).height)
        for k in once
        if numbers[0] in found[k]
    }


def _put_right(there: _Trial, back: _Trial, numbers: Sequence[int]) -> _Trial:
    """Replace the first frames of the forward track by the backward track where that costs clearly less. Why: a limb
    that the start got wrong is found later, and known from there backwards.
    """
    both = [t in there and t in back for t in numbers]
    won = np.cumsum([there[t][0].cost - back[t][0].cost if b else 0.0 for t, b in zip(numbers, both, strict=True)])
    best = int(won.argmax())
    if won[best] < SETTINGS.again_least_won:
        return there
    return there | {t: back[t] for t in numbers[: best + 1] if t in back}


def _again(
    subject: TrackedSubject,
    way: _Trial,
    own_at: Callable[[int, int], Frame],
    who: int,
    height: float | None,
) -> TrackedSubject:
    """Fit one person's body again on their track, whose first frame is that of the start."""
    template, noted = human(), replace(subject, notes=(*subject.notes, AGAIN))
    seen = least_hidden({t: shown for t, (_, shown) in way.items()})
    poses, iou = np.stack([way[t][0].pose for t in seen]), np.array([1 - way[t][0].cost for t in seen])
    chosen = different_poses(subject.body, poses, iou, SETTINGS.again_poses)
    frames = [own_at(who, seen[k]) for k in chosen]
    x = prior_mean()
    x[0] = np.log(subject.body.stature / template.stature)
    try:
        outlines = [surface_evidence(frame) for frame in frames]
        fit = refine_shape(template, poses[chosen], outlines, known=Known(height), start=x)
    except HyposeError:
        return noted
    if _overlap(fit.body, fit.poses, frames) <= _overlap(subject.body, poses[chosen], frames):
        return noted
    first = min(way)
    begin, pose = own_at(who, first), way[first][0].pose
    start = refine(fit.body, pose[None], prepare(begin, fit.body, pose), SolveSettings())[0].pose
    return replace(noted, body=fit.body, start=start)


def _overlap(body: Body, poses: Array, frames: Sequence[Frame]) -> float:
    """Compute the mean IoU of a body in poses (F, D) with the masks of the frames."""
    return float(np.mean([mean_overlap(body, q, prepare(f, body, q)) for q, f in zip(poses, frames, strict=True)]))
