"""Bodies of people in each other's masks, fitted once more when everybody's body is known.

The first fit of each sees the others as hulls, or as bodies of the template's shape, and what these hide too much or
too little becomes arms and legs that are too long or too short. So everybody is tracked together through the same
frames, there and back, and each body is fitted to what the fitted bodies of the others leave of the masks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.anthropometry import prior_mean
from hypose.body.body import Body
from hypose.body.ready_bodies import human
from hypose.errors import HyposeError
from hypose.evidence.depth_people import own_frame
from hypose.evidence.frame import Frame
from hypose.evidence.shared_masks import SOLVED, Other
from hypose.fitting.articulated import SolveSettings
from hypose.geometry import Array
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.rough_bodies import seen_well
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject_from_motion import contours_of, depths_of, different_poses
from hypose.pipeline.tracked_people import Followed, Wanted
from hypose.tracking.costs import mean_overlap
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.refinement import refine
from hypose.tracking.several import shape_of, step_together, visible_share
from hypose.tracking.shape_refinement import Known, refine_shape
from hypose.tracking.tracker import FrameEstimate

AGAIN = "the body was fitted again beside those of the others"
_Trial = dict[int, tuple[FrameEstimate, NDArray[np.float64]]]
"""By frame number, somebody's estimate and how much of them each view (C,) shows."""


def fitted_again(
    people: Sequence[Followed],
    frame_at: Callable[[int], Frame],
    numbers: Sequence[int],
    known: Callable[[str], Wanted],
) -> dict[int, TrackedSubject]:
    """Of people who stand at their starts in the first of the frames `numbers`: the subjects of those whose bodies were
    fitted to shared masks once, by their place among the people, with bodies and starts fitted again; as they were but
    for a note where that explains the masks no better. known: what is known of somebody of that name."""
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
                    ways[-1][k][t] = estimate, visible_share(own)
    found = [_put_right(there, back, numbers) for there, back in zip(*ways, strict=True)]

    def own_at(who: int, t: int) -> Frame:
        frame = frame_at(t)
        assert frame.silhouettes is not None
        rig = frame.silhouettes.rig
        shapes = {k: shape_of(p.subject.body, found[k][t][0].pose, rig) for k, p in enumerate(people) if t in found[k]}
        return own_frame(frame, shapes[who], [Other(s, SOLVED) for k, s in shapes.items() if k != who])

    return {
        k: _again(people[k].subject, found[k], own_at, k, known(people[k].name).height)
        for k in once
        if numbers[0] in found[k]
    }


def _put_right(there: _Trial, back: _Trial, numbers: Sequence[int]) -> _Trial:
    """The way there, with the first frames of the way back as far as most is won, if enough is: a limb that the start
    got wrong is found on the way, and known from there on back."""
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
    """One of them, the person `who`, on their way, whose first frame is that of the start."""
    template, noted = human(), replace(subject, notes=(*subject.notes, AGAIN))
    seen = seen_well({t: shown for t, (_, shown) in way.items()})
    poses, iou = np.stack([way[t][0].pose for t in seen]), np.array([1 - way[t][0].cost for t in seen])
    chosen = different_poses(subject.body, poses, iou, SETTINGS.again_poses)
    frames, every = [own_at(who, seen[k]) for k in chosen], range(len(chosen))
    x = prior_mean()
    x[0] = np.log(subject.body.stature / template.stature)
    try:
        contours, depths = contours_of(frames, every), depths_of(frames, every)
        fit = refine_shape(template, poses[chosen], contours, known=Known(height), start=x, depths=depths)
    except HyposeError:
        return noted
    if _overlap(fit.body, fit.poses, frames) <= _overlap(subject.body, poses[chosen], frames):
        return noted
    first = min(way)
    begin, pose = own_at(who, first), way[first][0].pose
    start = refine(fit.body, pose[None], prepare(begin, fit.body, pose), SolveSettings())[0].pose
    return replace(noted, body=fit.body, start=start)


def _overlap(body: Body, poses: Array, frames: Sequence[Frame]) -> float:
    """Mean IoU of a body with frames in which it stands in poses (F, D)."""
    return float(np.mean([mean_overlap(body, q, prepare(f, body, q)) for q, f in zip(poses, frames, strict=True)]))
