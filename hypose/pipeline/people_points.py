"""Several people by their key points, which have been told apart (hypose.evidence.association)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.person_tracks import PersonTrack
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import FrameSource


@dataclass(frozen=True)
class KeypointPeople:
    """tracks: the people; names: of the K points; rig: the pinhole cameras of their pixels."""

    tracks: Sequence[PersonTrack]
    names: tuple[str, ...]
    rig: CameraRig

    @property
    def nothing(self) -> Keypoints:
        """Of nobody."""
        return Keypoints(np.zeros((len(self.rig), len(self.names), 3)), self.names, self.rig)

    def lasting(self, total: int) -> list[int]:
        """Who is followed through a good part of so many frames; whoever is followed longest at least."""
        long = [k for k, t in enumerate(self.tracks) if len(t) >= max(5, SETTINGS.points_least_share * total)]
        return long or sorted(range(len(self.tracks)), key=lambda k: -len(self.tracks[k]))[:1]

    def at(
        self, frame: int, place: Array, taken: Sequence[int], so_far: int | None = None
    ) -> tuple[int, Keypoints] | None:
        """Whose key points (the number of a track) are those of somebody at a place (2,) m, and these: of the one
        `so_far`, while that is followed, else of the nearest who is not taken; None when there is nobody."""
        away = [float(np.linalg.norm(t.place(frame)[:2] - place)) for t in self.tracks]
        free = [k for k in range(len(away)) if k not in taken and away[k] < SETTINGS.points_m]
        if not free:
            return None
        best = so_far if so_far in free else min(free, key=lambda k: away[k])
        assert best is not None
        return best, self.of(best, frame)

    def of(self, track: int, frame: int) -> Keypoints:
        """Those of one track at a frame of the clip."""
        t = self.tracks[track]
        if not 0 <= frame - t.first < len(t):
            return self.nothing
        return replace(self.nothing, points=t.points[frame - t.first, ..., :3].copy())


class PointFrames:
    """The frames of a source in which one person is followed, with their key points and nothing else."""

    def __init__(self, source: FrameSource, points: KeypointPeople, track: int) -> None:
        self._source, self._points, self._track = source, points, track
        self.first = points.tracks[track].first
        self._count = len(points.tracks[track])

    def __len__(self) -> int:
        return self._count

    def frame(self, index: int, /) -> Frame:
        """Frame number index from the first on."""
        t = self.first + index
        return replace(self._source.frame(t), silhouettes=None, keypoints=self._points.of(self._track, t))


def padded(motion: Motion, first: int, total: int) -> Motion:
    """The motion of frames first, first + 1, ... of so many: what lies beside them is its first and last frame, lost
    and extrapolated."""
    rows = np.clip(np.arange(total) - first, 0, len(motion) - 1)
    outside = (np.arange(total) < first) | (np.arange(total) >= first + len(motion))
    arrays = per_frame(motion, rows) | {"times": np.arange(total) / motion.frame_rate}
    out = replace(motion, **arrays)
    return replace(out, lost=out.lost | outside, extrapolated=out.extrapolated | outside)


def per_frame(motion: Motion, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Everything that a motion has of each frame, of some rows of it."""
    return {k: v[rows] for k, v in vars(motion).items() if isinstance(v, np.ndarray) and len(v) == len(motion)}
