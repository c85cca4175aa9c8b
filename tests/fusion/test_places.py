"""Where a sensor stands, when nobody knows who is who."""

import numpy as np
import pytest

from hypose.app.live.simulated_sensors import builtin_joints
from hypose.fusion.joints import MIRROR
from hypose.fusion.people import find_place
from hypose.geometry import se3, se3_inverse, so3_exp, transform


def people(rng, count):
    """(T, count, 15, 3) walkers 1.5 m apart."""
    walk = builtin_joints("walk", 8.0, rng)
    return np.stack([walk[30 * p : 30 * p + 60 : 5] + [1.5 * p, 0.4 * p, 0] for p in range(count)], 1)


@pytest.mark.parametrize("exchanged", [False, True])
def test_the_place_is_found_among_six_persons_whose_numbers_say_nothing(rng, exchanged):
    common = people(rng, 6)
    place = se3(so3_exp(np.array([0.3, -2.0, 0.5])), np.array([1.0, -0.5, 2.0]))
    order = rng.permutation(6)
    shots = []
    for frame in common:
        seen = transform(se3_inverse(place), frame + rng.normal(0, 0.005, frame.shape))
        seen = seen[:, MIRROR] if exchanged else seen
        shots.append((dict(enumerate(seen[order])), dict(enumerate(frame))))
    found = find_place(shots, 5, 0.15, 0.7)
    assert found is not None
    np.testing.assert_allclose(found[0], place, atol=0.02)
    assert found[1] < 0.03
