"""What is doubtful about the newest frame: the covariance and the probability of every joint to be wrong, from the
frames of the last second or two."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.pipeline.doubts import as_now, looked_at, mask_change
from hypose.tracking.doubt import as_mixture, evidence_of, judged
from hypose.tracking.fitted_spread import beyond_usual, with_fitted_joints
from hypose.tracking.tracker import FrameEstimate, Tracker, motion_of

WINDOW_S, EVERY_S, AUDIT_HZ = 1.5, 0.2, 10.0
"""s that a frame is judged with, and between two looks at all of them; how many frames are audited. `hypose track` also
knows what comes after; live nobody does."""


class LiveDoubt:
    """Of one body: `told` of every frame what is known by then, and then `look` at it, in order. So a pose need not
    wait for what is found about it, which is told with the next."""

    def __init__(self) -> None:
        self._audited: deque[tuple[float, FrameEstimate]] = deque()
        self._before: Frame | None = None
        self._looked = -np.inf
        self._beyond = 0.0
        self._p: NDArray[np.float32] | None = None
        self._doubtful: NDArray[np.bool_] | None = None

    def told(self, tracker: Tracker, estimate: FrameEstimate, frame: Frame) -> Motion:
        """The estimate as a motion of one frame. Of who has just been found nothing is known but where they are: that
        is doubtful, as who is lost is."""
        now = motion_of(tracker.body, np.array([frame.time]), [estimate])
        count = now.joints.shape[:2]
        p, doubtful = self._p, self._doubtful
        if p is None or doubtful is None or estimate.lost:
            p = np.maximum(np.zeros(count, np.float32) if p is None else p, np.float32(0.5))
            doubtful = np.ones(count, np.bool_)
        now = with_fitted_joints(now, "silhouettes" if frame.depth is None else "depth", self._beyond)
        now = replace(now, p_wrong=p, doubtful_joints=doubtful)
        return as_mixture(now) if frame.depth is None else now  # regions of depth hold what is elsewhere, too

    def look(self, tracker: Tracker, estimate: FrameEstimate, frame: Frame, whole: Frame | None = None) -> None:
        """Audit the frame, if it is time for that, and judge it by those of the last seconds. whole: with everybody in
        it."""
        known = self._audited
        look = self._p is None or frame.time - self._looked > 0.95 * EVERY_S
        if look or frame.time - known[-1][0] > 0.95 / AUDIT_HZ:
            before = None if self._before is None else as_now(frame, self._before)
            whole = whole or frame
            change = mask_change(whole, self._before)
            known.append((frame.time, looked_at(tracker, estimate, frame, before, change)))
            self._before = whole
            while known[0][0] < frame.time - WINDOW_S:
                known.popleft()
        if look:
            self._looked = frame.time
            window = motion_of(tracker.body, np.array([t for t, _ in known]), [e for _, e in known])
            audits = np.stack([e.audit for _, e in known])
            p, joints = judged(window, window.joints, audits, known="depth" if frame.depth is not None else None)
            self._beyond = beyond_usual(audits, evidence_of(audits) if frame.depth is None else "depth")
            self._p, self._doubtful = p[-1:], joints[-1:]
