"""Whole clips: smooth without lag, gaps bridged with growing uncertainty, feet held, windows without seams."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.motion import Motion, isotropic
from hypose.errors import EvidenceError
from hypose.evidence.keypoints import BODY_25B
from hypose.evidence.terms import PointTerm
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.keypoint_clip import track_keypoint_clip
from hypose.tracking.refinement import packed
from hypose.tracking.smoothing import ClipSettings, smooth_motion, smooth_poses
from tests.tracking.test_keypoint_evidence import seen_by

RATE = 25.0


@pytest.fixture
def swing(body, standing):
    """Poses (40, D): arms and trunk swing at 1 Hz, the legs stand."""
    t = np.arange(40) / RATE
    poses = np.repeat(standing[None], len(t), 0)
    arm = body.skeleton.dofs_of("left_shoulder", "right_shoulder", "left_elbow", "spine")
    poses[:, arm] += 0.4 * np.sin(2 * np.pi * t)[:, None] - 0.3
    return body.skeleton.clamp(poses)


def information(poses, sd=0.05):
    return np.repeat(np.diag(np.full(poses.shape[1], sd**-2.0))[None], len(poses), 0)


def motion_of(body, poses, lost=()):
    n = len(poses)
    flags = np.isin(np.arange(n), lost)
    sd = isotropic(np.full((n, len(body.skeleton.joint_names)), 0.01))
    return Motion(
        body.skeleton, np.arange(n) / RATE, body.joints(poses), poses, sd, flags, flags, np.full(n, 4), np.full(n, 0.1)
    )


def distances(body, a, b):
    return np.linalg.norm(body.joints(a) - body.joints(b), axis=-1)


def test_noise_goes_and_no_lag_comes(body, swing, rng):
    noise = 0.05 * rng.normal(size=swing.shape)
    noise[:, :3] *= 0.1
    noisy = body.skeleton.clamp(swing + noise)
    own = information(swing)
    own[:, :3, :3] *= 100
    smooth = smooth_poses(body, noisy, own, RATE, ClipSettings(acceleration_rad=20.0))
    assert distances(body, smooth, swing).mean() < 0.7 * distances(body, noisy, swing).mean()
    angle = body.skeleton.dofs_of("left_elbow")[0]

    def agreement(shift):
        return np.corrcoef(smooth[5 + shift : 35 + shift, angle], swing[5:35, angle])[0, 1]

    assert agreement(0) > max(agreement(1), agreement(-1))


def test_fast_motion_is_not_flattened(body, swing):
    legs = body.skeleton.dofs_of("left_hip", "right_hip")[[0, 3]]
    rate, poses = 125.0, np.repeat(swing[:1], 90, 0)
    poses[:, legs] += 0.6 * np.sin(2 * np.pi * 3 * np.arange(90) / rate)[:, None] * (1, -1)  # three strides a second
    poses = body.skeleton.clamp(poses)
    knees = [body.skeleton.joint(f"{side}_knee") for side in ("left", "right")]

    def off(**settings):
        found = smooth_poses(body, poses, information(poses, 0.1), rate, ClipSettings(**settings))
        return distances(body, found, poses)[10:-10, knees].mean()

    assert off(rounds=1) > 0.02
    assert off() < 0.4 * off(rounds=1)


def test_a_gap_is_bridged_flagged_and_less_certain(body, swing):
    lost = range(15, 21)
    tracked = swing.copy()
    tracked[15:21] += 0.5  # what a lost tracker says does not count
    given = np.stack([packed(i) for i in information(swing, 0.02)])
    result = smooth_motion(body, motion_of(body, tracked, lost), given).motion
    assert distances(body, result.poses, swing)[15:21].mean() < 0.06
    assert result.lost[15:21].all() and result.lost.sum() == 6
    sd = result.joint_sd.mean(1)
    assert sd[17] > sd[15] > sd[13] and sd[17] > 1.5 * sd[5]
    assert sd[18] > sd[20]


def test_feet_are_held(body, swing, rng):
    noise = np.zeros_like(swing)
    legs = body.skeleton.dofs_of("left_hip", "right_hip", "left_knee", "right_knee")
    noise[:, legs] = 0.02 * rng.normal(size=(40, len(legs)))
    noisy = body.skeleton.clamp(swing + noise)
    given = np.stack([packed(i) for i in information(swing, 0.05)])
    found = smooth_motion(body, motion_of(body, noisy), given)
    assert found.contacts > 0.8
    assert found.slid < 0.3 * found.slid_before
    assert any("slide" in note for note in found.notes)


def test_other_evidence_counts_in_a_clip_of_key_points(body, swing, small_rig, rng):
    model, wrist, swing = keypoint_model(body, BODY_25B), body.skeleton.joint("left_wrist"), swing[:12]
    seen = [seen_by(small_rig, model, body, q, rng, 0.5) for q in swing]
    for frame in seen:
        frame.points[:, [model.names.index(n) for n in ("left_wrist", "left_elbow")], 2] = 0
    places = body.joints(swing)[:, wrist]
    others = [[PointTerm(p[None], np.ones(1), np.array([wrist]), np.zeros((1, 3)), 0.01)] for p in places]
    off = [
        np.linalg.norm(
            track_keypoint_clip(body, model, seen, swing[0], RATE, others=given).motion.joints[:, wrist] - places,
            axis=1,
        ).mean()
        for given in ((), others)
    ]
    assert off[1] < 0.02 and off[1] < 0.5 * off[0], off


def test_key_points_of_a_whole_clip_are_tracked(body, swing, small_rig, rng):
    model = keypoint_model(body, BODY_25B)
    seen = [seen_by(small_rig, model, body, q, rng, 0.5) for q in swing]
    few = seen[8].points.copy()
    few[:, 3:, 2] = 0  # the face only: no pose
    seen[8] = replace(seen[8], points=few)
    seen[14:] = [None] * 26
    found = track_keypoint_clip(body, model, seen, swing[0], RATE)
    motion = found.motion
    limits = body.skeleton
    assert (motion.poses >= limits.lower - 1e-9).all() and (motion.poses <= limits.upper + 1e-9).all()
    assert distances(body, motion.poses, swing)[:14].mean() < 0.02
    assert np.flatnonzero(motion.extrapolated).tolist() == [8, *range(14, 40)]
    assert np.flatnonzero(motion.lost).tolist() == [39]  # more than a second after the last key points
    sd = motion.joint_sd.mean(1)
    assert (np.diff(sd[13:]) > 0).all() and sd[8] > sd[7] and np.isfinite(sd).all()
    assert motion.n_views[0] == len(small_rig) and motion.n_views[20] == 0
    assert found.contacts > 0.2 and found.slid <= found.slid_before + 1e-9
    with pytest.raises(EvidenceError, match="0 of 3 frames"):
        track_keypoint_clip(body, model, [None] * 3, swing[0], RATE)
