"""Key points spoilt on purpose: what is meant happens, nothing else, and the same with the same seed."""

import numpy as np
import pytest

from benchmarks.synthetic.spoilt_keypoints import SPOILS, spoilt
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.keypoints import BODY_25
from hypose.synthetic.scenes import camera_rig


@pytest.fixture(scope="module")
def frames():
    cameras, rng = camera_rig("humaneva-4"), np.random.default_rng(0)
    base = np.concatenate([rng.uniform(100, 400, (4, 25, 2)), np.ones((4, 25, 1))], -1)
    drift = np.array([0.5, 0.2, 0.0])
    return [Frame(t / 25, t, None, Keypoints(base + t * drift, BODY_25, cameras)) for t in range(60)]


def points(frames):
    return np.stack([f.keypoints.points for f in frames])


@pytest.mark.parametrize("how", sorted(SPOILS))
def test_the_same_seed_spoils_the_same(frames, how):
    a, b, c = (points(spoilt(frames, how, np.random.default_rng(s))) for s in (1, 1, 2))
    assert a.shape == points(frames).shape and np.isfinite(a).all()
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, points(frames)) and (how == "late" or not np.array_equal(a, c))


def test_what_is_spoilt_is_what_is_meant(frames):
    given, rng = points(frames), np.random.default_rng
    assert (points(spoilt(frames, "dropped", rng(0)))[..., 2] == 0).mean() == pytest.approx(0.6, abs=0.03)
    off = points(spoilt(frames, "shifted", rng(0))) - given
    assert np.count_nonzero(np.abs(off).max((0, 2, 3)) > 1) == 1
    late = points(spoilt(frames, "late", rng(0)))
    view = int(np.argmax(np.abs(late - given).max((0, 2, 3))))
    np.testing.assert_array_equal(late[6:, view], given[:-6, view])
    changed = np.abs(points(spoilt(frames, "swapped", rng(4))) - given).max((0, 1, 3)) > 0
    assert changed[BODY_25.index("left_wrist")] or changed[BODY_25.index("left_knee")]
    assert not changed[BODY_25.index("nose")]


def test_what_is_guessed_stays_as_sure_and_is_of_one_limb(frames):
    given = points(frames)
    for seed in range(6):
        found = points(spoilt(frames, "guessed", np.random.default_rng(seed)))
        np.testing.assert_array_equal(found[..., 2], given[..., 2])
        off = np.linalg.norm((found - given)[..., :2], axis=-1).max(0)  # (C, K)
        moved = [BODY_25[k] for k in np.flatnonzero((off > 1).any(0))]
        assert 1 <= np.count_nonzero((off > 1).any(1)) <= 2 and 1 < len(moved) <= 5
        assert len({n.split("_")[0] for n in moved}) == 1 and not {"left_hip", "left_shoulder"} & set(moved)
        close = points(spoilt(frames, "close_up", np.random.default_rng(seed)))
        views = (close[..., 2] > 0).any(0).sum(0)  # of each point
        assert set(np.unique(views)) == {2, 4} and views[BODY_25.index("nose")] == 4
