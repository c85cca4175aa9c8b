"""A recording of one frame: eight masks of a dancer."""

import numpy as np

from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED, population_offsets, with_offsets
from hypose.synthetic.performance import Angles, Stance, moved, perform
from hypose.synthetic.subjects import load_subjects

POSE = {
    "right_shoulder_flexion": -35,
    "right_shoulder_abduction": 30,
    "right_elbow_flexion": 60,
    "left_shoulder_abduction": 100,
    "left_elbow_flexion": 30,
    "spine_list": 8,
    "pelvis_turn": 20,
}


def test_one_frame_is_tracked():
    subject = next(s for n, s in sorted(load_subjects().items()) if n != "neutral")
    times = np.arange(2) / 25
    course = {name: np.full(2, float(v)) for name, v in POSE.items()}
    dance = moved(perform(Angles("dance", times, course, Stance(0.15, -0.25, 0.12)), subject), 2.1)
    scene = noisy_scene(dance, subject, "ring-8", seed=11)
    result = track_source(FrameList([next(scene.mask_frames(0.5))]), 25.0, TrackOptions())
    motion = result.motion
    assert len(motion) == 1 and result.complete and not motion.lost.any()
    rotations, _ = motion.skeleton.forward(motion.poses)
    joints = with_offsets(motion.joints, rotations, population_offsets(result.body) * scene.subject.stature)
    error = np.linalg.norm(joints[0] - scene.joints[0], axis=-1)[EVALUATED]
    assert error.mean() < 0.06
    assert np.isfinite(motion.joint_sd).all() and motion.error_probability is not None
