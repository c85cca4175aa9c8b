"""The probability that a joint is wrong: from what an audit found, with weights that speak one way."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.motion import Motion, isotropic
from hypose.tracking.error_features import AROUND_S, FEATURES, clip_features
from hypose.tracking.error_model import (
    BY_ITSELF,
    CALM_P,
    ELSEWHERE_M,
    GROUPS,
    as_mixture,
    doubt_of_clip,
    error_models,
    evidence_of,
    groups_of,
    judged,
    needs_review,
    without_mixture,
)
from hypose.tracking.joint_features import AUDITED

NAMES = human().skeleton.joint_names


def clip(frames=30, points=False, masks=True):
    body = human()
    poses = np.zeros((frames, body.skeleton.dof))
    joints = body.joints(poses)
    lost = np.zeros(frames, bool)
    motion = Motion(
        *(body.skeleton, np.arange(frames) / 25, joints, poses, isotropic(np.full(joints.shape[:2], 0.012))),
        *(lost, lost.copy(), np.full(frames, 4), np.full(frames, 0.17 if masks else np.nan)),
    )
    usual = {"bare": 0.005, "bare_second": 0.001, "bare_reach": 0.05, "exposed": 2.0, "exposed_second": 0.6}
    usual |= {"exchanged": -0.06, "points_agree": 4}
    usual |= {"outside": 0.05, "points_median": 0.02, "points_worst": 0.05, "points_views": 4, "points_all": 0.02}
    audit = np.zeros((*joints.shape[:2], len(AUDITED)), np.float32)
    for k, name in enumerate(AUDITED):
        there = points if name.startswith("points") else masks or name == "rival"
        audit[..., k] = usual.get(name, 0.0) if there else np.nan
    return motion, joints, audit


@pytest.mark.parametrize(
    ("masks", "points", "evidence"),
    [(True, False, "silhouettes"), (False, True, "keypoints"), (True, True, "both")],
)
def test_a_clean_clip_is_not_doubted_and_an_arm_that_disagrees_is(masks, points, evidence):
    motion, joints, audit = clip(points=points, masks=masks)
    assert evidence_of(audit) == evidence
    p, low_confidence = judged(motion, joints, audit)
    assert p.shape == low_confidence.shape == joints.shape[:2] and p.dtype == np.float32
    assert not low_confidence.any() and p.max() < 0.05
    wrist = NAMES.index("right_wrist")
    bad = audit.copy()
    shown = {"bare": 0.2, "bare_second": 0.08, "bare_reach": 0.4, "outside": 1.5}
    shown |= {"rival": 0.15, "elsewhere": 0.2, "elsewhere_by": 0.3}
    for name, value in shown.items():
        if masks:
            bad[10:20, wrist, AUDITED.index(name)] = value
    for name, value in (("points_median", 0.3), ("points_worst", 0.4), ("points_views", 2), ("points_agree", 0)):
        if points:
            bad[10:20, wrist, AUDITED.index(name)] = value
    jumped = joints.copy()
    jumped[12:16, wrist] += 0.25
    again, flagged = judged(motion, jumped, bad)
    assert again[15, wrist] > 5 * p[15, wrist]
    # detectors err alone so often that a key point far from a joint says little when nothing else does
    assert flagged[15, wrist] or not masks
    # a second later nothing tells of the arm at a leg, but what kind of clip it is in
    own = [k for k, n in enumerate(FEATURES) if not n.endswith("_of_clip")]
    knee = NAMES.index("left_knee")
    before, after = clip_features(motion, joints, audit), clip_features(motion, jumped, bad)
    np.testing.assert_allclose(after[28, knee, own], before[28, knee, own], atol=1e-6)
    if points:
        assert again[28, knee] == pytest.approx(p[28, knee], abs=1e-6)


@pytest.mark.parametrize("cost", [0.17, 0.3, 0.45, 0.62])
def test_an_arm_that_is_plainly_wrong_is_told_however_badly_the_clip_fits(cost):
    motion, joints, audit = clip()
    wrist = NAMES.index("right_wrist")
    shown = {"bare": 0.2, "bare_second": 0.08, "bare_reach": 0.4, "outside": 1.5, "rival": 0.15}
    for frames in (slice(10, 20), slice(None)):
        bad = audit.copy()
        for name, value in shown.items():
            bad[frames, wrist, AUDITED.index(name)] = value
        p, flagged = judged(replace(motion, cost=np.full(len(joints), cost)), joints, bad)
        assert p[15, wrist] > 0.2 and flagged[15, wrist]


def test_what_one_view_alone_shows_is_doubted_unless_a_second_one_is_near_in_time():
    motion, joints, audit = clip(points=True, masks=False)
    ankle, views = NAMES.index("left_ankle"), AUDITED.index("points_views")
    audit[:, ankle, views] = 1
    p, low_confidence = judged(motion, joints, audit)
    assert low_confidence[:, ankle].all() and p[:, ankle].min() >= 0.4 - 1e-6
    assert not np.delete(low_confidence, ankle, 1).any()
    audit[::6, ankle, views] = 2
    p, low_confidence = judged(motion, joints, audit)
    assert low_confidence[:, ankle].all() and np.allclose(p[:, ankle], 0.3)  # one of the two may have guessed it
    cut = audit.copy()
    cut[..., views] = np.minimum(cut[..., views], 2)  # two cameras see nobody's limbs more than twice
    assert not judged(motion, joints, cut)[1].any()
    audit[::6, ankle, views] = 3  # a limb is where it was a tenth of a second ago
    assert not judged(motion, joints, audit)[1].any()
    both = clip(points=True)
    both[2][:, ankle, views] = 1
    assert not judged(*both)[1].any()  # masks show it as well


def test_features_are_finite_whatever_is_missing():
    motion, joints, audit = clip(frames=2)
    audit[0] = np.nan
    found = clip_features(motion, joints, audit)
    assert found.shape == (2, len(NAMES), len(FEATURES)) and np.isfinite(found).all()


def test_in_a_clip_that_is_doubtful_as_a_whole_joints_are_told_less_surely_in_the_same_order():
    groups = groups_of(NAMES)
    sure = np.full((10, len(NAMES)), -6.0)
    assert doubt_of_clip(sure, NAMES) == 0.0 and doubt_of_clip(sure[:1, :3], NAMES[:3]) == 0.0
    assert doubt_of_clip(np.zeros((10, len(NAMES))), NAMES) == pytest.approx(np.log(0.5 / CALM_P))
    sure[:, groups == GROUPS.index("wrists")] = 40.0  # every group counts the same, however many its joints are
    assert doubt_of_clip(sure, NAMES) == pytest.approx(np.log(1 / 7 / CALM_P), abs=0.02)
    odds = np.linspace(-6, 6, 25)[:, None] * np.ones(len(NAMES))
    for evidence, model in error_models().items():
        calm, wrong = (model.within(odds, NAMES, clip) for clip in (0.0, np.log(1 / CALM_P)))
        assert (np.diff(calm, axis=0) > 0).all() and (np.diff(wrong, axis=0) > 0).all()
        if evidence == "silhouettes":
            assert (np.ptp(wrong, axis=0) < 0.5 * np.ptp(calm, axis=0)).all()
        each = model.within(odds, NAMES, np.linspace(0, 1, 25))  # a clip's doubt for each row
        assert np.allclose(each[-1], model.within(odds[-1:], NAMES, 1.0))


def test_where_masks_show_more_than_the_body_arms_are_doubted():
    motion, joints, audit = clip()
    more, bare, second = FEATURES.index("more_mask"), AUDITED.index("bare"), AUDITED.index("bare_second")
    alone, chair = audit.copy(), audit.copy()
    for masks, m2 in ((alone, 0.001), (chair, 0.006)):  # of a view, and in the second-barest one as well
        masks[..., bare], masks[..., second] = m2 * motion.n_views[:, None], m2
    assert (clip_features(motion, joints, alone)[..., more] == 0).all()
    assert np.allclose(clip_features(motion, joints, chair)[..., more], np.log(0.006 / 0.0022))
    arms = np.isin(groups_of(NAMES), [GROUPS.index("elbows"), GROUPS.index("wrists")])
    before, now = (judged(motion, joints, a)[0] for a in (alone, chair))
    assert (now[:, arms] > 3 * before[:, arms]).all()


@pytest.mark.parametrize(("masks", "points"), [(True, False), (False, True), (True, True)])
def test_who_is_turned_as_far_as_a_trunk_goes_has_limbs_on_the_wrong_side(masks, points):
    motion, joints, audit = clip(points=points, masks=masks)
    assert motion.poses is not None
    turn = motion.skeleton.dof_names.index("spine_rz")
    limbs = np.array([n.startswith(("left_", "right_")) for n in NAMES])
    poses = motion.poses.copy()
    poses[4:6, turn] = -motion.skeleton.upper[turn]
    p, low_confidence = judged(replace(motion, poses=poses), joints, audit)
    near = slice(0, 6 + int(AROUND_S * 25))
    assert (p[near][:, limbs] >= 0.5).all() and low_confidence[near][:, limbs].all()
    assert not low_confidence[:, ~limbs].any() and not low_confidence[-8:].any()
    poses[4:6, turn] = np.radians(40)  # as a boxer may
    assert not judged(replace(motion, poses=poses), joints, audit)[1].any()


def test_a_frame_is_worth_a_look_where_wrong_joints_are_to_be_expected():
    p = np.full((4, len(NAMES)), 0.02, np.float32)
    joints = np.zeros(p.shape, bool)
    p[1, :3], p[2, 0], p[3, 0] = 0.1, 0.3, 0.1
    joints[1, :3] = joints[2, 0] = joints[3, 0] = True
    assert needs_review(p, joints, "silhouettes").tolist() == [False, True, True, False]
    assert needs_review(p, joints, "both").tolist() == [False, True, True, True]


def test_who_is_lost_is_not_believed():
    motion, joints, audit = clip()
    motion.lost[5:8] = True
    p, low_confidence = judged(motion, joints, audit)
    assert (p[5:8] >= 0.5).all() and low_confidence[5:8].all() and not low_confidence[10:].any()


def test_a_joint_beside_wrong_ones_is_told_less_surely_right():
    model = error_models()["silhouettes"]
    odds = np.full((1, len(NAMES)), -4.0)
    near = odds.copy()
    near[0, [NAMES.index(f"right_{n}") for n in ("shoulder", "wrist")]] = 2.0
    told, beside = (model.within(x, NAMES, 0.5)[0] for x in (odds, near))
    elbow, other = NAMES.index("right_elbow"), NAMES.index("left_elbow")
    assert beside[elbow] > told[elbow] + 0.5 and beside[other] == pytest.approx(told[other])
    assert beside[NAMES.index("right_knee")] == told[NAMES.index("right_knee")]
    # of what is asked of joints by themselves, neighbours change nothing
    alone = replace(model, in_clip=np.tile(BY_ITSELF, (len(GROUPS), 1)))
    assert np.array_equal(alone.within(near, NAMES, 0.5), near)


def test_a_doubtful_joint_may_be_elsewhere_and_its_sd_says_so():
    walk, _, _ = clip()
    names = walk.skeleton.joint_names
    ankle, shape = names.index("left_ankle"), walk.joints.shape[:2]
    p, low_confidence = np.full(shape, 0.02, np.float32), np.zeros(shape, bool)
    p[:, ankle], low_confidence[:, ankle] = 0.3, True
    sd = np.full((len(walk), len(ANGLE_NAMES)), 0.05, np.float32)
    motion = replace(walk, error_probability=p, low_confidence_joints=low_confidence, angle_sd=sd)
    told = as_mixture(motion)
    others = np.arange(len(names)) != ankle
    np.testing.assert_allclose(told.joint_covariance[:, others], walk.joint_covariance[:, others], rtol=1e-6)
    more = told.joint_covariance[:, ankle] - walk.joint_covariance[:, ankle]
    np.testing.assert_allclose(more, np.broadcast_to(0.3 * ELSEWHERE_M**2 / 3 * np.eye(3), more.shape), rtol=1e-4)
    wider = {n for n, s in zip(ANGLE_NAMES, told.angle_sd[0], strict=True) if s > 0.1}
    assert wider == {"knee_angle_l"}
    before = without_mixture(told)
    np.testing.assert_allclose(before.joint_covariance, walk.joint_covariance, atol=1e-8)
    np.testing.assert_allclose(before.angle_sd, sd, rtol=1e-5)


def test_nothing_is_surer_than_its_covariance():
    motion, joints, audit = clip(points=True, masks=False)
    head = NAMES.index("head")
    wide = motion.joint_covariance.copy()
    wide[:, head] = np.diag([0.15**2, 0.01**2, 0.01**2])
    p, low_confidence = judged(replace(motion, joint_covariance=wide), joints, audit)
    assert low_confidence[:, head].all() and (p[:, head] > 0.3).all()
    assert np.delete(p, head, 1).max() < 0.05 and not np.delete(low_confidence, head, 1).any()
