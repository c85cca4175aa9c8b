"""Left and right are called exchanged where knees, feet or face say so beyond their noise, and not otherwise."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic.mono_motions import body_motion
from benchmarks.synthetic.spoilt_keypoints import close_up, noisy
from hypose.calibration.diagnose_person import wrong_way_up
from hypose.calibration.diagnose_points import mirrored_names
from hypose.cameras.camera import triangulate
from hypose.evidence.keypoints import BODY_25
from hypose.synthetic.corruptions import keypoint_places
from hypose.synthetic.scenes import camera_rig as named_rig
from hypose.synthetic.subjects import load_subjects
from tests import missing

MOCAP = Path(__file__).parents[3] / "shared" / "data" / "mocap"
RIG = named_rig("humaneva-4")
BARE = [k for k, n in enumerate(BODY_25) if n.endswith(("toe", "heel", "nose", "eye", "ear"))]


def points(motion, seed):
    """World points (T, 25, 3) m of a motion."""
    if motion.startswith("captured") and not MOCAP.exists():
        missing.skip("captured motion", "put the folder mocap into ../shared/data")
    subject = next(iter(load_subjects().values()))
    made = body_motion(motion, subject, 2.4, 25.0, seed, MOCAP)
    return keypoint_places(subject, made.rotations, made.joints)


def seen(world, seed, spoil=noisy):
    """Pixels (C, T, 25, 3) without face and feet, with errors as a detector's."""
    clean = np.stack([np.pad(c.project_pinhole(world), ((0, 0), (0, 0), (0, 1)), constant_values=0.9) for c in RIG], 1)
    out = np.moveaxis(spoil(clean, BODY_25, np.random.default_rng(seed)), 1, 0)
    out[:, :, BARE] = 0.0
    return out


def slight(clean, names, rng):
    """Errors of 2 % of the height."""
    return (clean + noisy(clean, names, rng)) / 2


def exchanged(pixels):
    flat = pixels.reshape(len(RIG), -1, 3)
    world, _ = triangulate(RIG, flat[..., :2], flat[..., 2])
    found = wrong_way_up(world.reshape(*pixels.shape[1:]), BODY_25, pixels, RIG)
    return [f.kind for f in found] == ["sides"]


@pytest.mark.parametrize("spoil", [noisy, close_up])
@pytest.mark.parametrize("motion", ["straight-knee", "walk", "wave", "captured-walk", "captured-punch"])
def test_noisy_knees_accuse_nobody(motion, spoil):
    for seed in range(4):
        assert not exchanged(seen(points(motion, seed), seed, spoil))


@pytest.mark.parametrize("motion", ["walk", "sit_down", "captured-walk"])
def test_knees_that_bend_backwards_beyond_their_noise_do(motion):
    pixels = seen(points(motion, 1), 1, slight)
    assert exchanged(pixels[:, :, mirrored_names(BODY_25)])
    rows = np.linspace(0, pixels.shape[1] - 1, 12).astype(int)  # as many as are looked at before tracking
    assert exchanged(pixels[:, rows][:, :, mirrored_names(BODY_25)])
