"""Several people of one recording: prior knowledge of them, the results, and the state while they are tracked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.evidence import depth_people
from hypose.evidence.frame import Frame
from hypose.evidence.shared_masks import SOLVED_WIDENING, Other
from hypose.geometry import Array
from hypose.io.motions.results import Checkpoint, ResultsFolder, provenance_identity
from hypose.pipeline.assessment import Assessment, assess
from hypose.pipeline.first_frame import TrackedSubject, kept_subject
from hypose.pipeline.person_paths import KeypointPeople, per_frame
from hypose.pipeline.run import TrackResult
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import FrameSource
from hypose.tracking.appearance import AppearanceModel
from hypose.tracking.contacts import runs
from hypose.tracking.several import Member, shape_of
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerState, estimates_from_arrays, estimates_to_arrays


@dataclass(frozen=True)
class Wanted:
    """Prior knowledge of a person, [[person]] of recording.toml: height m; body: their own; place (2,) m:
    where they stand at `time`, s from the first frame that is tracked, negative before it."""

    name: str
    height: float | None = None
    body: Body | None = None
    place: tuple[float, float] | None = None
    time: float = 0.0

    @property
    def early(self) -> bool:
        """The place is of too long before the first frame to tell who they are."""
        return self.place is not None and self.time < -SETTINGS.tracked_early_s

    @property
    def not_found(self) -> str:
        """The sentence that this person was not found."""
        at = self.place
        where = "" if at is None else f" at [{at[0]:g}, {at[1]:g}] m, {self.time:g} s from the first frame"
        return f"nobody was found who is {self.name}{where}"


@dataclass(frozen=True)
class TrackedPerson:
    """name; the result; present (T,): frames in which the person is there (before they come and after they leave the
    motion is filled up, and flagged); hidden (T,): frames in which others hide them from all views but one."""

    name: str
    result: TrackResult
    present: NDArray[np.bool_]
    hidden: NDArray[np.bool_]

    @property
    def assessment(self) -> Assessment:
        """Of the frames in which the person is there; frames are counted as in the recording."""
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
    """people: in the order in which they were found; complete: all frames were tracked; notes for the report; others:
    how many more there are than were asked for."""

    people: tuple[TrackedPerson, ...]
    complete: bool
    notes: tuple[str, ...] = ()
    others: int = 0


def while_present(motion: Motion, present: NDArray[np.bool_]) -> Motion:
    """The motion in the frames in which the person is there, one after the other."""
    if present.all() or not present.any():
        return motion
    return replace(motion, **per_frame(motion, np.flatnonzero(present)))


def said_of(people: Sequence[TrackedPerson], frame_rate: float) -> tuple[str, ...]:
    """Who was there, in words."""
    said = [f"{len(people)} {'people' if len(people) != 1 else 'person'}: {', '.join(p.name for p in people)}"]
    for p in people:
        if not p.present.all() and p.present.any():
            at = np.flatnonzero(p.present)
            said.append(f"{p.name} is there from {at[0] / frame_rate:.1f} to {(at[-1] + 1) / frame_rate:.1f} s")
    return tuple(said)


def said_of_places(wanted: Sequence[Wanted], count: int) -> tuple[str, ...]:
    """Whose places do not tell who of so many people they are, in words."""
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
    """Which of so many people are the wanted ones, None for another person; place(k, frame) (2,) m: where the k-th
    stands, NaN where not known. Those who are wanted at no place, or at too early a one, take the people who are left,
    in their order."""
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
    """The name of a person of whom nothing is known."""
    used = {*taken, *(w.name for w in wanted)}
    return next(n for n in (f"person-{k}" for k in range(1, 10_000)) if n not in used)


@dataclass(eq=False)
class Followed:
    """A person who is tracked. results: where theirs are kept, None: nowhere; estimates, present, hidden: of each frame
    so far, as in TrackedPerson; gone: frames since anything was seen of them; track: number of the track of
    key points that they have; wardrobe: their clothes; said: notes for their report."""

    name: str
    subject: TrackedSubject
    member: Member
    results: ResultsFolder | None = None
    asked_for: bool = True
    estimates: list[FrameEstimate] = field(default_factory=list)
    present: list[bool] = field(default_factory=list)
    hidden: list[bool] = field(default_factory=list)
    gone: int = 0
    track: int | None = None
    appearance: AppearanceModel = field(default_factory=AppearanceModel)
    said: list[str] = field(default_factory=list)

    @property
    def last_seen(self) -> tuple[Array, int] | None:
        """The pose (D,) in the last frame in which they were there, and frames since then; None: never."""
        for since, (estimate, there) in enumerate(zip(self.estimates[::-1], self.present[::-1], strict=True)):
            if there:
                return estimate.pose, since
        return None

    def was_not(self, since: int, reported: str) -> None:
        """Mark that from frame `since` on another person was tracked in their place. reported: how that is known."""
        last = len(self.estimates)
        self.estimates[since:] = [replace(e, lost=True) for e in self.estimates[since:]]
        self.hidden[since:] = [True] * (last - since)
        self.said.append(f"another person was taken for them from frame {since} to {last - 1}, {reported}")

    def cut(self, frames: int) -> None:
        """Forgets what came after so many frames."""
        del self.estimates[frames:], self.present[frames:], self.hidden[frames:]


def makes_room(count: int | None, name: str | None, people: Sequence[Followed], wanted: Sequence[Wanted]) -> bool:
    """Whether a new person, who is wanted by that name or by none, is among so many at most who are asked for; for who
    is wanted one who is not makes room, and is asked for no longer."""
    if count is None or len(people) < count:
        return True
    names = {w.name for w in wanted}
    others = [p for p in people if p.asked_for and p.name not in names]
    if name is None or not others:
        return False
    others[-1].asked_for = False
    return True


def seen_by_themselves(p: Followed, people: Sequence[Followed], late: int) -> list[FrameEstimate]:
    """The estimates of a person without what others do to the masks: where a person comes, or leaves, the masks change
    all at once, and time has not jumped. late: frames after which a person who comes may have been found."""
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


def save_people(
    results: ResultsFolder, record: Mapping[str, Any], people: Sequence[Followed], coming: Sequence[Array]
) -> None:
    """Writes the checkpoint. coming: (4,) each, of a new person who was seen at the last look."""
    arrays: dict[str, np.ndarray] = {"coming": np.array(coming, dtype=np.float64).reshape(-1, 4)}
    for k, p in enumerate(people):
        arrays |= {f"{k}_{n}": v for n, v in p.member.state.to_arrays().items()}
        arrays |= {f"{k}_done_{n}": v for n, v in estimates_to_arrays(p.estimates).items()}
        arrays |= {f"{k}_present": np.array(p.present), f"{k}_hidden": np.array(p.hidden)}
        arrays |= {f"{k}_{n}": v for n, v in p.appearance.arrays().items()}
    meta = {
        "people": [
            {
                "name": p.name,
                "there": p.member.present,
                "gone": p.gone,
                "track": p.track,
                "asked_for": p.asked_for,
                "clothes": p.appearance.about,
                "said": p.said,
            }
            for p in people
        ]
    }
    Checkpoint(len(people[0].estimates), arrays, meta, provenance_identity(record)).save(results.checkpoint)


def kept_people(
    results: ResultsFolder, under: str, record: Mapping[str, Any], tracker_of: Callable[[TrackedSubject], Tracker]
) -> tuple[list[Followed], list[Array]]:
    """What `save_people` wrote, with the subjects in the folder `under`; empty lists when nothing of the same run is
    there, or a body is missing."""
    if not results.checkpoint.exists():
        return [], []
    saved, people = Checkpoint.load(results.checkpoint, provenance_identity(record)), list[Followed]()
    for k, about in enumerate(saved.meta.get("people", ())):
        own_results = ResultsFolder(results.path / under / about["name"])
        subject = kept_subject(own_results, provenance_identity(record))
        if subject is None:
            return [], []
        own = {n.removeprefix(f"{k}_"): v for n, v in saved.arrays.items() if n.startswith(f"{k}_")}
        done = {n.removeprefix("done_"): v for n, v in own.items() if n.startswith("done_")}
        state = TrackerState.from_arrays({n: v for n, v in own.items() if not n.startswith("done_")})
        member = Member(tracker_of(subject), state, bool(about["there"]))
        flags = own["present"].tolist(), own["hidden"].tolist()
        kept = Followed(about["name"], subject, member, own_results, about["asked_for"], estimates_from_arrays(done))
        kept.present, kept.hidden = flags
        kept.gone, kept.track = int(about["gone"]), about["track"]
        kept.appearance, kept.said = AppearanceModel.of_arrays(own, about["clothes"]), list(about["said"])
        people.append(kept)
    return people, list(saved.arrays.get("coming", ()))


class OwnFrames:
    """The frames of a source as evidence for one of the people, now that all have been tracked."""

    def __init__(
        self, source: FrameSource, who: Followed, people: Sequence[Followed], points: KeypointPeople | None
    ) -> None:
        self._source, self._who, self._people, self._points = source, who, people, points

    def __len__(self) -> int:
        return len(self._who.estimates)

    def frame(self, index: int, /) -> Frame:
        """Frame number index with the silhouettes, and key points, of this person."""
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
