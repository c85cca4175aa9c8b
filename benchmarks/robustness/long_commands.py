"""All commands that work for long, on inputs small enough to run each of them hundreds of times.

Not among them: `view`, whose jobs are these commands as processes of their own; `gesture record` and `gesture run`,
which follow a camera and cannot be run again (what was recorded is there, picture by picture); `keypoints`, which needs
a user's model (tests interrupt it with a stand-in); `bench`; and what ends at once.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.robustness.programs import run
from benchmarks.robustness.small_recordings import small_scene, write_board_pictures, write_masks, write_skeletons
from hypose.body.default_body import JOINT_NAMES
from hypose.io.files import write_text
from hypose.io.motions.results import load_motion
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.synthetic.write_recording import write_scene

_FRAMES, _FILMED = 240, 80  # track keeps its state every 25 frames, with one camera every 50
_CLICKED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True)
class LongCommand:
    """name; arguments before the results' place; option: how the place is given (None: as the last argument); file:
    the result is this file in the folder; again: what the second run adds; share of all kills; refuses: to write over
    finished results."""

    name: str
    arguments: tuple[str | Path, ...]
    share: float
    option: str | None = "--out"
    file: str | None = None
    again: tuple[str, ...] = ()
    refuses: bool = False
    failed: int = 2

    def to(self, folder: Path, again: bool = False) -> list[str | Path]:
        """The command line that writes to a folder."""
        place = folder / self.file if self.file else folder
        given = [self.option, place] if self.option else [place]
        return [*self.arguments, *given, *(self.again if again else ())]


def long_commands(folder: Path) -> list[LongCommand]:
    """The commands, their inputs written to a folder; needs a minute or two."""
    masks = write_masks(small_scene(1, _FRAMES), folder / "walk")
    few = write_masks(small_scene(1, 24), folder / "few")
    filmed = _filmed(folder / "filmed")
    write_board_pictures(folder)
    write_skeletons(folder / "sensors", seconds=20.0)
    body, session, done = folder / "subject", folder / "session", few / "results" / "done"
    _run("subject", few, "--out", body, "--poses", 1, "--frames", "0:6")
    _run("track", few, "--out", done, "--subject", body, "--no-overlay", "--formats", "trc")
    _run("gesture", "record", session, "--gesture", "pause", "--rounds", 1)
    light, known = ("--no-overlay", "--formats", "trc,c3d,csv"), ("--subject", body)
    one = ("--recipe", "monocular", "--camera", "cam2", "--hypotheses", "2", "--start", filmed / "clicks.json")
    write_text(folder / "few.csv", "recording,subject,seed\n" + "".join(f"few,{body},{n}\n" for n in range(2)))
    batch = ("batch", folder / "few.csv", "--workers", "1")
    boards = ("calibrate", folder / "boards", "--chessboard", "6x5", "--square", "12cm", "--floor", "0")
    short = ("--seconds", "0.2")
    go_on = ("--resume",)
    return [
        LongCommand("track", ("track", masks, *known, *light), 0.18, again=go_on),
        LongCommand("track, one camera", ("track", filmed, *one, *known, *light), 0.06, again=go_on),
        LongCommand("track, key points", ("track", filmed, "--evidence", "keypoints", *light), 0.04, again=go_on),
        LongCommand("correct", ("correct", done, _corrected(done, folder), "--formats", "trc"), 0.06),
        LongCommand("subject", ("subject", few, "--poses", "1", "--frames", "0:6"), 0.03),
        LongCommand("fuse", ("fuse", folder / "sensors"), 0.18),
        LongCommand("batch", batch, 0.1, failed=1),
        LongCommand(
            "gesture train",
            ("gesture", "train", "--gesture", "pause", "--recording", session),
            0.1,
            option=None,
            file="model.npz",
        ),
        LongCommand("calibrate", (*boards, "--intrinsics", folder / "lenses.toml"), 0.06, file="calibration.toml"),
        LongCommand("silhouettes", ("silhouettes", filmed), 0.05),
        LongCommand("sync", ("sync", filmed, "--offsets", "0,1.5,0,0"), 0.03, refuses=True),
        LongCommand("export", ("export", done), 0.06),
        LongCommand("synth", ("synth", "--rig", "ring-2", "--keypoints", *short), 0.03, option=None),
        LongCommand("demo", ("demo", *short), 0.02),
    ]


def _run(*arguments: str | int | Path) -> None:
    ended = run([str(a) for a in arguments])
    if ended.code != 0:
        raise RuntimeError(f"preparing {arguments[:2]} failed: {ended.err[-500:]}")


def _filmed(folder: Path) -> Path:
    """A recording with videos and key points, and the true joints of its first picture of cam2 as clicks."""
    cameras = camera_rig("humaneva-4", distorted=True).scaled(0.25)
    scene = make_scene("walk", "neutral", cameras, seconds=_FILMED / 25, seed=3)
    write_scene(scene, folder, background_frames=10, keypoints=True)
    names = [*(f"{side}_{part}" for side in ("left", "right") for part in _CLICKED), "neck", "head"]
    at = cameras[1].project(scene.joints[0])
    joints = {n: np.round(at[JOINT_NAMES.index(n)], 1).tolist() for n in names}
    write_text(folder / "clicks.json", json.dumps({"camera": "cam2", "frame": 0, "joints": joints}))
    return folder


def _corrected(done: Path, folder: Path) -> Path:
    """The pose of a frame of a result, as if it had been corrected in the studio."""
    pose = load_motion(done / "motion.npz").poses
    assert pose is not None
    path = folder / "arm.json"
    write_text(path, json.dumps({"format": "hypose-clicks", "version": 1, "frame": 3, "pose": pose[3].tolist()}))
    return path
