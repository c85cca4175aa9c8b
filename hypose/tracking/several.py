"""Track several people in the same frames, each with an own tracker: body, recipe, covariance, hypotheses.

Pixels that other people's bodies cover are no evidence for a person (`hypose.evidence.people`). Within a frame
people are solved one after the other, and the first one alternates: it sees the others where they are predicted, the
last one where they have been solved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.people import PREDICTED_WIDENING, SOLVED_WIDENING, BodyShape, Other, own_frame
from hypose.evidence.prefetch import pack_once
from hypose.geometry import Array
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState

BLIND = 2
"""Frames without evidence after which a person is searched for beyond the predicted place."""


@dataclass(frozen=True)
class Member:
    """One of several tracked people.

    tracker: how the person is tracked; state: after the last frame.
    present: false for a person who has left or has not come yet; such a person hides no other and is not searched for.
    """

    tracker: Tracker
    state: TrackerState
    present: bool = True

    @property
    def sure(self) -> bool:
        """Whether the tracker knows where the person is: present and not lost."""
        return self.present and not self.state.lost and self.state.blind <= BLIND

    def shape(self, rig: CameraRig, pose: Array) -> BodyShape:
        """Build the person's body at a pose (D,) as the cameras see it."""
        return shape_of(self.tracker.body, pose, rig)


def shape_of(body: Body, pose: Array, rig: CameraRig) -> BodyShape:
    """Build a body at a pose (D,) as pinhole cameras see it."""
    return BodyShape(body.skin(pose), body.coarse.faces, rig)


def step_together(
    members: Sequence[Member],
    frame: Frame,
    keypoints: Sequence[Keypoints | None] = (),
    others: Sequence[Other] = (),
    alone: bool = False,
) -> tuple[list[Member], list[FrameEstimate], list[Frame]]:
    """Track all people in one frame.

    keypoints: key points of each person, already assigned; empty: the frame's key points are not used.
    others: further people who are there but not tracked.
    alone: there is one person, to whom all evidence of the frame belongs, key points too.
    Returns: the next members, their estimates, and the frame as each person saw it, without what others hide.
    """
    if alone:
        steps = [m.tracker.step(m.state, frame) for m in members]
        after = [replace(m, state=state) for m, (state, _) in zip(members, steps, strict=True)]
        return after, [estimate for _, estimate in steps], [frame] * len(members)
    count, after = len(members), list(members)
    estimates, seen = dict[int, FrameEstimate](), [frame] * count
    expected = [m.tracker.predicted(m.state) if m.present else m.state.pose for m in members]
    rigs = [s.rig for s in frame.of(Silhouettes)]
    shapes = [m.shape(rig, q) for rig in rigs for m, q in zip(members, expected, strict=True)]
    done = np.zeros(count, dtype=np.bool_)
    for i in ((frame.index + k) % max(count, 1) for k in range(count)):
        m = after[i]
        own = replace(frame, keypoints=keypoints[i] if keypoints else None)
        own = own if m.present else own.unseen()
        for _ in rigs if m.present else ():
            nearby = [
                Other(shapes[j], SOLVED_WIDENING if done[j] else PREDICTED_WIDENING)
                for j in range(count)
                if j != i and after[j].sure
            ]
            lost = m.state.lost or m.state.blind > BLIND
            own = own_frame(own, shapes[i], [*others, *nearby], anywhere=lost)
            pack_once(own.the(Silhouettes))  # the tracker and the later audit both use them
        state, estimates[i] = m.tracker.step(m.state, own)
        after[i], seen[i], done[i] = replace(m, state=state), own, True
        for rig in rigs if not done.all() else ():
            shapes[i] = after[i].shape(rig, estimates[i].pose)
    return after, [estimates[i] for i in range(count)], seen
