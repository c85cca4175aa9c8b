import cv2
import numpy as np
import pytest

from benchmarks.synthetic.noisy_masks import LEVELS, MaskFaults, corrupt_mask
from hypose.errors import InputError
from hypose.synthetic.corruptions import Corruptions, corruptions, disturb_rig, occluder_mesh
from hypose.synthetic.scenes import camera_rig


@pytest.fixture
def mask():
    m = np.zeros((240, 320), np.uint8)
    cv2.ellipse(m, (160, 120), (35, 90), 0, 0, 360, 1, -1)
    return m


def mean_change(mask, faults):
    """Mean number of pixels that faults add and take away."""
    out = [corrupt_mask(mask, mask * 0, faults, np.random.default_rng(k)) for k in range(40)]
    return np.mean([(o > mask).sum() for o in out]), np.mean([(o < mask).sum() for o in out])


def test_jitter_moves_the_outline_both_ways_by_about_its_size(mask):
    more, less = mean_change(mask, MaskFaults(boundary_px=1.5))
    outline = float(cv2.arcLength(cv2.findContours(mask, 0, cv2.CHAIN_APPROX_NONE)[0][0], True))
    # E|N(0, s)| / 2 on either side of the outline; the noise has an sd of about 0.83
    expected = 1.5 * 0.83 * 0.4 * outline
    assert more == pytest.approx(expected, rel=0.25) and less == pytest.approx(expected, rel=0.25)


def test_holes_only_take_blobs_only_add(mask):
    more, less = mean_change(mask, MaskFaults(holes=3.0))
    assert more == 0 and 200 < less < 1500
    more, less = mean_change(mask, MaskFaults(blobs=4.0))
    assert less == 0 and more > 200


def test_level_2_is_worse_than_level_1(mask):
    one, two = (sum(mean_change(mask, LEVELS[f"level-{k}"])) for k in (1, 2))
    assert two > 1.7 * one


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
    focal, place, pixels = [], [], []
    for seed in range(40):
        off = disturb_rig(true, 0.01, np.random.default_rng(seed))
        for a, b in zip(true, off, strict=True):
            focal.append(b.K[0, 0] / a.K[0, 0] - 1)
            place.append((b.position - a.position) / np.linalg.norm(a.position - [0, 0, 0.95]))
            pixels.append(b.project([0.3, 0.2, 1.4]) - a.project([0.3, 0.2, 1.4]))
            r = b.camera_from_world[:3, :3]
            assert np.allclose(r @ r.T, np.eye(3))
    assert np.std(focal) == pytest.approx(0.01, rel=0.2)
    assert np.std(place) == pytest.approx(0.01, rel=0.2)
    assert 1.5 < np.std(pixels) < 8
    assert disturb_rig(true, 0.0, np.random.default_rng(0)) is true
