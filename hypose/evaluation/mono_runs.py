"""A tracker run on a monocular scene, and what it is measured by."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from hypose.evaluation.mono_scenes import MonoScene
from hypose.evaluation.render_rgb import Image
from hypose.geometry import Array
from hypose.monocular.settings import MonoSettings
from hypose.monocular.tracker import MonoTracker
from hypose.monocular.types import MonoEstimate, MonoFrame, MonoHypotheses, StageTimes, points_from_keypoints

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
    """Follows the scene from its measured first pose through images; keypoints: with the detector's points
    besides. The truth is used for measuring only."""
    tracker = MonoTracker(scene.body, scene.camera, settings, scene.active, threads=1, clock=time.process_time)

    def frame(i: int) -> MonoFrame:
        points = None
        if keypoints:
            points = points_from_keypoints(scene.body, scene.keypoint_names, scene.keypoints[i])
        return MonoFrame(i, float(scene.performance.times[i]), images[i], None, points)

    state = tracker.start(MonoHypotheses.at(scene.start), frame(0))
    truth, rows = scene.true_marks(), []
    for i in range(1, len(images)):
        rng = np.random.default_rng([scene.seed, 1000 + i])
        state, estimate = tracker.step(state, frame(i), rng)
        rows.append(_measure(scene, estimate, truth[i], scene.performance.joints[i, 0]))
    columns = [np.array(c) for c in zip(*rows, strict=True)]
    return MonoRun(scene.name, "body" if scene.root_aligned else "arm", *columns)


def _measure(scene: MonoScene, estimate: MonoEstimate, truth: Array, root: Array) -> tuple[np.ndarray, ...]:
    """One row of a MonoRun."""
    modes = estimate.posterior
    marks = scene.estimated_marks(modes.poses)
    shown = scene.camera.project_pinhole(marks[0]) - scene.camera.project_pinhole(truth)
    if scene.root_aligned:
        marks = marks - (scene.body.joints(modes.poses)[:, :1] - root)
    apart = marks - truth
    sight = truth - scene.camera.position
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    distance = np.linalg.norm(apart, axis=-1)
    inside = np.stack([_inside(scene, *pair) for pair in zip(modes.poses, modes.covariances, apart, strict=True)])
    return (
        distance[0],
        np.abs((apart[0] * sight).sum(1)),
        np.linalg.norm(shown, axis=1),
        distance.mean(1).min(),
        np.asarray(inside.any(0)),
        inside[0],
        np.array(estimate.alive),
        np.array(estimate.seconds),
    )


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
