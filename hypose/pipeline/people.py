"""Find the people of a recording at its beginning, and those who come, leave and return while it is tracked.

People are found where no tracked body explains the visual hull (`hypose.evidence.people`), in the first frames and
repeatedly later. Each has a tracker of their own (`step_together`). After tracking, each has a clip of their own
(`own_frames`), in which the bodies of the others hide what they cover.

Bodies of people who hide each other: hulls of people near each other merge, so which part hides a person is a guess,
and only arms and feet show front and back. So each person is first tracked with the template, scaled to their size, on
what the others' hulls leave (`rough_bodies`). Then bodies are fitted on what the others' rough bodies leave, and once
more when all bodies are known (`fitted_again`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.errors import EvidenceError, HyposeError
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.hull import common_view_bounds
from hypose.evidence.people import (
    SOLVED_WIDENING,
    BodyShape,
    DrawnShape,
    HullPerson,
    Other,
    own_frame,
    people_seen,
    views_to_find,
)
from hypose.fitting.articulated import SolveSettings
from hypose.geometry import Array
from hypose.pipeline.frame_anomalies import looked_at
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import ChangedFrames, FrameSource
from hypose.pipeline.start_choice import best_ways, way_of
from hypose.pipeline.subject import SubjectOptions, TrackedSubject, find_subject, fit_outlines, overlaps
from hypose.pipeline.track_loop import (
    Member,
    PeopleManager,
    StageProgress,
    TrackedPerson,
    TrackingSession,
    body_shape,
    step_together,
    tracker_of,
)
from hypose.pipeline.track_management import (
    KeypointPeople,
    KnownPerson,
    Path,
    back_again,
    birth_candidates,
    candidate_evidence,
    explained_by,
    follow_places,
    lasting,
    names_at_places,
    not_parts,
    part_doubles,
    swap_identities,
    update_appearance,
    without_doubles,
)
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.refinement import refine
from hypose.tracking.shape_refinement import Known
from hypose.tracking.start_search import Start
from hypose.tracking.tracker import FrameEstimate


@dataclass(frozen=True)
class RoughTrack:
    """Rough track of one person.

    body: body that was used.
    poses: pose (D,) by frame number.
    rivals: other possible starts, two at most, with their frame numbers.
    """

    body: Body
    poses: Mapping[int, Array]
    rivals: tuple[tuple[int, Start], ...] = ()

    def starts(self, numbers: Sequence[int]) -> tuple[tuple[int, Start], ...]:
        """List possible starts of the person: the start in the first of the frames `numbers`, and the rivals.

        Returns: pairs of an index into `numbers` and a start.
        """
        first = Start(self.body, self.poses[numbers[0]], np.inf)
        near = [(int(np.abs(np.array(numbers) - t).argmin()), s) for t, s in self.rivals]
        return (0, first), *near


def frame_of_person(
    frame: Frame, number: int, who: int, paths: Sequence[Path], rough: Sequence[RoughTrack | None] | None = None
) -> Frame:
    """Return frame `number` as evidence for one of the people on paths; what the others hide is left out.

    number, who: number of the frame, and index of the person in `paths`.
    rough: rough bodies of the people, which show the pixels that they hide; where one is None, its part of the hull
        does.
    """
    s = frame.silhouettes
    if s is None:
        return frame
    here = paths[who].found.get(number)
    if here is None:
        return frame.unseen()
    shapes = list[BodyShape | DrawnShape]()
    for k, p in enumerate(paths):
        track, hull = None if rough is None else rough[k], p.found.get(number)
        if k != who and track is not None and number in track.poses:
            shapes.append(body_shape(track.body, track.poses[number], s.rig))
        elif k != who and hull is not None:
            shapes.append(hull.shape(s.rig, SETTINGS.path_core_m))
    return own_frame(frame, here.shape(s.rig), [Other(shape, SETTINGS.path_others_widened) for shape in shapes])


def least_hidden(shares: Mapping[int, NDArray[np.float64]]) -> list[int]:
    """Select the frames in which all views but one see a person well; where these are few, the least hidden ones.

    shares: by frame number, the visible share of the person in each view (C,).
    """
    numbers = sorted(shares)
    share = np.array([np.sort(shares[t]) for t in numbers])
    if not share.size:
        return numbers
    good = np.flatnonzero(share[:, min(1, share.shape[1] - 1)] > SETTINGS.rough_hidden)
    if len(good) < SETTINGS.rough_frames:
        good = np.sort(np.argsort(-share.sum(1), kind="stable")[: SETTINGS.rough_frames])
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

    rate: rate of these frames, Hz.
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
    seen = least_hidden({t: frame.visible_share for t, frame in own.items()})[: SETTINGS.rough_frames]
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
    rivals = tuple((seen[w.at], w.start) for w in found.ways[1:3])
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
    people: Sequence[TrackedPerson],
    frame_at: Callable[[int], Frame],
    numbers: Sequence[int],
    known: Callable[[str], KnownPerson],
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
        shapes = {
            k: body_shape(p.subject.body, found[k][t][0].pose, rig) for k, p in enumerate(people) if t in found[k]
        }
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
    noted = replace(subject, notes=(*subject.notes, AGAIN))
    seen = least_hidden({t: shown for t, (_, shown) in way.items()})
    poses, iou = np.stack([way[t][0].pose for t in seen]), np.array([1 - way[t][0].cost for t in seen])
    try:
        chosen, fit = fit_outlines(
            lambda k: own_at(who, seen[k]), subject.body, poses, iou, Known(height), SETTINGS.again_poses
        )
    except HyposeError:
        return noted
    frames = [own_at(who, seen[k]) for k in chosen]
    after, before = (np.nanmean(overlaps(*of, frames)) for of in ((fit.body, fit.poses), (subject.body, poses[chosen])))
    if after <= before:
        return noted
    first = min(way)
    begin, pose = own_at(who, first), way[first][0].pose
    start = refine(fit.body, pose[None], prepare(begin, fit.body, pose), SolveSettings())[0].pose
    return replace(noted, body=fit.body, start=start)


# ---- finding and managing people ------------------------------------------------------------------------------


@dataclass(frozen=True)
class PeopleFinder(PeopleManager):
    """Finder of the people in the frames of a source, for a session that tracks them together.

    frame_rate: Hz.
    count: largest number of people whose results are wanted; None: all. Other people are tracked too, since they
        hide parts of the wanted people.
    wanted: prior knowledge of some people.
    source: frames by number.
    points: key points sorted by person; None: people are tracked by masks or depth alone.
    """

    source: FrameSource
    frame_rate: float
    options: TrackOptions
    count: int | None = None
    wanted: Sequence[KnownPerson] = ()
    points: KeypointPeople | None = None
    alone = False  # even where one person is found, the frames are those of all people

    # ---- the beginning -----------------------------------------------------------------------------------------

    def begin(self) -> list[TrackedPerson]:
        """Find and fit the people of the first frames: wanted people first, then by distance from the middle of the
        cameras' view.

        Raises: EvidenceError where no person is found, or no body can be fitted to one.
        """
        last = min(len(self.source), max(2, round(SETTINGS.people_start_s * self.frame_rate)))
        looks = np.unique(np.linspace(0, last - 1, min(last, 6)).astype(int)).tolist()
        # the last frame for which a person's place is given
        named = round(max((w.time for w in self.wanted if w.place is not None), default=0.0) * self.frame_rate)
        named, numbers = range(last, min(named + 1, len(self.source)), self._look_every), self._fit_numbers(0)
        paths = lasting(follow_places(self.source.frame, sorted({*looks, *named, *numbers}), self.frame_rate), looks)
        if not paths:
            if self.source.frame(0).kind == "depth":
                raise EvidenceError(
                    "No person stands before the depth cameras at the beginning; begin with --frames where people are "
                    "seen, and record the empty room again if it has changed."
                )
            raise EvidenceError(
                "No person stands in the masks at the beginning: no part of the visual hull is as large and tall as a "
                "person; begin with --frames where people are seen by three cameras, and check the masks with "
                "`hypose silhouettes`."
            )
        middle = self._middle()
        paths = sorted(paths, key=lambda p: float(np.linalg.norm(p.axis(0) - middle)))
        names = names_at_places(self.wanted, len(paths), lambda k, t: self._stood(paths[k], t), self.frame_rate)
        ranks = {w.name: k for k, w in enumerate(self.wanted)}
        order = sorted(range(len(paths)), key=lambda k: ranks.get(names[k], len(ranks)))
        people, unclear, rough = list[TrackedPerson](), list[HyposeError](), None
        if len(paths) > 1 and self.points is None:
            sizes = [
                (human(), w.height) if w.body is None else (w.body, w.body.stature) for w in map(self._known, names)
            ]
            rate = self._rate_of(numbers)
            rough = rough_bodies(self.source.frame, numbers, paths, rate, sizes, self.options.seed)
        for k in order:
            try:
                people.append(self._fitted(names[k], paths, k, numbers, rough, alone=len(paths) == 1))
            except HyposeError as error:  # the others may be seen well; this person is searched again later
                unclear.append(error)
        if not people:
            raise unclear[0]
        subjects = without_doubles(people, self.source.frame(numbers[0]))
        people = [self._at_start(name, subject) for name, subject in subjects.items()]
        if self.points is None:
            for k, subject in fitted_again(people, self.source.frame, numbers, self._known).items():
                people[k] = self._at_start(people[k].name, subject)
        return people

    def _at_start(self, name: str, subject: TrackedSubject) -> TrackedPerson:
        return TrackedPerson.at_start(name, subject, tracker_of(subject, self.options, self.frame_rate))

    def _stood(self, path: Path, t: int) -> Array:
        """Return where (2,) m a person stood in about a frame; NaN where not known."""
        return path.axis(t, within=SETTINGS.people_start_s * self.frame_rate)

    def _known(self, name: str) -> KnownPerson:
        return next((w for w in self.wanted if w.name == name), KnownPerson(name))

    def _rate_of(self, numbers: Sequence[int]) -> float:
        """Return the rate of the frames `numbers`, Hz."""
        return self.frame_rate / max(1, numbers[1] - numbers[0]) if len(numbers) > 1 else self.frame_rate

    def _middle(self) -> Array:
        """Return the middle (2,) m of the cameras' common view."""
        s = self.source.frame(0).silhouettes
        with contextlib.suppress(EvidenceError):
            if s is not None:
                return common_view_bounds(s.rig).mean(0)[:2]
        return np.zeros(2)

    def _fit_numbers(self, first: int) -> list[int]:
        step = max(1, round(self.frame_rate / SETTINGS.people_fit_hz))
        return list(range(first, min(len(self.source), first + round(SETTINGS.people_fit_s * self.frame_rate)), step))

    def _fitted(
        self,
        name: str,
        paths: Sequence[Path],
        who: int,
        numbers: Sequence[int],
        rough: Sequence[RoughTrack | None] | None = None,
        alone: bool = False,
    ) -> TrackedPerson:
        """Fit a person's body to the evidence that is theirs alone in the frames `numbers`.

        paths: paths of all people.
        who: index of the person.
        rough: rough tracks of all people.
        alone: no other person is there.
        """
        known, o = self._known(name), self.options
        own = {t: frame_of_person(self.source.frame(t), t, who, paths, rough) for t in numbers if t in paths[who].found}
        seen = least_hidden({t: frame.visible_share for t, frame in own.items()})

        def frame_at(k: int) -> Frame:
            t = seen[k]
            points = None if self.points is None else self.points.at(t, paths[who].axis(t), ())
            return replace(own[t], keypoints=None if points is None else points[1])

        rate, mine = self._rate_of(numbers), None if rough is None else rough[who]
        tried = () if mine is None else mine.starts(seen)
        start = "hull" if self.points is None else "keypoints"
        height = known.height or (o.height if alone else None)
        wanted = SubjectOptions(start, height, None, o.girths, known.body, rate, o.seed, not alone, tried)
        subject = find_subject(frame_at, len(seen), wanted)
        earlier = [own[t] for t in sorted(own, reverse=True) if t < seen[0]]
        if earlier:  # the fitted start is in the first frame that shows the person well
            tracker = tracker_of(replace(subject, keypoints=None), o, self.frame_rate)
            *_, (state, _) = tracker.follow(tracker.start(subject.start), earlier)
            subject = replace(subject, start=state.pose)
        return self._at_start(name, subject)

    # ---- while they are tracked --------------------------------------------------------------------------------

    def keypoints(self, people: Sequence[TrackedPerson], t: int) -> list[Keypoints | None]:
        """Return the key points of all people in frame t; those of an empty frame for a person who has none, or is not
        there. The track of key points that a person has from now on is noted in `TrackedPerson.track`.

        Returns: empty where people are tracked without key points.
        """
        if self.points is None:
            return []
        out: list[Keypoints | None] = []
        for p in people:
            taken = [q.track for q in people if q is not p and q.track is not None]
            place, found = p.member.state.pose[:2], None
            if p.member.present:
                found = self.points.at(t, place, taken, p.track)
            if found is not None:
                p.track = found[0]
            out.append(self.points.nothing if found is None else found[1])
        return out

    def manage(self, session: TrackingSession, frame: Frame, seen: Sequence[Frame]) -> None:
        """Update the tracks after a frame: correct people who were exchanged or found twice, and add people who come
            or return.

        seen: the frame as each person's tracker saw it.
        """
        people, t = session.people, session.done - 1
        for p, own in zip(people, seen, strict=True):
            self._mark_absence(p, frame, own)
        look = t % self._look_every == 0
        if look:
            session.settle()
            for p, q, since in update_appearance(people, seen):
                swap_identities(p, q, since)
        part_doubles(people, self.frame_rate)
        if look:
            session.candidates = self._look(people, frame, t, session.candidates, session.progress)

    def _mark_absence(self, p: TrackedPerson, frame: Frame, own: Frame) -> None:
        """Mark a person as absent who has not been seen for long, and as hidden where others cover all views but one.

        own: the frame as the person's tracker saw it.
        """
        shown = own.visible_share
        p.gone = p.gone + 1 if p.member.state.lost or p.member.state.blind > 0 else 0
        if p.member.present and p.gone > SETTINGS.people_gone_s * self.frame_rate:
            p.member = replace(p.member, present=False)
            for marks in (p.present, p.hidden):
                marks[-p.gone :] = [False] * len(marks[-p.gone :])
        hidden = p.present[-1] and len(shown) and (shown > SETTINGS.rough_hidden).sum() < frame.fewest_views
        p.hidden[-1] = bool(hidden)

    @property
    def _look_every(self) -> int:
        return max(1, round(SETTINGS.people_look_s * self.frame_rate))

    def _look(
        self, people: list[TrackedPerson], frame: Frame, t: int, before: Sequence[Array], progress: StageProgress
    ) -> list[Array]:
        """Look for people in mask parts that no tracked body explains; those who were also seen at the last look are
        tracked from now on.

        before: result of the last look.
        Returns: (4,) per possible new person: place (2,) m, number of failed fits, and frame from which the next fit is
            tried.
        """
        masks = frame.of(Silhouettes)
        known = [other for s in masks for other in explained_by(people, s)]
        if not any(birth_candidates(known, s, views_to_find(frame)) for s in masks):
            return []
        found = not_parts(people_seen(frame, known), people)
        candidates = list[Array]()
        for person in found:
            seen = next((b for b in before if np.linalg.norm(person.axis - b[:2]) < 0.5), None)
            tries, again = (0, t) if seen is None else (int(seen[2]), int(seen[3]))
            if seen is not None:
                back = back_again(person, candidate_evidence(person, frame, known, found), people, self.frame_rate)
                if back is not None:
                    p, pose = back
                    p.member, p.gone = Member(p.member.tracker, p.member.tracker.start(pose)), 0
                    return []
                if t >= again:  # a fit is expensive, and may succeed in a later frame
                    progress("subject", 0, 1)
                    new = self._new(people, person, frame, t)
                    progress("subject", 1, 1)
                    if new:
                        return []
                    tries, again = tries + 1, t + self._look_every * 2 ** min(tries, 3)
            candidates.append(np.array([*person.axis, tries, again], dtype=np.float64))
        return candidates

    def _new(self, people: list[TrackedPerson], person: HullPerson, frame: Frame, t: int) -> bool:
        """Fit a new person and add them to `people`; return False where no body can be fitted."""
        numbers = self._fit_numbers(t)
        # after this frame nothing is tracked yet: people are separated by the hull alone
        paths = follow_places(self.source.frame, numbers, self.frame_rate)
        mine = [k for k, q in enumerate(paths) if t in q.found and np.linalg.norm(q.found[t].axis - person.axis) < 0.4]
        if not mine or len(paths[mine[0]].found) < min(len(numbers), SETTINGS.people_fewest):
            return False
        path, taken = paths[mine[0]], [p.name for p in people]
        name = names_at_places(self.wanted, 1, lambda _, t: self._stood(path, t), self.frame_rate, taken)[0]
        try:
            new = self._fitted(name, paths, mine[0], numbers)
        except HyposeError:
            return False
        empty, done = frame.unseen(), len(people[0].estimates)
        blank = looked_at(new.member.tracker, new.member.tracker.step(new.member.state, empty)[1], empty, None)
        new.estimates = [replace(blank, lost=True) for _ in range(done)]
        new.present, new.hidden = [False] * done, [False] * done
        people.append(new)
        return True

    # ---- after tracking ----------------------------------------------------------------------------------------

    def asked_for(self, people: Sequence[TrackedPerson]) -> list[TrackedPerson]:
        """List the people whose results are asked for: those of `wanted` before others, the first found first."""
        names = [w.name for w in self.wanted]
        first = sorted(people, key=lambda p: p.name not in names)[: self.count]
        return [p for p in people if p in first]

    def own_clip(self, p: TrackedPerson, people: Sequence[TrackedPerson]) -> tuple[ChangedFrames, TrackedPerson]:
        """Return the frames as evidence for one of the people, and the person without mask changes that come from other
        people.

        Why: where a person comes or leaves, masks change suddenly, although time did not jump.
        """
        comes, late = np.zeros(len(p.estimates), dtype=np.bool_), 3 * self._look_every
        for q in people:
            for t in (np.flatnonzero(np.diff(np.array(q.present, dtype=np.int8))) + 1).tolist():
                comes[max(0, t - late) : t + 2] = True
        estimates = list(p.estimates)
        for t in np.flatnonzero(comes).tolist():
            if len(estimates[t].seen):
                seen = estimates[t].seen.copy()
                seen[:, 1] = np.nan
                estimates[t] = replace(estimates[t], seen=seen)
        return own_frames(self.source, p, people, self.points), replace(p, estimates=estimates)


def own_frames(
    source: FrameSource, who: TrackedPerson, people: Sequence[TrackedPerson], points: KeypointPeople | None
) -> ChangedFrames:
    """Return the frames of a source as evidence for one of the people, after all have been tracked: what the others
    hide is left out.

    who: the person, one of `people`.
    points: key points sorted by person; None: the frames have none.
    """

    def own(index: int, frame: Frame) -> Frame:
        found = None if points is None else points.at(index, who.estimates[index].pose[:2], (), who.track)
        nothing = None if points is None else points.nothing
        frame = replace(frame, keypoints=nothing if found is None else found[1])
        for s in frame.of(Silhouettes):
            if not who.present[index]:
                return frame.unseen()
            shown = [p for p in people if p is who or p.present[index] and not p.estimates[index].lost]
            shapes = {p.name: body_shape(p.subject.body, p.estimates[index].pose, s.rig) for p in shown}
            return own_frame(frame, shapes.pop(who.name), [Other(o, SOLVED_WIDENING) for o in shapes.values()])
        return frame

    return ChangedFrames(source, own, range(len(who.estimates)))
