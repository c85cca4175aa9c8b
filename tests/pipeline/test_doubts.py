"""Evidence that speaks against itself: pictures that repeat or are missing, a view that disagrees; all else is fine."""

import numpy as np
import pytest

from hypose.pipeline.doubts import find_doubts

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


def find(overlap, change, known=None):
    known = np.ones(T, dtype=bool) if known is None else known
    return dict(find_doubts(overlap, change, known, RATE, NAMES))


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


def test_a_gap_in_the_recording(clean):
    overlap, change = clean
    change[70] = (0.6, 0.5, 0.2, 0.7)  # along the third camera's line of sight hardly anything moves
    found = find(overlap, change)
    assert list(found) == ["time jumps"]
    assert np.flatnonzero(found["time jumps"]).tolist() == list(range(70, 81))


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


def test_all_views_worse_is_no_quarrel_among_them(clean):
    overlap, change = clean
    overlap[60:100] -= 0.25
    assert find(overlap, change) == {}


def test_views_and_frames_without_a_mask(clean):
    overlap, change = clean
    overlap[:, 3], change[:, 3] = np.nan, np.nan  # a camera that never delivered anything
    overlap[20:60], change[20:60] = np.nan, np.nan
    known = np.ones(T, dtype=bool)
    known[20:60] = False
    found = find(overlap, change, known)
    assert list(found) == ["somebody has just been found again"]
    assert np.flatnonzero(found["somebody has just been found again"]).tolist() == list(range(60, 70))
    assert find(np.full((T, C), np.nan), np.full((T, C), np.nan)) == {}
    assert find_doubts(np.ones((3, C)), np.zeros((3, C)), np.ones(3, bool), RATE, NAMES) == []
