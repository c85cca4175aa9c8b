"""Evidence that speaks against itself: pictures that repeat or are missing, a view that disagrees; all else is fine."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from hypose.evidence.frame import Expected, Keypoints
from hypose.pipeline.frame_anomalies import find_anomalies, view_statistics, with_repeated_points
from hypose.tracking.pose_covariance import PoseUncertainty
from hypose.tracking.tracker import FrameEstimate

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


def test_a_clean_clip_is_not_doubted(clean):
    assert find(*clean) == {}


def test_somebody_who_stands_still_is_not_a_repeated_picture(clean):
    overlap, change = clean
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
    others[60:63, 1] = 0.6  # a tenth of a second
    assert find(*clean, others=others) == {}
    others[60:100, :2] = 0.6
    assert find(*clean, known=np.arange(T) > 120, others=others).keys() == {"the person has just been found again"}


def test_tracking_that_has_not_come_back(clean):
    overlap, change = clean
    others = np.zeros((T, C))
    others[60:100] = 0.6
    overlap[60:130] -= 0.12  # turned around by what was there, until it finds back
    found = find(overlap, change, others=others)
    assert list(found) == ["another person or an object is in the masks", "the body fits less well than before that"]
    frames = np.flatnonzero(found["the body fits less well than before that"])
    assert frames[0] == 100 and 125 <= frames[-1] <= 135
    assert find(overlap, change) == {}  # nothing happened: it fits less well, and that is all


def test_views_and_frames_without_a_mask(clean):
    overlap, change = clean
    overlap[:, 3], change[:, 3] = np.nan, np.nan  # a camera that never delivered anything
    overlap[20:60], change[20:60] = np.nan, np.nan
    known = np.ones(T, dtype=bool)
    known[20:60] = False
    found = find(overlap, change, known)
    assert list(found) == ["the person has just been found again"]
    assert np.flatnonzero(found["the person has just been found again"]).tolist() == list(range(60, 70))
    assert find(np.full((T, C), np.nan), np.full((T, C), np.nan)) == {}
    few = np.zeros((3, C))
    assert find_anomalies(few + 1, few, few, np.ones(3, bool), RATE, NAMES) == []


def test_a_view_in_which_others_hide_the_person_is_not_compared_with_the_rest():
    frame = next(iter(small_scene(1, 1).mask_frames()))
    s = frame.silhouettes
    rows = [np.flatnonzero(m.any(1)) for m in s.masks]
    h, w = s.masks.shape[1:]
    ignored = np.zeros_like(s.masks)
    ignored[0, : rows[0][len(rows[0]) // 2]] = 1  # half of the person
    ignored[1, : rows[1][3]] = 1  # a little
    boxes = np.tile([0, h, 0, w], (len(s.masks), 1))
    hidden = replace(s, ignored=ignored, expected=Expected(boxes, s.masks.sum((1, 2)).astype(np.int64)))
    overlap = np.full(len(s.masks), 0.5)
    nothing = PoseUncertainty(np.zeros(1), np.zeros((1, 3, 3)))
    estimate = FrameEstimate(np.zeros(human().skeleton.dof), nothing, 0.1, False, False, 4, overlap)
    seen = view_statistics(estimate, human(), replace(frame, silhouettes=hidden), None)
    assert np.isnan(seen[0, 0]) and np.allclose(seen[1:, 0], 0.5)
    assert np.allclose(view_statistics(estimate, human(), frame, None)[:, 0], 0.5)


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
    frozen = [seen[30] if 30 <= t < 55 else k for t, k in enumerate(seen)]
    marked, notes = with_repeated_points(motion, frozen)
    assert "all cameras repeat pictures in frames 31-" in notes[0] and marked.low_confidence[31:55].all()
    assert not marked.low_confidence[:31].any()
    one = [replace(k, points=np.r_[frozen[t].points[:1], k.points[1:]]) for t, k in enumerate(seen)]
    name = seen[0].rig.names[0]
    assert f"{name} repeats pictures while the others go on" in with_repeated_points(motion, one)[1][0]


def test_key_points_of_somebody_who_stands_still_are_no_repeated_pictures(rng):
    motion, seen = points_that_move(rng)
    assert with_repeated_points(motion, [seen[0]] * len(seen))[1] == []
