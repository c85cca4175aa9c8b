"""Things to look at that last longer than anything a test makes: results, and a recorded session of a gesture."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.app.live.gestures import PERSON_RATE
from hypose.gestures.depth_pictures import KINECT
from hypose.gestures.model import GestureModel
from hypose.gestures.online import Learner
from hypose.io.motions.results import load_motion, save_motion
from hypose.pipeline.gesture_files import SessionWriter, save_model
from hypose.synthetic.gesture_scenes import live_person

_SERIES = ("poses", "joints", "joint_covariance", "lost", "extrapolated", "n_views", "cost")
_SERIES += (
    "low_confidence",
    "error_probability",
    "low_confidence_joints",
    "angle_sd",
    "systematic_covariance",
    "rivals",
    "rival_weights",
)
_TAUGHT, _SESSION_S, _RATE = 60, 900, 30


def long_result(source: Path, target: Path, frames: int) -> None:
    """A result of so many frames at 25 Hz in a new folder: another one forth and back again and again."""
    motion = load_motion(source / "motion.npz")
    times = frames // (2 * len(motion)) + 1
    there_and_back = {n: np.concatenate([getattr(motion, n), getattr(motion, n)[::-1]]) for n in _SERIES}
    series = {n: np.concatenate([a] * times)[:frames] for n, a in there_and_back.items()}
    target.mkdir(parents=True)
    save_motion(replace(motion, times=np.arange(frames) / 25, **series), target / "motion.npz")
    shutil.copy(source / "body.npz", target)


def long_session(folder: Path) -> None:
    """In a new folder, a model that has seen a little of a simulated person, and a session of that person of 15 minutes
    at 30 Hz, whose few pictures come again and again."""
    frames = live_person(0, "tee", np.random.default_rng(5), PERSON_RATE)
    learner, shown = Learner.new(np.random.default_rng(0)), []
    for k in range(_TAUGHT):
        frame = frames.send(k // 15 % 2 == 0) if k else next(frames)
        shown.append(frame.depth)
        if frame.point is not None:
            learner.show(frame.depth, KINECT, *frame.point)
        else:
            learner.reject(frame.depth, KINECT)
    folder.mkdir()
    save_model(GestureModel("tee", learner, 4.0), folder / "tee.npz")
    writer = SessionWriter(folder / "tee", ["tee"], KINECT, (640, 480))
    for k, depth in enumerate(shown):
        writer.add(k / _RATE, depth, "free")
    writer.close()
    head, *rows = (folder / "tee" / "frames.csv").read_text().splitlines()
    cells = [r.split(",") for r in rows]
    again = (",".join([str(k), f"{k / _RATE:.6f}", *cells[k % len(cells)][2:]]) for k in range(_SESSION_S * _RATE))
    (folder / "tee" / "frames.csv").write_text("\n".join([head, *again]) + "\n")
