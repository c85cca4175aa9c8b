"""Options of a run: what a user chooses, and what a recording must have for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

from hypose.options import HEIGHT, RESEARCH, Option, Seed, declared

if TYPE_CHECKING:  # options import nothing that computes
    from hypose.io.recordings.recording import Recording
    from hypose.tracking.recipes import Preset

RECIPE_NAMES = (
    *("default", "sir", "apf", "partitioned", "hpf", "hpf+", "hpf-apo"),
    *("dd-hpf", "dd-hpf+", "dd-hpf+5", "dd-hpf+rivals", "monocular"),
)
"""Names of hypose.tracking.recipes.RECIPES."""


@dataclass(frozen=True)
class TrackOptions:
    """Options of tracking that a user chooses.

    recipe: name of a preset.
    refine: contour refinement after a published recipe.
    evidence: kind of evidence, one that the preset allows; None: the usual one of the preset.
    seed: seed of random numbers.
    start: how the start pose is found: 'auto', 'keypoints', 'hull' or the name of a known pose; with one camera
        'auto', 'keypoints' or a file of clicked joints.
    height: height of the person, m; None: that of recording.toml, else estimated.
    girths: fit girths to the silhouettes where the body comes from key points.
    subject: file of a given body.
    smooth: solve all frames together at the end, if the recipe does that.
    checkpoint_every: number of frames between two checkpoints.
    sure_start: a user confirmed that left and right are the right way round at the start.
    particles: number of hypotheses; None: that of the recipe.
    own: options that only this recipe has, by name (`Preset.make`).
    Raises: InputError names a value that is not possible.
    """

    recipe: Annotated[
        str, Option("Method; with one camera monocular.", choices=RECIPE_NAMES, value="NAME", group=RESEARCH)
    ] = "default"
    refine: Annotated[bool, Option("Contour refinement after a published recipe.", group=RESEARCH)] = False
    evidence: Annotated[
        str | None,
        Option(
            "What is looked at; auto and edges with one camera. [default: silhouettes; without pictures keypoints; "
            "both by a detector where nothing tells the person; with one camera all there is]",
            choices=("silhouettes", "keypoints", "both", "auto", "edges"),
        ),
    ] = None
    seed: Seed = 0
    start: Annotated[
        str,
        Option(
            "auto, keypoints, hull, or the first frame's pose: a, t, standing, hands-up; with one camera keypoints or "
            "a file of clicked joints.",
            value="POSE",
        ),
    ] = "auto"
    height: Annotated[
        float | None,
        Option("The person's height. [default: recording.toml's, else estimated]", *HEIGHT, unit="metres"),
    ] = None
    girths: bool = True
    subject: Annotated[
        str | None, Option("The person's body: the folder or body.npz that hypose subject wrote.", value="PATH")
    ] = None
    smooth: Annotated[
        bool, Option("Each frame as it was tracked, without solving all together at the end.", group=RESEARCH)
    ] = True
    checkpoint_every: int = 25
    sure_start: bool = False
    particles: Annotated[
        int | None,
        Option(
            "How many hypotheses are followed. [default: the recipe's own number]",
            1,
            100_000,
            group=RESEARCH,
            flag="--hypotheses",
        ),
    ] = None
    own: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for option in declared(TrackOptions):
            option.check(getattr(self, option.name), option.name)
        self.preset.check(self.recipe, self.looks_at, self.own)

    @property
    def preset(self) -> Preset:
        """The preset of the recipe."""
        from hypose.tracking.recipes import RECIPES

        return RECIPES[self.recipe]

    @property
    def looks_at(self) -> str:
        """Name of the kind of evidence that is used: that of the option, else the usual one of the preset."""
        return self.evidence or self.preset.evidence[0]

    @property
    def of_picture(self) -> bool:
        """Whether the recipe uses the picture of one camera."""
        return "picture" in self.preset.needs

    @property
    def whole_clip(self) -> bool:
        """Whether all frames are solved together on their key points, instead of being tracked one after the other
        first.
        """
        return self.looks_at == "keypoints" and self.smooth and self.preset.whole_clip

    def suited_to(self, recording: Recording) -> TrackOptions:
        """Return the options with the evidence that a recording has, where none was chosen: key points where there are
        no pictures, both where a detector found key points and masks.
        """
        usual = "both" if recording.detected else "keypoints"
        if self.evidence is None and (recording.detected or not recording.has_pictures):
            if usual in self.preset.evidence and not self.of_picture:
                return replace(self, evidence=usual)
        return self

    def settings(self) -> dict[str, Any]:
        """Return the options that influence the result, by name."""
        left_out = ("checkpoint_every", "sure_start", "particles", "own")
        chosen = {k: v for k, v in asdict(self).items() if k not in left_out} | {"evidence": self.looks_at}
        return chosen | ({} if self.particles is None else {"particles": self.particles}) | dict(self.own)


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of comparing a motion with another.

    offset: seconds added to the other's times; None: it is estimated.
    align: move the other rigidly onto ours.
    all_frames: also compare frames that are lost or predicted.
    """

    offset: Annotated[
        float | None,
        Option("Seconds to add to the other's times. [default: found]", -100_000, 100_000, unit="seconds"),
    ] = None
    align: Annotated[bool, Option("Both have the same world: do not move the other onto the result.")] = True
    all_frames: Annotated[bool, Option("Also frames in which the person was lost or only predicted.")] = False
