"""A recording of one frame: eight masks of a dancer. It is tracked, and a forearm that they contradict is doubted."""

import numpy as np
import pytest

from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.evidence.frame import Frame
from hypose.pipeline.assessment import GOOD, assess
from hypose.pipeline.run import track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED, population_offsets, with_offsets
from hypose.synthetic.performance import Angles, Stance, moved, perform
from hypose.synthetic.subjects import load_subjects
from hypose.tracking.error_model import judged
from hypose.tracking.joint_features import audit_frame

POSE = {
    "right_shoulder_flexion": -35,
    "right_shoulder_abduction": 30,
    "right_elbow_flexion": 60,
    "left_shoulder_abduction": 100,
    "left_elbow_flexion": 30,
    "spine_list": 8,
    "pelvis_turn": 20,
}


@pytest.fixture(scope="module")
def dancer():
    subject = load_subjects()["female-average"] if "female-average" in load_subjects() else None
    subject = subject or next(s for n, s in sorted(load_subjects().items()) if n != "neutral")
    times = np.arange(2) / 25
    course = {name: np.full(2, float(v)) for name, v in POSE.items()}
    dance = moved(perform(Angles("dance", times, course, Stance(0.15, -0.25, 0.12)), subject), 2.1)
    scene = noisy_scene(dance, subject, "ring-8", seed=11)
    frame = next(scene.mask_frames(0.5))
    return scene, frame, track_source(FrameList([frame]), 25.0, TrackOptions())


def test_one_frame_is_tracked(dancer):
    scene, _, result = dancer
    motion = result.motion
    assert len(motion) == 1 and result.complete and not motion.lost.any()
    rotations, _ = motion.skeleton.forward(motion.poses)
    joints = with_offsets(motion.joints, rotations, population_offsets(result.body) * scene.subject.stature)
    error = np.linalg.norm(joints[0] - scene.joints[0], axis=-1)[EVALUATED]
    assert error.mean() < 0.06
    assert np.isfinite(motion.joint_sd).all() and motion.error_probability is not None


def test_a_forearm_that_its_masks_leave_bare_is_doubted(dancer):
    _, frame, result = dancer
    motion, skeleton = result.motion, result.motion.skeleton
    wrist = skeleton.joint("left_wrist")
    pose = motion.poses[0].copy()
    arm = skeleton.dofs_of("left_shoulder", "left_elbow")
    folded = pose.copy()
    folded[arm] = np.r_[pose[skeleton.dofs_of("right_shoulder")] * (1, -1, -1), 1.5]  # down, the forearm to the body
    assert np.linalg.norm(result.body.joints(folded[None])[0, wrist] - motion.joints[0, wrist]) > 0.3
    found = []
    for q in (pose, folded):
        joints = result.body.joints(q[None])
        m = type(motion)(
            *(skeleton, motion.times, joints, q[None], motion.joint_covariance, motion.lost, motion.extrapolated),
            *(motion.n_views, motion.cost),
        )
        audit = audit_frame(result.body, q, Frame(0.0, 0, frame.silhouettes))[None]
        p, low_confidence = judged(m, joints, audit)
        found.append((float(p[0, wrist]), bool(low_confidence[0, wrist]), assess(_with(m, p, low_confidence))))
    (right, _, _), (wrong, reported, assessment) = found
    assert wrong > 3 * right and wrong > 0.3 and reported
    assert assessment.word != GOOD


def _with(motion, p, low_confidence):
    from dataclasses import replace

    return replace(
        motion, error_probability=p, low_confidence_joints=low_confidence, low_confidence=low_confidence.any(1)
    )
