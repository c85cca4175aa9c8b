"""The product as a user has it on synthetic scenes: the body estimated from another clip, the default recipe, the clip
solved at the end."""

from __future__ import annotations

from benchmarks.bench_report import BenchOptions
from benchmarks.multiview.action_scenes import action_scene, known_subject
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.evidence.frame import Frame
from hypose.geometry import Array
from hypose.pipeline.sources import FrameList
from hypose.pipeline.subject import SubjectOptions, estimate_subject, find_subject
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import population_offsets, with_offsets
from hypose.synthetic.scenes import Scene

BODY_SECONDS = 3.0
"""Length of the clip (combo) from which the body is estimated."""


def estimated_body(seed: int, options: BenchOptions) -> Body:
    """The body of a seed's subject from the silhouettes of another clip (combo), as `hypose track` estimates it."""
    scene = action_scene("combo", seed, BODY_SECONDS, options)
    frames = list(scene.mask_frames(1.0))
    how = SubjectOptions(frame_rate=scene.frame_rate, seed=seed)
    return estimate_subject(lambda i: frames[i], len(frames), how).body


def product_motion(scene: Scene, frames: list[Frame], body: Body, seed: int) -> Motion:
    """The default recipe with a body, from the true pose of frame 0 (definitions aligned), solved as one clip."""
    options = TrackOptions(seed=seed)
    return track_source(FrameList(frames), scene.frame_rate, options, subject=known_subject(scene, body)).motion


def body_by_keypoints(seed: int, options: BenchOptions) -> Body:
    """The body of a seed's subject from the key points and silhouettes of another clip (combo)."""
    scene = action_scene("combo", seed, BODY_SECONDS, options)
    frames = list(scene.mask_frames(1.0, keypoints=True))
    how = SubjectOptions("keypoints", frame_rate=scene.frame_rate)
    return find_subject(lambda i: frames[i], len(frames), how).body


def keypoint_motions(scene: Scene, frames: list[Frame], body: Body, seed: int) -> dict[str, Motion]:
    """Motions of frames with key points and silhouettes by the evidence used, 'keypoints' and 'both': with a body,
    start, offsets and noise of the key points from the clip itself."""
    how = SubjectOptions("keypoints", frame_rate=scene.frame_rate, body=body)
    subject = find_subject(lambda i: frames[i], len(frames), how)
    return {
        evidence: track_source(
            FrameList(frames), scene.frame_rate, TrackOptions(seed=seed, evidence=evidence), subject=subject
        ).motion
        for evidence in ("keypoints", "both")
    }


def aligned_joints(motion: Motion, scene: Scene) -> Array:
    """(T, 19, 3) m: the motion's joints by the truth's definitions (population offsets, no subject information)."""
    assert motion.poses is not None
    rotations, _ = motion.skeleton.forward(motion.poses)
    return with_offsets(motion.joints, rotations, population_offsets(human()) * scene.subject.stature)
