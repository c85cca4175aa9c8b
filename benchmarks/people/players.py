"""Two people on the court of the rig court-4, with cameras out of step, and in step again.

One serves, one walks; they are small in the images and nothing is given. The cameras are up to two frames late. Tracked
as they are, and after `hypose sync` (from the same masks, which show both) has put them in step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.action_scenes import subject_of_seed
from benchmarks.synthetic.noisy_masks import MaskFaults, noisy
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.calibration.synchronisation import Resampled, offsets_from_motion
from hypose.evidence.frame import Frame
from hypose.geometry import Array
from hypose.pipeline.run import TrackResult, track_people
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import joint_errors, population_offsets
from hypose.synthetic.scenes import Corruptions, Scene, make_scene

SECONDS, RATE = 4.0, 25.0
DESYNC = (0, 1, 0, 2)
"""Frames by which the cameras are late, in turn."""
SILENT_MM = 40.0
"""A mean error from which a verdict must not be good."""
FIRST_SEED = 300
_OPTIONS = TrackOptions(evidence="silhouettes")


def players(options: BenchOptions) -> BenchReport:
    """Rows mean_mm (PLAYER/late, PLAYER/in step: mean over frames and 15 joints at the cameras' mean time), silent
    (late, in step: players more than 40 mm off whose assessment is good), offset_frames (largest error of a camera's
    lag that is found), people (those who are found, less two)."""
    seeds = options.seed_range(3, first=FIRST_SEED)
    found = []
    for k, seed in enumerate(seeds):
        options.progress(f"seed {seed}", k, len(seeds))
        found.append(options.part(f"players.{seed}", partial(run, seed, 1.6 if options.quick else SECONDS)))
    options.progress("done", 1, 1)
    settings = {"seeds": len(seeds), "first_seed": seeds.start, "seconds": SECONDS, "desync_frames": 2}
    return BenchReport(tuple(_rows(found)), settings)


def run(seed: int, seconds: float) -> dict[str, Any]:
    """One clip: both people, late and in step."""
    late_cameras = Corruptions(desync=DESYNC)
    plain = make_scene("serve", subject_of_seed(seed), "court-4", seconds=seconds, seed=seed, corruption=late_cameras)
    scene = noisy(plain, MaskFaults(boundary_px=0.7, blobs=1.0))
    other, walks = scene.others[0]
    one = {
        "server": replace(scene, others=()),
        "walker": replace(scene, subject=other, performance=walks, others=()),
    }
    together = FrameList(list(scene.mask_frames(1.0)), RATE)
    lags = np.array([DESYNC[c % len(DESYNC)] for c in range(len(scene.rig))], dtype=np.float64)
    masks = [f.silhouettes for f in together.frames]
    late = offsets_from_motion(scene.given_rig.pinhole(), None, masks).frames
    out: dict[str, Any] = {"offset": float(np.abs((late - late.mean()) - (lags - lags.mean())).max())}
    for case, offsets in (("late", np.zeros(len(lags))), ("in step", late)):
        shift = float((offsets - lags).mean())  # of the truth that the cameras show on the mean, frames
        people = track_people(_in_step(together.frames, offsets), RATE, _OPTIONS).people
        out[f"people/{case}"] = len(people) - len(one)
        for name, s in one.items():
            who = min(people, key=lambda p: _away(p, s))
            mean = _mean_mm(who.motion, s, shift)
            out[f"{name}/{case}"] = mean
            out[f"silent/{name}/{case}"] = mean > SILENT_MM and who.assessment.word == "good"
    return out


def _in_step(frames: Sequence[Frame], late: Array) -> FrameList:
    source = Resampled(FrameList(list(frames), RATE), late)
    return FrameList([source.frame(i) for i in range(len(source))], RATE)


def _away(person: TrackResult, scene: Scene) -> float:
    """m: median distance from a player's true root."""
    away = np.linalg.norm((person.motion.joints - scene.joints)[:, 0], axis=-1)
    return float(np.median(away[person.there])) if person.there.any() else np.inf


def _mean_mm(motion: Motion, scene: Scene, shift: float) -> float:
    assert motion.poses is not None
    rotations, _ = motion.skeleton.forward(motion.poses)
    at = np.clip(np.arange(len(motion)) + shift, 0, len(scene) - 1)
    low = np.floor(at).astype(int)
    high, share = np.minimum(low + 1, len(scene) - 1), (at - low)[:, None, None]
    truth = (1 - share) * scene.joints[low] + share * scene.joints[high]
    offsets = population_offsets(human()) * scene.subject.stature
    return 1e3 * float(joint_errors(motion.joints, truth, offsets, rotations).mean())


def _rows(found: list[Mapping[str, Any]]) -> list[Row]:
    rows = []
    for case in ("late", "in step"):
        for name in ("server", "walker"):
            rows.append(row("mean_mm", f"{name}/{case}", [f[f"{name}/{case}"] for f in found], "mm"))
        silent = [f[f"silent/{name}/{case}"] for f in found for name in ("server", "walker")]
        rows.append(Row("silent", case, float(sum(silent)), "1", n=len(silent)))
        rows.append(row("people", case, [f[f"people/{case}"] for f in found], "1"))
    rows.append(row("offset_frames", "all", [f["offset"] for f in found], "frames"))
    return rows
