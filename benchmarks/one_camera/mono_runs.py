"""A tracker run on a monocular scene, and what it is measured by."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from benchmarks.synthetic.mono_scenes import FRAME_RATE, MonoScene
from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame, Keypoints, Picture
from hypose.geometry import Array, Image, so3_turns
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.frame_evidence import keypoint_term
from hypose.tracking.monocular.picture_search import PictureSearch
from hypose.tracking.monocular.recipe import WholeClip, backward_estimates, information, picture_recipe, together
from hypose.tracking.monocular.settings import MonoSettings
from hypose.tracking.smoothing import smooth_poses
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerSettings, TrackerState, modes_of

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
    mode_count (T,); seconds (T,) of the processor."""

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
    return _frame_after_frame(scene, _follow(scene, *_tracker_and_frames(scene, settings, images, keypoints))[0])


def solve_scene(scene: MonoScene, settings: MonoSettings, images: Sequence[Image]) -> tuple[MonoRun, MonoRun]:
    """The same without points, and the clip solved as a whole (hypose.tracking.monocular.recipe), whose seconds are
    those of both passes."""
    tracker, frames = _tracker_and_frames(scene, settings, images)
    there, last = _follow(scene, tracker, frames)
    n = len(there)
    turned = [frames[k] for k in range(n - 1, 0, -1)]
    behind = [frames[k + 1] for k in range(n - 1, 0, -1)]
    way_back = backward_estimates(tracker, last, _with_before(turned, behind))
    back = [*reversed(_timed(way_back)), there[-1]]
    modes, others = (modes_of([e for e, _ in rows]) for rows in (there, back))
    assert modes is not None and others is not None
    poses, covariances = together(modes, others, FRAME_RATE)
    poses = smooth_poses(scene.body, poses, information(covariances, scene.active), FRAME_RATE, WholeClip().motion)
    rows = []
    for i in range(n):
        apart, depth, shown = _errors(scene, poses[i : i + 1], 1 + i)
        inside = _inside(scene, poses[i], covariances[i], apart[0])
        distance = np.linalg.norm(apart[0], axis=-1)
        rows.append((distance, depth, shown, distance.mean(), inside, inside, 1, there[i][1] + back[i][1]))
    return _frame_after_frame(scene, there), _run(scene, rows)


Rows = list[tuple[FrameEstimate, float]]
"""Of every frame its estimate, and its seconds."""


def _timed(estimates: Iterable[FrameEstimate]) -> Rows:
    """All of the estimates, and the processor's seconds that each took."""
    rows: Rows = []
    source = iter(estimates)
    while True:
        begin = time.process_time()
        estimate = next(source, None)
        if estimate is None:
            return rows
        rows.append((estimate, time.process_time() - begin))


def _tracker_and_frames(
    scene: MonoScene, settings: MonoSettings, images: Sequence[Image], keypoints: bool = False
) -> tuple[Tracker, list[Frame]]:
    rig = CameraRig((scene.camera,))
    frames = []
    for i, image in enumerate(images):
        seen = Keypoints(scene.keypoints[i][None], scene.keypoint_names, rig) if keypoints else None
        picture = Picture(scene.camera, image)
        frames.append(Frame(float(scene.performance.times[i]), i, keypoints=seen, picture=picture))
    search = PictureSearch(
        scene.body, settings, scene.active, points=lambda seen, body: keypoint_term(seen, body, scale_px=4.0)
    )
    return Tracker(scene.body, picture_recipe(search), TrackerSettings("both", frame_rate=FRAME_RATE)), frames


def _with_before(frames: Sequence[Frame], behind: Sequence[Frame]) -> Iterator[Frame]:
    for frame, last in zip(frames, behind, strict=True):
        assert frame.picture is not None and last.picture is not None
        yield replace(frame, picture=replace(frame.picture, before=last.picture.image))


def _follow(scene: MonoScene, tracker: Tracker, frames: Sequence[Frame]) -> tuple[Rows, TrackerState]:
    """Estimates of all frames but the first, whose pose is given, and the last state."""
    states = [tracker.start(Hypotheses.uniform(np.atleast_2d(scene.start)))]

    def estimates() -> Iterator[FrameEstimate]:
        for state, estimate in tracker.follow(states[0], _with_before(frames[1:], frames[:-1])):
            states[:] = [state]
            yield estimate

    return _timed(estimates()), states[0]


def _frame_after_frame(scene: MonoScene, estimates: Rows) -> MonoRun:
    rows = []
    for i, (estimate, seconds) in enumerate(estimates, 1):
        modes = estimate.uncertainty.modes
        assert modes is not None
        poses, covariances = modes.poses[0], modes.covariances[0]
        apart, depth, shown = _errors(scene, poses, i)
        distance = np.linalg.norm(apart, axis=-1)
        inside = np.stack([_inside(scene, *pair) for pair in zip(poses, covariances, apart, strict=True)])
        oracle = distance.mean(1).min()
        anywhere = np.asarray(inside.any(0))
        rows.append((distance[0], depth, shown, oracle, anywhere, inside[0], int(modes.alive[0]), seconds))
    return _run(scene, rows)


def _run(scene: MonoScene, rows: Sequence[tuple[object, ...]]) -> MonoRun:
    columns = [np.array(c) for c in zip(*rows, strict=True)]
    return MonoRun(scene.name, "body" if scene.root_aligned else "arm", *columns)


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
            at[k, :, 3:6] = at[k, :, 3:6] @ so3_turns(pose[3:6])
    spread = at @ covariance @ np.swapaxes(at, 1, 2) + DEFINITION_SD_M**2 * np.eye(3)
    squared = (apart * np.linalg.solve(spread, apart[..., None])[..., 0]).sum(1)
    return squared <= chi2.ppf(LEVEL, 3)
