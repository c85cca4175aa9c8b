import numpy as np
import pytest

from hypose.errors import InputError
from hypose.synthetic.scenes import Corruptions, camera_rig, corruptions, disturb_rig, occluder_mesh


def test_names_combine_and_unknown_ones_are_refused():
    c = corruptions("table", "desync")
    assert (c.occluder, c.desync, c.dead_camera) == ("table", (0, 1, 0, 2), -1)
    assert corruptions() == Corruptions()
    with pytest.raises(InputError, match="table"):
        corruptions("gremlins")
    with pytest.raises(InputError, match="table and treadmill"):
        occluder_mesh("sofa")


def test_calibration_error_is_about_one_percent():
    true = camera_rig("humaneva-4")
    focal, place = [], []
    for seed in range(40):
        off = disturb_rig(true, 0.01, np.random.default_rng(seed))
        for a, b in zip(true, off, strict=True):
            focal.append(b.K[0, 0] / a.K[0, 0] - 1)
            place.append((b.position - a.position) / np.linalg.norm(a.position - [0, 0, 0.95]))
    assert np.std(focal) == pytest.approx(0.01, rel=0.2)
    assert np.std(place) == pytest.approx(0.01, rel=0.2)
    assert disturb_rig(true, 0.0, np.random.default_rng(0)) is true
