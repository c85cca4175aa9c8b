"""Follow where people stand in the visual hull, frame after frame, before they are tracked."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.people import HullPerson, Other, people_seen
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.trace import later, trace_of, with_trace
from hypose.pipeline.track_loop import FrameSource

if TYPE_CHECKING:
    from hypose.evidence.association import PersonTrack


@dataclass(eq=False)
class Path:
    """Path of a person in the hull over time.

    found: by frame number, the part of the hull that is this person.
    """

    found: dict[int, HullPerson] = field(default_factory=dict)

    @property
    def last(self) -> int:
        """Number of the last frame in which the person was found."""
        return max(self.found)

    @property
    def litres(self) -> float:
        """Median volume over the frames, litres."""
        return float(np.median([p.litres for p in self.found.values()]))

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
        if frame.silhouettes is None:
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
            if t - p.last <= max(SETTINGS.path_gone_s * frame_rate, 2 * max(np.diff([*numbers, t + 1])))
        ]
        taken: set[int] = set()
        if alive and here:
            away = np.array([[float(np.linalg.norm(p.expected(t) - h.axis)) for h in here] for p in alive])
            reach = np.array(
                [[SETTINGS.path_slack + SETTINGS.path_surprise * (t - p.last) / frame_rate] for p in alive]
            )
            for a, b in zip(*linear_sum_assignment(np.where(away < reach, away, 1e3)), strict=True):
                if away[a, b] < reach[a, 0]:
                    alive[a].found[t] = here[b]
                    taken.add(int(b))
        paths += [Path({t: h}) for k, h in enumerate(here) if k not in taken]
    return sorted(paths, key=lambda p: (-len(p.found), -p.litres))


def lasting(paths: Sequence[Path], looks: Sequence[int]) -> list[Path]:
    """Select the paths that are found in most of the frames `looks`."""
    return [p for p in paths if sum(t in p.found for t in looks) >= max(2, SETTINGS.path_seen_share * len(looks))]


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
        return self.place is not None and self.time < -SETTINGS.tracked_early_s

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
        free = [k for k in range(len(away)) if k not in taken and away[k] < SETTINGS.points_m]
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


class PointFrames:
    """Frames of a source in which one person's track lasts, with the key points of that person as the only evidence.

    track: number of the track in `points`.
    """

    def __init__(self, source: FrameSource, points: KeypointPeople, track: int) -> None:
        self._source, self._points, self._track = source, points, track
        self.first = points.tracks[track].first
        self._count = len(points.tracks[track])

    def __len__(self) -> int:
        return self._count

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, counted from the first frame of the track."""
        t = self.first + index
        return replace(self._source.frame(t), silhouettes=None, keypoints=self._points.of(self._track, t))


def padded(motion: Motion, first: int, total: int) -> Motion:
    """Extend a motion of the frames first, first + 1, ... to `total` frames: outside, its first and last frame are
    repeated and marked as lost and extrapolated.
    """
    rows = np.clip(np.arange(total) - first, 0, len(motion) - 1)
    outside = (np.arange(total) < first) | (np.arange(total) >= first + len(motion))
    arrays = per_frame(motion, rows) | {"times": np.arange(total) / motion.frame_rate}
    out = replace(motion, **arrays)
    out = replace(out, lost=out.lost | outside, extrapolated=out.extrapolated | outside)
    return with_trace(out, later(trace_of(motion), first))


def per_frame(motion: Motion, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Select frames of a motion.

    rows: their numbers, or a (T,) mask.
    Returns: by name of the field, the selected rows of each array that has one row per frame, for `replace`.
    """
    return {k: v[rows] for k, v in vars(motion).items() if isinstance(v, np.ndarray) and len(v) == len(motion)}
