"""Tracks one recording: the passes of a run, with progress, checkpoints and resume."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes, Motion
from hypose.errors import InputError
from hypose.evidence.cues import OwnEvidence
from hypose.geometry import Array
from hypose.inference.layer import Recipe
from hypose.io.motions.results import ResultsFolder
from hypose.io.recordings.frames import FrameSettings
from hypose.io.recordings.recording import Recording
from hypose.pipeline.assessment import Assessment, assess
from hypose.pipeline.first_frame import TrackedSubject
from hypose.pipeline.moved_sensors import Places
from hypose.pipeline.one_camera import one_view, picture_options
from hypose.pipeline.passes import AFTER_TRACKING, PASSES, ClipState, Pass, run_pass, save, to_motion
from hypose.pipeline.track_loop import FrameSource, StageProgress
from hypose.tracking.recipes import RECIPES, Preset


@dataclass(frozen=True)
class TrackOptions:
    """What a user chooses. recipe: a preset's name; refine: contour refinement after a published recipe; evidence: one
    of the preset's, None = its usual one; start, height, girths: see SubjectOptions and, for the picture of one camera,
    `picture_start`; subject: the file of a given body; smooth: solve all frames together at the end, if the recipe
    does; checkpoint_every: frames; sure_start: a person says that the start is the right way round; particles: how many
    hypotheses, None = the recipe's own number; own: options that only this recipe has, by name (`Preset.make`)."""

    recipe: str = "default"
    refine: bool = False
    evidence: str | None = None
    seed: int = 0
    start: str = "auto"
    height: float | None = None
    girths: bool = True
    subject: str | None = None
    smooth: bool = True
    checkpoint_every: int = 25
    sure_start: bool = False
    particles: int | None = None
    own: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.preset.check(self.recipe, self.looks_at, self.own)

    @property
    def preset(self) -> Preset:
        """The preset of the recipe; that of the default recipe when no recipe has this name (the wrong name is refused
        later)."""
        return RECIPES.get(self.recipe, RECIPES["default"])

    @property
    def looks_at(self) -> str:
        """The evidence."""
        return self.evidence or self.preset.evidence[0]

    @property
    def of_picture(self) -> bool:
        """The recipe looks at the picture of one camera."""
        return "picture" in self.preset.needs

    @property
    def whole_clip(self) -> bool:
        """All frames are solved on their key points together, instead of one after the other and then together."""
        return self.looks_at == "keypoints" and self.smooth and self.preset.whole_clip

    def suited_to(self, recording: Recording) -> TrackOptions:
        """With the evidence that a recording has, where none was asked for: key points where there are no pictures, key
        points and masks where a detector found both."""
        usual = "both" if recording.detected else "keypoints"
        if self.evidence is None and (recording.detected or not recording.has_pictures):
            if usual in self.preset.evidence and not self.of_picture:
                return replace(self, evidence=usual)
        return self

    def settings(self) -> dict[str, Any]:
        """The choices that decide the result."""
        left_out = ("checkpoint_every", "sure_start", "particles", "own")
        chosen = {k: v for k, v in asdict(self).items() if k not in left_out} | {"evidence": self.looks_at}
        return chosen | ({} if self.particles is None else {"particles": self.particles}) | dict(self.own)


def frames_wanted(recording: Recording, options: TrackOptions) -> FrameSettings | None:
    """How the frames of a recording are read for a run, None: as is usual; an InputError when a recipe that looks at
    the picture of one camera cannot have what it is to look at."""
    if options.of_picture:
        return picture_options(recording, options.start, options.looks_at)
    if options.looks_at == "keypoints":  # they need no image, so nothing is decoded
        return FrameSettings(silhouettes=None)
    if options.looks_at == "silhouettes" and "colours" in options.preset.likes and options.own.get("colours"):
        return FrameSettings(silhouettes=recording.silhouettes, colours=True)
    return None


def check_views(recording: Recording, of_picture: bool = False) -> None:
    """An InputError when nothing can be done with that number of cameras: two or more, or the picture of one."""
    if of_picture:
        view = one_view(recording, None).views[0]
        if view.depth is not None:
            raise InputError(f"{view.name} is a depth camera, and this recipe looks at pictures; leave --recipe out.")
    elif len(recording.views) == 1 and recording.views[0].depth is None:
        name = recording.views[0].name
        raise InputError(
            f"{recording.name} has one camera, {name}, and this needs two or more; track one with --recipe monocular "
            f"--camera {name}, or add the others as [[view]] in recording.toml."
        )


@dataclass(frozen=True)
class TrackResult:
    """motion; the subject's body; complete: every frame was tracked; notes for the report; modes: the poses that each
    frame allows, where the recipe tells them. one_by_one (T, D): the poses as each frame was tracked, audit (T, J, A):
    what spoke for and against each joint (hypose.tracking.joint_features), None where that was not kept; faults:
    sentences on what was found wrong before tracking, or with the clip as a whole; looks: on what makes the whole clip
    worth a look; remarks: on who else is there; places: of depth cameras that stand elsewhere than the source says;
    unsure: of the `Subject`"""

    motion: Motion
    body: Body
    complete: bool
    notes: tuple[str, ...]
    modes: Modes | None = None
    one_by_one: Array | None = None
    audit: NDArray[np.float32] | None = None
    faults: tuple[str, ...] = ()
    looks: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    places: tuple[Places, ...] = ()
    unsure: Array | None = None

    @property
    def assessment(self) -> Assessment:
        """Whether the motion is to be trusted, in words."""
        return replace(assess(self.motion, self.faults, self.looks), remarks=self.remarks)

    @staticmethod
    def of(clip: ClipState) -> TrackResult:
        """Make the result of a clip that has run through its passes."""
        assert clip.motion is not None
        return TrackResult(
            clip.motion,
            clip.who.body,
            clip.complete,
            clip.notes,
            clip.modes,
            clip.one_by_one,
            clip.audit,
            clip.faults,
            clip.looks,
            clip.remarks,
            clip.places,
            clip.who.unsure,
        )


def track_source(
    source: FrameSource,
    frame_rate: float,
    options: TrackOptions,
    *,
    body: Body | None = None,
    subject: TrackedSubject | None = None,
    results: ResultsFolder | None = None,
    record: Mapping[str, Any] | None = None,
    resume: bool = False,
    progress: StageProgress | None = None,
    method: Recipe | None = None,
    own: Sequence[OwnEvidence] = (),
    find_places: bool = True,
) -> TrackResult:
    """Track one person in the frames of a source.

    body: the subject's own body, whose start alone is searched for (None: the human template, fitted)
    subject: known body and start, which skips both searches
    results: a checkpoint is written there every `checkpoint_every` frames (later every twentieth of the frames so far),
        and motion.npz at the end or when interrupted
    record: the provenance; its identity must match for `resume`
    method: recipe of the caller's own instead of the options'
    own: evidence in addition to that of the frames
    find_places: depth cameras that turn out to stand elsewhere than the source says are put right
    """
    if len(source) == 0:
        raise InputError("The recording has no frame to track; check the frame range and the videos.")
    chosen = {"body": body, "method": method, "own": own, "find_places": find_places}
    kept = {"results": results, "record": record or {}, "resume": resume}
    report = progress or (lambda stage, done, total: None)
    given = subject is not None
    clip = ClipState(source, frame_rate, options, **chosen, **kept, progress=report, subject=subject, given=given)
    return run_passes(clip, PASSES)


def finish(clip: ClipState) -> TrackResult:
    """Correct, smooth, judge and write a clip that has been tracked."""
    return run_passes(clip, AFTER_TRACKING)


def run_passes(clip: ClipState, passes: Sequence[Pass]) -> TrackResult:
    """Run passes one after the other; an interruption after the first tracked frame keeps what was tracked."""
    try:
        for step in passes:
            clip = run_pass(step, clip)
    except KeyboardInterrupt:
        if clip.tracked is None:
            raise
        tracked = replace(clip.tracked, complete=False)
        clip = save(to_motion(replace(clip, tracked=tracked, faults=(), looks=())))
    return TrackResult.of(clip)
