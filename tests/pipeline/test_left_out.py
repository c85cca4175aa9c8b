"""How far joints go without a camera: nowhere where the views agree, furthest without the only one across."""

import numpy as np
import pytest

from hypose.body.motion import Motion, isotropic
from hypose.body.ready_bodies import human
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.keypoints import BODY_25
from hypose.pipeline.left_out import FRAMES, KeptFrames, evidence_said, left_out
from hypose.tracking.keypoint_evidence import keypoint_model
from tests.pipeline.test_camera_worth import ring

RIG = ring(0, 90, 180, 270)


@pytest.fixture(scope="module")
def walking():
    """A motion whose arms and legs swing, and the body."""
    body, n = human(), 30
    s = body.skeleton
    poses = np.tile(s.rest_pose(), (n, 1))
    poses[:, 2] = 0.95
    swing = np.sin(np.arange(n) / 4)
    for k, name in enumerate(("left_hip_rx", "right_hip_rx", "left_shoulder_rx", "right_shoulder_rx")):
        poses[:, s.dof_names.index(name)] = (0.4 if k % 2 else -0.4) * swing
    joints, none = body.joints(poses), np.zeros(n, bool)
    sds = isotropic(np.full(joints.shape[:2], 0.01))
    return Motion(s, np.arange(n) / 25, joints, poses, sds, none, none, np.full(n, 4), np.full(n, 0.1)), body


def seen(motion, body, rig=RIG, noise=0.0, blind=()):
    """Frames with the body's own key points, px of noise added; `blind` cameras see nothing."""
    model, rng = keypoint_model(body, BODY_25), np.random.default_rng(5)
    frames = {}
    for t in range(0, len(motion), 3):
        places = model.positions(body, motion.poses[t])
        points = np.zeros((len(rig), len(BODY_25), 3))
        for c, camera in enumerate(rig):
            points[c, :, :2] = camera.project_pinhole(places) + noise * rng.normal(size=(len(BODY_25), 2))
            points[c, model.known, 2] = 0.0 if c in blind else 1.0
        frames[t] = Frame(t / 25, t, None, Keypoints(points, BODY_25, rig))
    return frames


def test_views_that_agree_lose_nothing(walking):
    found = left_out(*walking, seen(*walking), "keypoints")
    assert [w.name for w in found] == ["c0", "c1", "c2", "c3"] and all(w.n == 10 for w in found)
    assert max(w.far for w in found) < 0.003


def test_the_only_camera_across_is_missed_most(walking):
    found = left_out(*walking, seen(*walking, rig=ring(0, 5, 10, 95), noise=3.0), "keypoints")
    moved = {w.name: w.moved for w in found}
    assert moved["c3"] > 2 * max(moved[n] for n in ("c0", "c1", "c2")) > 0.002
    assert all(w.far > w.moved for w in found)


def test_nothing_is_said_where_two_cameras_are_all_there_is(walking):
    assert left_out(*walking, seen(*walking, blind=(0, 1)), "keypoints") == []
    assert left_out(*walking, seen(*walking), "silhouettes") == []
    three = left_out(*walking, seen(*walking, blind=(1,)), "keypoints")
    assert [w.name for w in three] == ["c0", "c2", "c3"]


def test_frames_are_kept_as_they_go_by(walking):
    motion, body = walking
    frames = seen(motion, body)

    class Source:
        asked = 0

        def __len__(self):
            return len(motion)

        def frame(self, index, /):
            Source.asked += 1
            return frames.get(index, frames[0])

    kept = KeptFrames(Source(), motion)
    assert len(kept.rows) == FRAMES and kept.rows[0] == 0 and kept.rows[-1] == len(motion) - 1
    for t in range(20):
        kept.frame(t)
    assert set(kept.frames) == {r for r in kept.rows if r < 20}
    assert sorted(kept.every()) == kept.rows and Source.asked == 20 + sum(r >= 20 for r in kept.rows)
    assert evidence_said(motion) == "both"
