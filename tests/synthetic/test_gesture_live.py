"""The simulated person who moves as it is asked to."""

import numpy as np
import pytest

from hypose.synthetic.gesture_scenes import live_person

RATE = 8.0


@pytest.fixture(scope="module")
def frames():
    """2 s of other movement, 3 s of the gesture, 1 s of other movement: (asked, frame)."""
    person = live_person(0, "tee", np.random.default_rng(5), RATE)
    out = [(False, next(person))]
    for k in range(1, int(6 * RATE)):
        asked = 2 * RATE <= k < 5 * RATE
        out.append((asked, person.send(asked)))
    return out


def test_it_does_the_gesture_when_asked_and_only_then(frames):
    wanted = [f for asked, f in frames if asked]
    assert all(f.point is None for asked, f in frames if not asked)
    # on its way for at most a second, then the gesture is there nearly all the time
    late = wanted[int(RATE) :]
    assert sum(f.point is not None for f in late) >= 0.7 * len(late)
    assert all(0 < f.point[0] < 640 and 0 < f.point[1] < 480 for f in late if f.point)
