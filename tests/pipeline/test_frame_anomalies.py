"""Evidence that speaks against itself: pictures that repeat or are missing, a view that disagrees; all else is fine."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from hypose.calibration.findings import INVALID, REVIEW
from hypose.evidence.frame import Keypoints
from hypose.pipeline.frame_anomalies import against_the_clip, find_anomalies, with_repeated_points
from hypose.tracking.covariance_calibration import apart_factors
from hypose.tracking.joint_features import AUDITED

T, C, RATE = 150, 4, 25.0
NAMES = ("a", "b", "c", "d")


@pytest.fixture
def clean(rng):
    """overlap, change of a person who walks to and fro: changes come and go within a step."""
    phase = 0.25 * np.arange(T)[:, None] + np.arange(C)
    change = 0.15 + 0.05 * np.sin(phase) + 0.02 * rng.standard_normal((T, C))
    overlap = 0.8 + 0.05 * rng.standard_normal((T, C))
    change[0] = np.nan
    return overlap, change


def find(overlap, change, known=None, others=None):
    known = np.ones(T, dtype=bool) if known is None else known
    others = np.zeros((T, C)) if others is None else others
    return dict(find_anomalies(overlap, change, others, known, RATE, NAMES))


def test_a_clean_clip_and_somebody_who_stands_still_are_not_doubted(clean):
    overlap, change = clean
    assert find(overlap, change) == {}
    change[1:] = 0.0
    assert find(overlap, change) == {}
    change[1:] = 0.005  # a flicker
    change[::3] = 0.0
    assert find(overlap, change) == {}


def test_pictures_that_come_twice_in_all_cameras(clean):
    overlap, change = clean
    change[41:90:2] = 0.0
    found = find(overlap, change)
    assert list(found) == ["all cameras repeat pictures"]
    frames = np.flatnonzero(found["all cameras repeat pictures"])
    assert frames[0] == 41 and 89 < frames[-1] <= 100 and len(frames) == frames[-1] - 40


def test_a_camera_that_lags_is_named(clean):
    overlap, change = clean
    for t in range(40, 90):
        change[t, 2] = 0.4 if t % 5 == 0 else 0.0
    found = find(overlap, change)
    assert list(found) == ["c repeats pictures while the others go on"]
    assert found["c repeats pictures while the others go on"][41:90].all()


def test_a_view_that_does_not_fit_any_more(clean):
    overlap, change = clean
    overlap[60:100, 1] -= 0.25
    found = find(overlap, change)
    assert list(found) == ["b disagrees with the other views"]
    frames = found["b disagrees with the other views"]
    assert frames[65:95].all() and not frames[:50].any() and not frames[110:].any()


def test_somebody_else_is_told_when_two_views_see_them_for_a_while(clean):
    others = np.zeros((T, C))
    others[60:100, :2] = 0.6
    others[75:85, 1] = 0.0  # in front of each other for a moment
    (what, frames), *more = find(*clean, others=others).items()
    assert (what, more) == ("another person or an object is in the masks", [])
    assert np.flatnonzero(frames).tolist() == list(range(60, 100))
    others[:, 1] = 0.1  # what a shadow leaves
    assert find(*clean, others=others) == {}


def points_that_move(rng, frames=75):
    """Motion and key points of somebody who walks, as a detector gives them."""
    scene = small_scene(1, 5)
    body = human()
    joints = body.joints(np.zeros((frames, body.skeleton.dof)))
    gone = np.zeros(frames, bool)
    motion = Motion(
        *(body.skeleton, np.arange(frames) / RATE, joints, None, isotropic(np.full(joints.shape[:2], 0.01))),
        *(gone, gone.copy(), np.full(frames, 2), np.full(frames, np.nan), {}),
    )
    rig = scene.given_rig.pinhole()
    names = ("nose", *(f"{s}_{n}" for s in ("left", "right") for n in ("hip", "knee", "ankle", "wrist")))
    base = rng.uniform(50, 200, (len(rig), len(names), 2))
    seen = []
    for t in range(frames):
        uv = base + 2.0 * t + rng.normal(0, 0.5, base.shape)
        seen.append(Keypoints(np.concatenate([uv, np.ones((*uv.shape[:2], 1))], -1), names, rig))
    return motion, seen


def test_key_points_that_come_twice_are_told_by_view_and_frames(rng):
    motion, seen = points_that_move(rng)
    assert with_repeated_points(motion, seen)[1] == []
    assert with_repeated_points(motion, [seen[0]] * len(seen))[1] == []  # who stands still repeats no picture
    frozen = [seen[30] if 30 <= t < 55 else k for t, k in enumerate(seen)]
    marked, notes = with_repeated_points(motion, frozen)
    assert "all cameras repeat pictures in frames 31-" in notes[0] and marked.low_confidence[31:55].all()
    assert not marked.low_confidence[:31].any()
    one = [replace(k, points=np.r_[frozen[t].points[:1], k.points[1:]]) for t, k in enumerate(seen)]
    name = seen[0].rig.names[0]
    assert f"{name} repeats pictures while the others go on" in with_repeated_points(motion, one)[1][0]


@pytest.mark.parametrize(
    ("apart_m", "bare", "told"),
    [
        (0.004, 0.0, []),
        (0.04, 0.0, [("views disagree", INVALID)]),
        (0.0, 0.03, [("larger masks", REVIEW)]),
        (0.012, 0.03, [("views disagree", INVALID), ("larger masks", INVALID)]),
    ],
)
def test_views_that_contradict_each_other_and_masks_that_show_more_are_told(apart_m, bare, told):
    audit = np.zeros((30, 19, len(AUDITED)), np.float32)
    audit[..., AUDITED.index("apart")] = np.hypot(apart_factors("silhouettes")[0], apart_m)
    audit[..., AUDITED.index("bare")] = bare
    assert [(f.kind, f.severity) for f in against_the_clip(audit, np.full(30, C), "silhouettes")] == told
