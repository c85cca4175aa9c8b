"""Outlines made ahead: for tracking, and only for those who ask for what was made."""

import numpy as np
import pytest

from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.outlines import WORKING_HEIGHT
from hypose.evidence.prefetch import look_ahead
from tests.capsule_person import ring


def frames(n=4, size=(200, 160)):
    rig = ring(2, f=200.0, size=size)
    out = []
    for t in range(n):
        masks = np.zeros((2, size[1], size[0]), np.uint8)
        masks[0, 40:90, 60 + t : 80 + t] = 1
        masks[1, 70:140, 20:50] = 1
        out.append(Frame(t / 25, t, Silhouettes(masks, rig, np.array([True, True]), ("", ""))))
    return out


def test_outlines_made_ahead_are_those_made_at_once():
    for frame, same in zip(look_ahead(frames()), frames(), strict=True):
        a, b = (f.silhouettes.outlines for f in (frame, same))
        assert frame.index == same.index
        for field in ("distance", "points", "found", "extent", "shrunk", "sizes", "corners"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


def test_distances_for_tracking_are_the_whole_ones_around_the_person():
    silhouettes = frames(1)[0].silhouettes
    whole, around = silhouettes.outlined(), silhouettes.outlined(working_height=WORKING_HEIGHT)
    for c in range(2):
        (x, y), (w, h) = around.corners[c], around.sizes[c]
        assert w < 200 or h < 160
        np.testing.assert_array_equal(around.distance[c, :h, :w], whole.distance[c, y : y + h, x : x + w])
    np.testing.assert_allclose(around.points, whole.points, atol=1e-4)


@pytest.mark.parametrize("factor", [1.5, 2, 2.5, 3])
def test_shrunk_outlines_lie_where_the_whole_ones_do(factor):
    silhouettes = frames(1)[0].silhouettes
    small = silhouettes.outlined(working_height=int(70 / factor))
    whole = silhouettes.outlined()
    for c in range(2):
        assert small.shrunk[c] == max(1, 2 * (50, 70)[c] // int(70 / factor) / 2)
        points = (small.points[c] + 0.5) * small.shrunk[c] - 0.5
        gap = np.linalg.norm(points[:, None] - whole.points[c][None], axis=-1).min(1)
        assert gap.max() < small.shrunk[c]
