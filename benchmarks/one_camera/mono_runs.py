"""A tracker run on a monocular scene, and what it is measured by."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from hypose.geometry import Array
from hypose.monocular.clip import Modes, WholeClip, backwards, information, together
from hypose.monocular.settings import MonoSettings
from hypose.monocular.tracker import MonoTracker
from hypose.monocular.types import (
    MonoEstimate,
    MonoFrame,
    MonoHypotheses,
    StageTimes,
    points_from_keypoints,
    posterior_arrays,
)
from hypose.synthetic.mono_scenes import FRAME_RATE, MonoScene
from hypose.synthetic.render_rgb import Image
from hypose.tracking.smoothing import smooth_poses

LEVEL = 0.9
DEFINITION_SD_M = 0.008
"""What two bodies' definitions of a joint differ by; added to every region."""
KEPT_MEDIAN_M = 0.150
KEPT_FRAMES = 10
KEPT_PX = {"arm": 25.0, "body": 12.0}
"""A track is kept when the mean distance in the image over the last KEPT_FRAMES frames is below this (the person is
about 200 px tall in body scenes, an arm about as long in arm scenes) and the median distance in space below
KEPT_MEDIAN_M."""


@dataclass(frozen=True)
class MonoRun:
    """T frames after the first, M marks. errors, depth (T, M) m: distance of the best hypothesis to the truth, and its
    part along the line of sight; pixels (T, M): distance in the image; oracle (T,) m: mean error of the best of all
    modes; inside, inside_best (T, M): the truth lies in the LEVEL region of any mode, of the best hypothesis;
    mode_count (T,); seconds (T, stages) of StageTimes, of the processor."""

    scene: str
    kind: str
    errors: Array
    depth: Array
    pixels: Array
    oracle: Array
    inside: Array
    inside_best: Array
    mode_count: Array
    seconds: Array

    @property
    def mean(self) -> float:
        """Mean error, m."""
        return float(self.errors.mean())

    @property
    def kept(self) -> bool:
        """The track was kept to the end; see KEPT_PX."""
        near = float(self.pixels[-KEPT_FRAMES:].mean()) < KEPT_PX[self.kind]
        return near and float(np.median(self.errors)) < KEPT_MEDIAN_M


def pictures(scene: MonoScene, seconds: float | None = None) -> list[Image]:
    """The pictures of a scene (of its first seconds), for several trackers."""
    times = scene.performance.times
    shown = len(times) if seconds is None else int(np.searchsorted(times, seconds))
    return [scene.image(i) for i in range(shown)]


def track_scene(
    scene: MonoScene,
    settings: MonoSettings,
    images: Sequence[Image],
    *,
    keypoints: bool = False,
) -> MonoRun:
    """Follows the scene from its measured first pose through images, frame after frame; keypoints: with the detector's
    points besides. The truth is used for measuring only."""
    tracker, frames = _tracker_and_frames(scene, settings, images, keypoints)
    return _frame_after_frame(scene, list(_follow(scene, tracker, frames)))


def solve_scene(scene: MonoScene, settings: MonoSettings, images: Sequence[Image]) -> tuple[MonoRun, MonoRun]:
    """The same without points, and the clip solved as a whole (hypose.monocular.clip), whose seconds are those of both
    passes."""
    tracker, frames = _tracker_and_frames(scene, settings, images)
    there = list(_follow(scene, tracker, frames))
    n = len(there)
    way_back = backwards(
        tracker,
        there[-1].posterior,
        n,
        lambda k: frames[k + 1],
        lambda k: np.random.default_rng([scene.seed, 3000 + k]),
    )
    back = [*reversed(list(way_back)), there[-1]]
    poses, covariances = together(_modes(scene, there), _modes(scene, back), FRAME_RATE)
    poses = smooth_poses(scene.body, poses, information(covariances, scene.active), FRAME_RATE, WholeClip().motion)
    rows = []
    for i in range(n):
        apart, depth, shown = _errors(scene, poses[i : i + 1], 1 + i)
        inside = _inside(scene, poses[i], covariances[i], apart[0])
        seconds = np.array(there[i].seconds) + np.array(back[i].seconds)
        distance = np.linalg.norm(apart[0], axis=-1)
        rows.append((distance, depth, shown, distance.mean(), inside, inside, 1, seconds))
    return _frame_after_frame(scene, there), _run(scene, rows)


def _tracker_and_frames(
    scene: MonoScene, settings: MonoSettings, images: Sequence[Image], keypoints: bool = False
) -> tuple[MonoTracker, list[MonoFrame]]:
    frames = []
    for i, image in enumerate(images):
        points = points_from_keypoints(scene.body, scene.keypoint_names, scene.keypoints[i]) if keypoints else None
        frames.append(MonoFrame(i, float(scene.performance.times[i]), image, None, points))
    tracker = MonoTracker(scene.body, scene.camera, settings, scene.active, threads=1, clock=time.process_time)
    return tracker, frames


def _follow(scene: MonoScene, tracker: MonoTracker, frames: Sequence[MonoFrame]) -> Iterator[MonoEstimate]:
    """Estimates of all frames but the first, whose pose is given."""
    state = tracker.start(MonoHypotheses.at(scene.start), frames[0])
    for i, frame in enumerate(frames[1:], 1):
        state, estimate = tracker.step(state, frame, np.random.default_rng([scene.seed, 1000 + i]))
        yield estimate


def _frame_after_frame(scene: MonoScene, estimates: Sequence[MonoEstimate]) -> MonoRun:
    rows = []
    for i, estimate in enumerate(estimates, 1):
        modes = estimate.posterior
        apart, depth, shown = _errors(scene, modes.poses, i)
        distance = np.linalg.norm(apart, axis=-1)
        inside = np.stack([_inside(scene, *pair) for pair in zip(modes.poses, modes.covariances, apart, strict=True)])
        oracle = distance.mean(1).min()
        anywhere = np.asarray(inside.any(0))
        rows.append((distance[0], depth, shown, oracle, anywhere, inside[0], estimate.alive, estimate.seconds))
    return _run(scene, rows)


def _run(scene: MonoScene, rows: Sequence[tuple[object, ...]]) -> MonoRun:
    columns = [np.array(c) for c in zip(*rows, strict=True)]
    return MonoRun(scene.name, "body" if scene.root_aligned else "arm", *columns)


def _modes(scene: MonoScene, estimates: Sequence[MonoEstimate]) -> Modes:
    arrays = posterior_arrays(scene.body, estimates)
    return Modes(*(arrays[f"mode_{name}"] for name in Modes._fields))


def _errors(scene: MonoScene, poses: Array, index: int) -> tuple[Array, Array, Array]:
    """Of poses (K, D) in frame index: errors (K, M, 3) m of the marks; of the first pose their length along the line of
    sight (M,) m, and in the picture (M,) px."""
    truth = scene.true_marks()[index]
    marks = scene.estimated_marks(poses)
    shown = scene.camera.project_pinhole(marks[0]) - scene.camera.project_pinhole(truth)
    if scene.root_aligned:
        marks = marks - (scene.body.joints(poses)[:, :1] - scene.performance.joints[index, 0])
    apart = marks - truth
    sight = truth - scene.camera.position
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    return apart, np.abs((apart[0] * sight).sum(1)), np.linalg.norm(shown, axis=1)


def _inside(scene: MonoScene, pose: Array, covariance: Array, apart: Array) -> Array:
    """(M,) bool: errors (M, 3) m of one mode's marks lie in their LEVEL regions."""
    s = scene.body.skeleton
    joint = [m.joint for m in scene.marks]
    jacobian = s.joint_jacobians(pose)
    at = jacobian[joint]
    if scene.root_aligned:
        at = at - jacobian[:1]
    for k, mark in enumerate(scene.marks):
        if mark.offset.any():
            rotations, centres = s.forward(pose)
            at[k] = s.jacobian(pose, mark.joint, (centres[mark.joint] + rotations[mark.joint] @ mark.offset)[None])[0]
    spread = at @ covariance @ np.swapaxes(at, 1, 2) + DEFINITION_SD_M**2 * np.eye(3)
    squared = (apart * np.linalg.solve(spread, apart[..., None])[..., 0]).sum(1)
    return squared <= chi2.ppf(LEVEL, 3)


STAGES = StageTimes._fields
"""Names of the columns of MonoRun.seconds."""
