"""The silhouette cost of eq. 2.8 and the overlap read off it."""

import numpy as np
import pytest

from hypose.tracking.frame_evidence import prepare, view_count


def test_energy_is_the_printed_sum_over_views(body, standing, frame_of):
    """Alcoverro 2014, eq. 2.8: sum over views of XOR over silhouette pixels, from masks drawn by another rasterizer."""
    frame = frame_of(body, standing)
    moved = standing.copy()
    moved[1] += 0.07
    own = frame_of(body, moved).silhouettes
    assert frame.silhouettes is not None and own is not None
    expected = sum(float((a != b).sum()) / a.sum() for a, b in zip(frame.silhouettes.masks, own.masks, strict=True))
    energy = prepare(frame, body, standing).silhouettes.energy(body, moved[None])[0]
    assert energy == pytest.approx(expected, abs=0.02)


def test_an_empty_view_is_left_out_not_divided_by_zero(body, standing, frame_of):
    whole = prepare(frame_of(body, standing), body, standing)
    without = prepare(frame_of(body, standing, dead=(1,)), body, standing)
    moved = standing + np.r_[0.05, np.zeros(len(standing) - 1)]
    assert view_count(without) == 3
    assert np.isfinite(without.silhouettes.energy(body, moved[None])).all()
    assert without.silhouettes.energy(body, moved[None])[0] < whole.silhouettes.energy(body, moved[None])[0]
