"""Gestures from a source of depth pictures: the sources, and the sessions that teach one gesture or watch for several.

A source is a recorded session, a recording of a depth camera, a live camera or a simulated person. The command line and
the studio take pictures from it and give them to `Teaching` or `Watching`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hypose.compute.forests import DepthImage
from hypose.errors import InputError
from hypose.gestures.depth_pictures import KINECT, DepthLens, millimetres
from hypose.gestures.events import Event, EventSettings, EventState, detect_events
from hypose.gestures.localise import Localisation, LocaliseSettings, Scratch, densities, settle
from hypose.gestures.model import GestureModel
from hypose.gestures.online import Learner
from hypose.gestures.trainer import Command, Feedback, SessionSettings, Trainer
from hypose.pipeline.gesture_files import SessionWriter, content_of, load_model, read_recording

if TYPE_CHECKING:
    from hypose.io.sensors.depth import DepthFile

PERSON_RATE = 15.0
"""Rate of the simulated person, Hz."""
_TEST_S = 2.0
"""Time (s) for which the simulated person alternately does the gesture and does not, while no phase asks for it."""


@dataclass(frozen=True)
class Taken:
    """One depth picture of a source.

    time: s.
    depth: (h, w) uint16 mm.
    box: (x, y) px where the gesture is done; None where it is not done, or where the source does not know.
    """

    time: float
    depth: DepthImage
    box: tuple[float, float] | None = None


@dataclass(frozen=True)
class GestureSource:
    """Source of depth pictures.

    name: name of the source.
    lens: lens parameters of the camera.
    size: (width, height), px.
    take: function take(phase) that returns the next picture, None at the end; phase is the phase of the session,
        which only a simulated person follows.
    close: function that releases the device.
    clear: function that returns whether the last picture clearly shows the gesture, or clearly does not; False where
        the source does not provide it.
    knows: the box of a picture is the true place of the gesture.
    """

    name: str
    lens: DepthLens
    size: tuple[int, int]
    take: Callable[[str], Taken | None]
    close: Callable[[], None] = lambda: None
    clear: Callable[[], bool] = lambda: False
    knows: bool = False


def open_source(text: str, gesture: str = "tee", seed: int = 0) -> GestureSource:
    """Open a source by its name.

    text: folder of a recorded session, FILE.mkv (Azure Kinect), FILE.bag or FILE.db3 (RealSense),
        "realsense", "simulated" or "simulated:PERSON".
    gesture, seed: gesture and seed of the simulated person.
    Raises: InputError for other texts.
    """
    if text == "simulated" or text.startswith("simulated:"):
        return _simulated(text.partition(":")[2] or "0", gesture, seed)
    from hypose.io.sensors.depth import open_depth, open_realsense, read_realsense

    path = Path(text)
    if text == "realsense":
        return _opened(text, open_realsense())
    if path.suffix.lower() in (".bag", ".db3"):
        return _opened(path.name, read_realsense(path))
    if path.suffix.lower() == ".mkv":
        return _opened(path.name, open_depth(path))
    if path.is_dir():
        return _recorded(path)
    raise InputError(
        f"There is no depth source {text!r}; give a recorded session's folder, a recording of an Azure Kinect "
        "(.mkv) or RealSense (.bag, .db3), realsense, or simulated."
    )


def _recorded(folder: Path) -> GestureSource:
    recording = read_recording(folder)
    pictures = (
        Taken(f.time, recording.picture(f), (f.x, f.y) if f.gesture else None) for f in recording.frames
    )  # read when they are taken
    return GestureSource(folder.name, recording.lens, recording.size, lambda phase: next(pictures, None), knows=True)


def _opened(name: str, opened: DepthFile) -> GestureSource:
    """Make the source of an opened depth camera or recording."""
    k = opened.camera.K  # distortion is left out: tests span a hand
    lens = DepthLens(*(float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])))

    def take(phase: str) -> Taken | None:
        frame = next(opened.frames, None)
        return None if frame is None else Taken(frame.time, millimetres(frame.depth, name))

    return GestureSource(name, lens, opened.camera.size, take, getattr(opened.frames, "close", lambda: None))


def _simulated(who: str, gesture: str, seed: int) -> GestureSource:
    """Open the simulated person.

    who: number of the person, as text.
    gesture: that the person does when a phase asks for it.
    """
    from hypose.synthetic.gesture_scenes import live_person

    if not who.isdigit():
        raise InputError(f"There is no simulated person {who!r}; give simulated:0, for example.")
    frames = live_person(int(who), gesture, np.random.default_rng([93, seed, int(who)]), PERSON_RATE)
    count, clear = 0, False

    def take(phase: str) -> Taken | None:
        nonlocal count, clear
        asked = phase in ("do_gesture", "positive")
        if phase in ("test", "free"):
            asked = int(count / PERSON_RATE / _TEST_S) % 2 == 1
        frame = frames.send(asked) if count else next(frames)
        count, clear = count + 1, frame.clear
        return Taken((count - 1) / PERSON_RATE, frame.depth, frame.point)

    return GestureSource(f"simulated:{who}", KINECT, (640, 480), take, clear=lambda: clear, knows=True)


# ---- teaching --------------------------------------------------------------------------------------------------------


def growing_model(path: Path, gesture: str) -> GestureModel:
    """Load the model of a gesture to train it further.

    Raises: InputError where it is of another gesture.
    """
    model = load_model(path)
    if model.name != gesture:
        raise InputError(f"{path} is the model of {model.name}, not of {gesture}; give another file.")
    return model


def learner_of(old: GestureModel | None, seed: int) -> Learner:
    """Return the learner of a model that is trained further, or a new one with the usual settings."""
    return Learner.new(np.random.default_rng(seed)) if old is None else old.learner


def trained_model(
    gesture: str,
    trainer: Trainer,
    threshold: float | None,
    old: GestureModel | None,
    entries: Sequence[Mapping[str, Any]],
) -> GestureModel:
    """Make the model of a trained forest.

    gesture: its name.
    threshold: cm^2; None: that of the model before, since only the gesture or only other movement was seen this time.
    old: model that was trained further; None: a new one.
    entries: what was learned this time, for the history of the model.
    """
    if old is None:
        return GestureModel(gesture, trainer.learner, threshold, tuple(entries))
    return GestureModel(gesture, trainer.learner, threshold or old.threshold, (*old.history, *entries))


class Teaching:
    """Session that teaches one gesture: pictures are learned as the phases of the session say, and recorded.

    source: source of the pictures.
    gesture: its name.
    settings: lengths and number of the phases.
    old: model that is trained further; None: a new forest, with the random numbers of `seed`.
    record: new folder for the recording; None: nothing is recorded.

    Attributes:
    place: (x, y) px where the gesture is asked for.
    usable: the last picture shows what the phase asks for, as far as the source knows.
    final: threshold of the forest when the test began, cm^2; None before, or where it is not known.
    """

    def __init__(
        self,
        source: GestureSource,
        gesture: str,
        settings: SessionSettings,
        *,
        old: GestureModel | None = None,
        seed: int = 0,
        record: Path | None = None,
    ) -> None:
        self.source, self.gesture, self.folder = source, gesture, record
        self.trainer: Trainer = Trainer(learner_of(old, seed), settings)
        self.place: tuple[float, float] = (source.size[0] / 2, 0.45 * source.size[1])
        self.usable, self.final = False, None
        self.asked: int = 0
        self._old = old
        self._learned: Counter[tuple[int, str]] = Counter()  # frames and pixels by segment
        self._writer = None if record is None else SessionWriter(record, [gesture], source.lens, source.size)

    @property
    def phase(self) -> str:
        """Phase of the session, which the next picture should show."""
        return self.trainer.session.phase

    @property
    def paused(self) -> bool:
        """Whether the session is paused."""
        return self.trainer.session.paused is not None

    def frame(
        self,
        taken: Taken,
        commands: Sequence[Command] = (),
        box: tuple[float, float] | None = None,
        fresh: bool = True,
    ) -> Feedback:
        """Advance the session by a picture: learn and record it.

        commands: commands of the user since the last picture.
        box: (x, y) px where the gesture is asked for, of a source that does not know its place; None: as before.
        fresh: False: only the commands are new, the picture was processed before.
        """
        trainer, before, source = self.trainer, self.trainer.session, self.source
        self.place = (taken.box if source.knows else box) or self.place
        shows = taken.box is not None if source.knows else None
        f = trainer.frame(taken.time, taken.depth, source.lens, self.place, commands, learn=fresh, shows=shows)
        i = f.instruction
        self.usable = fresh and i.learn is not None and shows in (None, i.learn == "gesture")
        self.asked += self.usable and i.learn == "gesture"
        if i.learn is not None and f.taught is not None:
            self._learned[i.segment, i.learn] += 1
            self._learned[i.segment, "pixels"] += sum(f.taught.learned)
        if i.phase == "test" and before.phase != "test":
            self.final = trainer.final_threshold()
        if self._writer is not None:
            for c in commands:
                gone = trainer.session.undone[len(before.undone) :] if c == "undo" else ()
                self._writer.act(taken.time, c, str(gone[0]) if gone else "")
            if fresh and not self.paused:
                kept = "free" if i.learn is not None and f.taught is None else i.phase
                shown = int(i.learn == "gesture")
                self._writer.add(taken.time, taken.depth, kept, i.segment, shown, self.place)
        return f

    def learned(self, what: str) -> int:
        """Count what was learned ("gesture" or "negative" frames, or "pixels") in segments that were not undone."""
        undone = self.trainer.session.undone
        return sum(n for (segment, kind), n in self._learned.items() if kind == what and segment not in undone)

    def model(self, threshold: float | None = None) -> GestureModel:
        """Make the model of what was learned so far; threshold: cm^2, None: computed from the frames."""
        entry: dict[str, Any] = {"session": self.source.name}
        if self.folder is not None:
            entry = {"session": self.folder.name, "content": content_of(self.folder)}
        entry["frames_learned"] = self.learned("gesture") + self.learned("negative")
        threshold = threshold or self.final or self.trainer.final_threshold()
        return trained_model(self.gesture, self.trainer, threshold, self._old, [entry])

    def close(self) -> None:
        """Complete the recording."""
        if self._writer is not None:
            self._writer.close()


# ---- watching --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Watched:
    """Result of the search for gestures in one frame.

    time: s.
    found: best place of each gesture.
    events: gestures that start or end in this frame.
    maps: density of the votes for each gesture.
    """

    time: float
    found: list[Localisation]
    events: list[Event]
    maps: Sequence[NDArray[np.float32]] = ()


class Watching:
    """Session that watches for the gestures of several models.

    source: source of the pictures.
    models: models of one gesture each.
    threshold: cm^2, instead of the models' own; None: each model's own.
    adaptation_rate: share of the new frame in the density (1: no temporal recursion).
    hold_s, rest_s: time for which a gesture must be held, and time after its end in which it does not start again, s.
    Raises: InputError where two models are of the same gesture, or one has no threshold.
    """

    def __init__(
        self,
        source: GestureSource,
        models: Sequence[GestureModel],
        threshold: float | None = None,
        *,
        adaptation_rate: float = 0.8,
        hold_s: float = 0.15,
        rest_s: float = 0.5,
    ) -> None:
        self.source, self.names = source, [m.name for m in models]
        if len(set(self.names)) < len(models):
            raise InputError(f"Two models are for the same gesture ({', '.join(self.names)}); give one of each.")
        for m in models:
            if (threshold or m.threshold or 0) <= 0:
                raise InputError(
                    f"The model of {m.name!r} has no threshold yet: its session ended before gesture and movement were "
                    "seen; train on, or give --threshold."
                )
        self.limits: list[EventSettings] = [
            EventSettings(threshold or m.threshold or 0, hold_s=hold_s, refractory_s=rest_s) for m in models
        ]
        self.settings = LocaliseSettings(adaptation_rate=adaptation_rate)
        self._forests, self._scratch, self._state = [m.learner.forest.freeze() for m in models], Scratch(), EventState()

    def frame(self, taken: Taken, limits: Sequence[EventSettings] | None = None, fresh: bool = True) -> Watched:
        """Search for the gestures in a picture.

        limits: settings of the events, one per gesture; None: those of the session.
        fresh: False: the picture was processed before, and changes nothing.
        """
        look = self.settings if fresh else replace(self.settings, adaptation_rate=1.0)
        maps = densities(taken.depth, self.source.lens, self._forests, look, self._scratch)
        found, events = settle(maps, taken.depth, self.source.lens, look, self._scratch), list[Event]()
        if fresh:
            self._state, events = detect_events(self._state, found, taken.time, limits or self.limits)
        return Watched(taken.time, found, events, [m for m, _ in maps])


def event_value(event: Event, names: Sequence[str]) -> dict[str, Any]:
    """Convert an event to JSON values; names: names of the gestures, by their number minus 1."""
    return {
        "event": event.kind,
        "gesture": names[event.gesture - 1],
        "time": round(event.time, 4),
        "x": round(event.x, 1),
        "y": round(event.y, 1),
        "position": None if event.position is None else [round(float(v), 4) for v in event.position],
        "score": round(event.score, 3),
    }
