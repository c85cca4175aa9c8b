"""Track several people of one recording: find them in the visual hull, fit and track them together, one result each.

People are found where no tracked body explains the hull (`hypose.evidence.hull_people`), in the first frames and
repeatedly later, since people come. Each has a tracker of their own (`hypose.tracking.several`). At the end each is
finished like a single person, on what the final bodies of the others leave of the masks.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hypose.body.default_body import human
from hypose.calibration.findings import Finding
from hypose.errors import EvidenceError, HyposeError, InputError
from hypose.evidence import depth_people
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.hull import common_view_bounds
from hypose.evidence.hull_people import HullPerson, views_to_find
from hypose.geometry import Array
from hypose.io.motions.results import ResultsFolder, provenance_identity, save_motion
from hypose.pipeline.first_frame import (
    SubjectOptions,
    TrackedSubject,
    find_subject,
    forget_run,
    keep_subject,
    kept_subject,
)
from hypose.pipeline.frame_anomalies import in_words, looked_at
from hypose.pipeline.input_checks import check_depth_inputs, sentences
from hypose.pipeline.passes import ClipState, Tracked, tracker_of
from hypose.pipeline.person_paths import KeypointPeople, Path, PointFrames, follow_places, lasting, padded
from hypose.pipeline.rough_bodies import RoughTrack, fitted_again, frame_of_person, least_hidden, rough_bodies
from hypose.pipeline.run import finish, track_source
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import Deferred, Followed, FrameSource, StageProgress, TrackingSession
from hypose.pipeline.track_management import (
    back_again,
    birth_candidates,
    candidate_evidence,
    explained_by,
    not_parts,
    part_doubles,
    swap_identities,
    unfollowed,
    update_appearance,
    without_doubles,
)
from hypose.pipeline.track_options import TrackOptions
from hypose.pipeline.tracked_people import (
    OwnFrames,
    PeopleResult,
    TrackedPerson,
    Wanted,
    free_name,
    makes_room,
    names_at_places,
    said_of,
    said_of_places,
    seen_by_themselves,
)
from hypose.tracking.contacts import runs
from hypose.tracking.several import Member
from hypose.tracking.tracker import Tracker


@dataclass(frozen=True)
class PeopleRun:
    """Run that tracks the people of a source; call it to start.

    count: most results; None: all people.
    wanted: prior knowledge of some of them.
    points: key points sorted by person, for the evidence 'keypoints' and 'both'.
    floor: height of the floor, m.
    under: folder in `results` that holds the results of all people.
    The other fields: as for `track_source`.

    All people are tracked, also those beyond `count`, since they hide the others.
    """

    source: FrameSource
    frame_rate: float
    options: TrackOptions
    count: int | None = None
    wanted: Sequence[Wanted] = ()
    results: ResultsFolder | None = None
    record: Mapping[str, Any] = field(default_factory=dict)
    resume: bool = False
    progress: StageProgress = lambda stage, done, total: None
    points: KeypointPeople | None = None
    floor: float = 0.0
    under: str = ""

    def __call__(self) -> PeopleResult:
        """Track and finish all people; an interrupted run is incomplete and keeps what was done.

        Raises: InputError where the evidence cannot separate people; EvidenceError where no person is found.
        """
        if self.options.of_picture:
            raise InputError("One camera alone cannot tell several people apart; leave out --people, or add cameras.")
        if len(self.source) == 0:
            raise InputError("The recording has no frame to track; check the frame range and the videos.")
        if self.options.looks_at == "keypoints":
            return self._by_points()
        if self.options.looks_at == "both" and self.points is None:
            raise InputError("The evidence 'both' needs key points, and this recording has none; use silhouettes.")
        session = self._session()
        if self.results is None or not self.resume or not session.load(self.results.checkpoint, self._kept):
            self.progress("look", 0, 1)
            session.people = self._begun()
            self.progress("look", 1, 1)
        total, first = len(self.source), session.done
        frames = (self.source.frame(t) for t in range(first, total))
        error = session.track(frames, self.source.frame(first - 1) if first else None, total, self.progress)
        people, complete = session.people, session.done == total and not session.stopped
        asked, done = [p for p in people if p.asked_for], list[TrackedPerson]()
        for p in asked:  # after an interruption the motions of the others are kept as they were tracked
            done.append(self._finished(p, people, complete))
            complete = done[-1].result.complete
        if error is not None and self.results is not None:
            kept = f"The {session.done} frames before are kept in {self.results.path}; see --resume."
            raise type(error)(f"{error} {kept}") from error
        if complete and self.results is not None:
            for folder in (self.results, *(p.results for p in people if p.results is not None)):
                forget_run(folder)
        absent = [w.not_found for w in self.wanted if all(w.name != p.name for p in people)]
        said = (*said_of(done, self.frame_rate), *unfollowed(session.coming), *absent)
        said += said_of_places(self.wanted, len(people))
        return PeopleResult(tuple(done), complete, said, len(people) - len(asked))

    def _rank(self, name: str | None) -> int:
        """Return the position of a name among the wanted people; other people come last."""
        return next((k for k, w in enumerate(self.wanted) if w.name == name), len(self.wanted))

    def _tracker(self, subject: TrackedSubject) -> Tracker:
        return tracker_of(subject, self.options, self.frame_rate)

    # ---- key points alone --------------------------------------------------------------------------------------

    def _by_points(self) -> PeopleResult:
        """Track people by key points alone, one after the other."""
        points = self.points
        if points is None or not points.tracks:
            raise InputError(
                "The evidence 'keypoints' needs key points of people on whom two cameras or more agree; check them "
                "with `hypose check`, or use silhouettes."
            )
        total, done, tracks = len(self.source), list[TrackedPerson](), points.lasting(len(self.source))
        where = [points.tracks[k] for k in tracks]
        names = names_at_places(self.wanted, len(where), lambda k, t: where[k].place(t)[:2], self.frame_rate)
        order = sorted(range(len(tracks)), key=lambda k: (self._rank(names[k]), k))
        for k in order[: self.count]:
            name = names[k] or free_name([p.name for p in done], self.wanted)
            known = next((w for w in self.wanted if w.name == name), Wanted(name))
            source = PointFrames(self.source, points, tracks[k])
            results = self._results_of(name)
            out = track_source(
                source,
                self.frame_rate,
                replace(self.options, height=known.height or self.options.height),
                body=known.body,
                results=results,
                record=self.record,
                resume=self.resume,
                progress=self.progress,
            )
            present = np.zeros(total, dtype=np.bool_)
            present[source.first : source.first + len(out.motion)] = True
            out = replace(out, motion=padded(out.motion, source.first, total))
            if results is not None:
                save_motion(out.motion, results.motion)
            done.append(TrackedPerson(name, out, present, np.zeros(total, dtype=np.bool_)))
            if not out.complete:
                break
        complete = all(p.result.complete for p in done)
        said = (*said_of(done, self.frame_rate), *said_of_places(self.wanted, len(tracks)))
        return PeopleResult(tuple(done), complete, said, len(tracks) - len(done))

    # ---- who is there ------------------------------------------------------------------------------------------

    @cached_property
    def looked(self) -> tuple[Finding, ...]:
        """Findings of the depth maps about the places of their cameras."""
        return check_depth_inputs(self.source)

    def _begun(self) -> list[Followed]:
        """Find the people of the first frames; an error names wrong camera places as a possible cause where they were
        found.
        """
        try:
            return self._begin()
        except HyposeError as error:
            why = sentences(self.looked)
            if not why:
                raise
            raise type(error)(f"{' '.join(why)} That may be why: {error}") from error

    def _begin(self) -> list[Followed]:
        """Find and fit the people of the first frames: wanted people first, then by distance from the middle of the
        cameras' view.
        """
        last = min(len(self.source), max(2, round(SETTINGS.people_start_s * self.frame_rate)))
        looks = np.unique(np.linspace(0, last - 1, min(last, 6)).astype(int)).tolist()
        paths = lasting(self._places([*looks, *range(last, self._named_at + 1, self._look_every)]), looks)
        if not paths:
            if self.source.frame(0).depth is not None:
                raise EvidenceError(
                    "Nobody stands before the depth cameras at the beginning; begin with --frames where people are "
                    "seen, and record the empty room again if it has changed."
                )
            raise EvidenceError(
                "Nobody stands in the masks at the beginning: no part of the visual hull is as large and tall as a "
                "person; begin with --frames where people are seen by three cameras, and check the masks with "
                f"`hypose silhouettes`. {getattr(self.source, 'guessed_rooms', '')}".rstrip()
            )
        middle = self._middle()
        paths = sorted(paths, key=lambda p: float(np.linalg.norm(p.axis(0) - middle)))
        names = names_at_places(self.wanted, len(paths), lambda k, t: self._stood(paths[k], t), self.frame_rate)
        order = sorted(range(len(paths)), key=lambda k: (self._rank(names[k]), k))
        numbers, people = self._fit_numbers(0), list[Followed]()
        followed, names = self._followed(paths, numbers), list(names)
        for k in order:
            names[k] = names[k] or free_name([n for n in names if n is not None], self.wanted)
        rough = self._roughly(followed, [str(n) for n in names], numbers)
        unclear: list[HyposeError] = []
        for k in order:
            try:
                people.append(self._fitted(str(names[k]), followed, k, numbers, rough, alone=len(paths) == 1))
            except HyposeError as error:  # the others may be seen well; this person is searched again later
                unclear.append(error)
        if not people:
            raise unclear[0]
        subjects = without_doubles(people, self.source.frame(numbers[0]))
        if len(subjects) < len(people):
            people = [self._placed(name, subject) for name, subject in subjects.items()]
        for k, p in enumerate(people):
            p.asked_for = self.count is None or k < self.count
        if self._points is None:
            for k, subject in fitted_again(people, self.source.frame, numbers, self._known).items():
                people[k] = self._placed(people[k].name, subject, people[k].asked_for)
        return people

    def _places(self, numbers: Sequence[int]) -> list[Path]:
        """Follow all people in the hull through the frames `numbers`."""
        return follow_places(self.source.frame, numbers, self.frame_rate, floor=self.floor)

    @property
    def _named_at(self) -> int:
        """Number of the last frame for which a person's place is given."""
        times = [w.time for w in self.wanted if w.place is not None]
        return min(round(max(times, default=0.0) * self.frame_rate), len(self.source) - 1)

    def _stood(self, path: Path, t: int) -> Array:
        """Return where (2,) m a person stood in about a frame; NaN where not known."""
        return path.axis(t, within=SETTINGS.people_start_s * self.frame_rate)

    def _roughly(self, paths: Sequence[Path], names: Sequence[str], numbers: Sequence[int]) -> list[RoughTrack | None]:
        """Track every person roughly through the frames `numbers`; None for each where key points separate the people,
        or one person is alone.
        """
        if len(paths) < 2 or self._points is not None:
            return [None] * len(paths)
        known = [self._known(n) for n in names]
        sizes = [(human(), w.height) if w.body is None else (w.body, w.body.stature) for w in known]
        return rough_bodies(self.source.frame, numbers, paths, self._rate_of(numbers), sizes, self.options.seed)

    def _known(self, name: str) -> Wanted:
        return next((w for w in self.wanted if w.name == name), Wanted(name))

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

    def _results_of(self, name: str) -> ResultsFolder | None:
        return None if self.results is None else ResultsFolder(self.results.path / self.under / name)

    def _fit_numbers(self, first: int) -> list[int]:
        step = max(1, round(self.frame_rate / SETTINGS.people_fit_hz))
        return list(range(first, min(len(self.source), first + round(SETTINGS.people_fit_s * self.frame_rate)), step))

    def _followed(self, paths: Sequence[Path], numbers: Sequence[int]) -> list[Path]:
        """Find the paths of the same people through the frames from which bodies are fitted.

        paths: of the people who were found.
        Returns: one path per person; the old one where no new one is near.
        """
        found, out = self._places(numbers), list[Path]()
        for p in paths:
            free = [q for q in found if not any(q is o for o in out)]
            near = [q for q in free if np.linalg.norm(q.axis(numbers[0]) - p.axis(numbers[0])) < 0.6]
            out.append(near[0] if near else p)
        return out

    def _fitted(
        self,
        name: str,
        paths: Sequence[Path],
        who: int,
        numbers: Sequence[int],
        rough: Sequence[RoughTrack | None] | None = None,
        alone: bool = False,
    ) -> Followed:
        """Fit a person's body to the evidence that is theirs alone in the frames `numbers`.

        paths: of all people.
        who: index of the person.
        rough: rough tracks of all people.
        alone: no other person is there.
        """
        known = self._known(name)
        o = self.options
        own = {t: frame_of_person(self.source.frame(t), t, who, paths, rough) for t in numbers if t in paths[who].found}
        seen = least_hidden(own)

        def frame_at(k: int) -> Frame:
            t = seen[k]
            points = None if self._points is None else self._points.at(t, paths[who].axis(t), ())
            return replace(own[t], keypoints=None if points is None else points[1])

        rate, mine = self._rate_of(numbers), None if rough is None else rough[who]
        tried = () if mine is None else mine.starts(seen)
        start = "hull" if self._points is None else "keypoints"
        height = known.height or (o.height if alone else None)
        given = known.body is not None
        wanted = SubjectOptions(start, height, o.girths, known.body, rate, o.seed, given, not alone, tried)
        subject = find_subject(frame_at, len(seen), wanted)
        earlier = [own[t] for t in sorted(own, reverse=True) if t < seen[0]]
        if earlier:  # the fitted start is in the first frame that shows the person well
            tracker = self._tracker(replace(subject, keypoints=None))
            *_, (state, _) = tracker.follow(tracker.start(subject.start), earlier)
            subject = replace(subject, start=state.pose)
        return self._placed(name, subject)

    def _placed(self, name: str, subject: TrackedSubject, asked_for: bool = True) -> Followed:
        """Make the state of a person at the start, and keep the subject for a resumed run."""
        tracker, results = self._tracker(subject), self._results_of(name)
        if results is not None:
            keep_subject(subject, results, provenance_identity(self.record))
        return Followed(name, subject, Member(tracker, tracker.start(subject.start)), results, asked_for)

    # ---- the loop ----------------------------------------------------------------------------------------------

    def _session(self) -> TrackingSession:
        """Make the session that tracks all people; the people are added to it when they are known."""
        kept = None if self.results is None else self.results.checkpoint
        about = {"identity": provenance_identity(self.record), "every": self.options.checkpoint_every}
        session = TrackingSession([], False, self.frame_rate, kept, held=Deferred(self.progress), **about)
        if self._points is not None:
            session.keypoints = lambda t: [self._points_of(p, session.people, t) for p in session.people]
        session.manage = lambda frame, seen: self._manage(session, frame, seen)
        return session

    def _kept(self, name: str) -> Followed | None:
        """Load a person's subject as an interrupted run kept it; None where it is not there."""
        results = self._results_of(name)
        subject = None if results is None else kept_subject(results, provenance_identity(self.record))
        return None if subject is None else self._placed(name, subject)

    @property
    def _points(self) -> KeypointPeople | None:
        return self.points if self.options.looks_at == "both" else None

    def _points_of(self, p: Followed, people: Sequence[Followed], t: int) -> Keypoints:
        """Return the key points of a person in a frame: of the track used so far, else of the nearest free track."""
        assert self._points is not None
        if not p.member.present:
            return self._points.nothing
        taken = [q.track for q in people if q is not p and q.track is not None]
        found = self._points.at(t, p.member.state.pose[:2], taken, p.track)
        if found is None:
            return self._points.nothing
        p.track = found[0]
        return found[1]

    def _manage(self, session: TrackingSession, frame: Frame, seen: Sequence[Frame]) -> None:
        """Manage the tracks after a frame: people who were exchanged, found twice, who come and who return.

        seen: the frame as each person's tracker saw it.
        """
        people, t, look = session.people, session.done - 1, (session.done - 1) % self._look_every == 0
        if look:
            session.settle()
            for p, q, since in update_appearance(people, seen):
                swap_identities(p, q, since)
        part_doubles(people, max(2, round(SETTINGS.people_together_s * self.frame_rate)))
        if look:
            session.coming = self._look(people, frame, t, session.coming, session.held)

    @property
    def _look_every(self) -> int:
        return max(1, round(SETTINGS.people_look_s * self.frame_rate))

    def _look(
        self, people: list[Followed], frame: Frame, t: int, before: Sequence[Array], progress: StageProgress
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
        found = not_parts(depth_people.people_seen(frame, known, floor=self.floor), people)
        coming = list[Array]()
        for person in found:
            seen = next((b for b in before if np.linalg.norm(person.axis - b[:2]) < 0.5), None)
            tries, again = (0, t) if seen is None else (int(seen[2]), int(seen[3]))
            if seen is not None:
                own = candidate_evidence(person, frame, known, found)
                if self._back(people, person, own):
                    return []
                if t >= again:  # a fit is expensive, and may succeed in a later frame
                    progress("subject", 0, 1)
                    new = self._new(people, person, frame, t)
                    progress("subject", 1, 1)
                    if new:
                        return []
                    tries, again = tries + 1, t + self._look_every * 2 ** min(tries, 3)
            coming.append(np.array([*person.axis, tries, again], dtype=np.float64))
        return coming

    def _back(self, people: list[Followed], person: HullPerson, own: Frame) -> bool:
        """Return whether a person who was away is back; tracking of that person continues."""
        back = back_again(person, own, people, self.frame_rate)
        if back is None:
            return False
        p, pose = back
        p.member = Member(p.member.tracker, p.member.tracker.start(pose))
        p.gone = 0
        return True

    def _new(self, people: list[Followed], person: HullPerson, frame: Frame, t: int) -> bool:
        """Fit a new person and add them to `people`; return False where no body can be fitted."""
        numbers = self._fit_numbers(t)
        # after this frame nothing is tracked yet: people are separated by the hull alone
        paths = self._places(numbers)
        mine = [k for k, q in enumerate(paths) if t in q.found and np.linalg.norm(q.found[t].axis - person.axis) < 0.4]
        if not mine or len(paths[mine[0]].found) < min(len(numbers), SETTINGS.people_fewest):
            return False
        taken, own_path = [p.name for p in people], paths[mine[0]]
        rest = [w for w in self.wanted if w.name not in taken]
        name = names_at_places(rest, 1, lambda _, t: self._stood(own_path, t), self.frame_rate)[0]
        try:
            new = self._fitted(name or free_name(taken, self.wanted), paths, mine[0], numbers)
        except HyposeError:
            return False
        empty, done = frame.unseen(), len(people[0].estimates)
        blank = looked_at(new.member.tracker, new.member.tracker.step(new.member.state, empty)[1], empty, None)
        new.estimates = [replace(blank, lost=True) for _ in range(done)]
        new.present, new.hidden = [False] * done, [False] * done
        new.asked_for = makes_room(self.count, name, people, self.wanted)
        people.append(new)
        return True

    # ---- the end -----------------------------------------------------------------------------------------------

    def _finished(self, p: Followed, people: Sequence[Followed], complete: bool) -> TrackedPerson:
        found = seen_by_themselves(p, people, 3 * self._look_every)
        tracked = Tracked(found, p.member.state, complete)
        present, hidden = np.array(p.present, dtype=np.bool_), np.array(p.hidden, dtype=np.bool_)
        source = OwnFrames(self.source, p, people, self._points)
        shared = len(people) > 1 and p.present[0]
        clip = ClipState(source, self.frame_rate, self.options, results=p.results, record=self.record)
        known = {"subject": p.subject, "tracker": p.member.tracker, "tracked": tracked, "notes": p.subject.notes}
        clip = replace(clip, **known, shared_masks=shared, progress=self.progress)
        out = finish(clip.with_findings(*self.looked))
        motion, notes = replace(out.motion, lost=out.motion.lost | ~present), [*out.notes, *p.said]
        if hidden.any():
            motion = replace(
                motion, low_confidence=hidden if motion.low_confidence is None else motion.low_confidence | hidden
            )
            notes.append(f"others hide this person from all views but one in {in_words(runs(hidden))}")
        if not present.all():
            notes.append(f"not there in {in_words(runs(~present))}")
        if p.results is not None:
            save_motion(motion, p.results.motion)
        return TrackedPerson(p.name, replace(out, motion=motion, notes=tuple(notes)), present, hidden)
