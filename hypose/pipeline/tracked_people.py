"""Data of several people of one recording: prior knowledge, the state during tracking, and the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.evidence import depth_people
from hypose.evidence.frame import Frame
from hypose.evidence.shared_masks import SOLVED_WIDENING, Other
from hypose.geometry import Array
from hypose.pipeline.assessment import Assessment, assess
from hypose.pipeline.person_paths import KeypointPeople, per_frame
from hypose.pipeline.run import TrackResult
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import Followed, FrameSource
from hypose.tracking.contacts import runs
from hypose.tracking.several import shape_of
from hypose.tracking.tracker import FrameEstimate


@dataclass(frozen=True)
class Wanted:
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
        return f"nobody was found who is {self.name}{where}"


@dataclass(frozen=True)
class TrackedPerson:
    """Result of one person.

    name: of the person.
    result: motion and body.
    present: (T,) frames in which the person is there; in the others the motion is filled and marked as lost.
    hidden: (T,) frames in which others hide the person from all views but one.
    """

    name: str
    result: TrackResult
    present: NDArray[np.bool_]
    hidden: NDArray[np.bool_]

    @property
    def assessment(self) -> Assessment:
        """Assessment of the frames in which the person is there; frames are numbered as in the recording."""
        found = assess(while_present(self.result.motion, self.present), self.result.findings)
        at = np.flatnonzero(self.present)
        if self.present.all() or not len(at):
            return found
        marked = np.zeros(len(self.present), dtype=np.bool_)
        for frames in found.frames:
            marked[at[frames.start : frames.stop]] = True
        return replace(found, frames=tuple(runs(marked)))


@dataclass(frozen=True)
class PeopleResult:
    """Results of all people.

    people: in the order in which they were found.
    complete: all frames were tracked.
    notes: for the report.
    others: number of people in addition to those requested.
    """

    people: tuple[TrackedPerson, ...]
    complete: bool
    notes: tuple[str, ...] = ()
    others: int = 0


def while_present(motion: Motion, present: NDArray[np.bool_]) -> Motion:
    """Select the frames of a motion in which the person is there."""
    if present.all() or not present.any():
        return motion
    return replace(motion, **per_frame(motion, np.flatnonzero(present)))


def said_of(people: Sequence[TrackedPerson], frame_rate: float) -> tuple[str, ...]:
    """Return sentences on who was there, and when."""
    said = [f"{len(people)} {'people' if len(people) != 1 else 'person'}: {', '.join(p.name for p in people)}"]
    for p in people:
        if not p.present.all() and p.present.any():
            at = np.flatnonzero(p.present)
            said.append(f"{p.name} is there from {at[0] / frame_rate:.1f} to {(at[-1] + 1) / frame_rate:.1f} s")
    return tuple(said)


def said_of_places(wanted: Sequence[Wanted], count: int) -> tuple[str, ...]:
    """Return a sentence on people whose given places are too early to identify them among `count` people; none where
    all are usable.
    """
    early = [w for w in wanted if w.early]
    if not early or count < 2:
        return ()
    of = ", ".join(f"{w.name} {-w.time:.1f} s" for w in early)
    return (
        f"places of before the frames that are tracked ({of}) do not tell who is who there: give a place and time "
        "within them in recording.toml",
    )


def names_at_places(
    wanted: Sequence[Wanted], count: int, place: Callable[[int, int], Array], frame_rate: float
) -> list[str | None]:
    """Assign the names of wanted people to people who were found.

    count: number of people found.
    place: place(k, frame) gives where (2,) m the k-th stands, NaN where not known.
    frame_rate: Hz.
    Returns: name per person, None for others. Wanted people without a usable place get the remaining people in their
        order.
    """
    names: list[str | None] = [None] * count
    for one in wanted:
        if one.place is not None and not one.early:
            t = max(0, round(one.time * frame_rate))
            away = [float(np.linalg.norm(place(k, t) - np.array(one.place))) for k in range(count)]
            free = [k for k in range(count) if names[k] is None and away[k] < SETTINGS.tracked_placed_m]
            if free:
                names[min(free, key=lambda k: away[k])] = one.name
    rest = [one.name for one in wanted if one.place is None or one.early]
    for k in range(count):
        if names[k] is None and rest:
            names[k] = rest.pop(0)
    return names


def free_name(taken: Sequence[str], wanted: Sequence[Wanted]) -> str:
    """Return an unused name for a person about whom nothing is known."""
    used = {*taken, *(w.name for w in wanted)}
    return next(n for n in (f"person-{k}" for k in range(1, 10_000)) if n not in used)


def makes_room(count: int | None, name: str | None, people: Sequence[Followed], wanted: Sequence[Wanted]) -> bool:
    """Return whether the result of a new person is wanted.

    count: most results; None: all.
    name: of the new person where that one is in `wanted`. A wanted person replaces another who is not wanted.
    """
    if count is None or len(people) < count:
        return True
    names = {w.name for w in wanted}
    others = [p for p in people if p.asked_for and p.name not in names]
    if name is None or not others:
        return False
    others[-1].asked_for = False
    return True


def seen_by_themselves(p: Followed, people: Sequence[Followed], late: int) -> list[FrameEstimate]:
    """Return a person's estimates without mask changes that come from other people. Why: where a person comes or
    leaves, masks change suddenly, although time did not jump.

    late: frames within which a person who comes is found.
    """
    comes = np.zeros(len(p.estimates), dtype=np.bool_)
    for q in people:
        for t in (np.flatnonzero(np.diff(np.array(q.present, dtype=np.int8))) + 1).tolist():
            comes[max(0, t - late) : t + 2] = True
    out = list(p.estimates)
    for t in np.flatnonzero(comes).tolist():
        if len(out[t].seen):
            seen = out[t].seen.copy()
            seen[:, 1] = np.nan
            out[t] = replace(out[t], seen=seen)
    return out


class OwnFrames:
    """Frames of a source as evidence for one of the people, after all have been tracked: what the others hide is left
    out.
    """

    def __init__(
        self, source: FrameSource, who: Followed, people: Sequence[Followed], points: KeypointPeople | None
    ) -> None:
        self._source, self._who, self._people, self._points = source, who, people, points

    def __len__(self) -> int:
        return len(self._who.estimates)

    def frame(self, index: int, /) -> Frame:
        """Return frame number index with the silhouettes, and key points, of this person."""
        frame, who = replace(self._source.frame(index), keypoints=None), self._who
        s = frame.silhouettes
        if self._points is not None:
            found = self._points.at(index, who.estimates[index].pose[:2], (), who.track)
            frame = replace(frame, keypoints=self._points.nothing if found is None else found[1])
        if s is None:
            return frame
        if not self._who.present[index]:
            return frame.unseen()
        own = shape_of(self._who.subject.body, self._who.estimates[index].pose, s.rig)
        others = [
            Other(shape_of(p.subject.body, p.estimates[index].pose, s.rig), SOLVED_WIDENING)
            for p in self._people
            if p is not self._who and p.present[index] and not p.estimates[index].lost
        ]
        return depth_people.own_frame(frame, own, others)
