"""Left and right are called exchanged where feet or face say so, and not because of noise."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic.mono_motions import body_motion
from benchmarks.synthetic.spoilt_keypoints import close_up, noisy
from hypose.calibration.diagnose_person import wrong_way_up
from hypose.cameras.camera import triangulate
from hypose.evidence.keypoints import BODY_25, other_sides
from hypose.synthetic.scenes import camera_rig as named_rig
from hypose.synthetic.scenes import keypoint_places
from hypose.synthetic.subjects import load_subjects
from tests import missing

MOCAP = Path(__file__).parents[3] / "shared" / "data" / "mocap"
RIG = named_rig("humaneva-4")
BARE = [k for k, n in enumerate(BODY_25) if n.endswith(("toe", "heel"))]


def points(motion, seed):
    """World points (T, 25, 3) m of a motion."""
    if motion.startswith("captured") and not MOCAP.exists():
        missing.skip("captured motion", "put the folder mocap into ../shared/data")
    subject = next(iter(load_subjects().values()))
    made = body_motion(motion, subject, 2.4, 25.0, seed, MOCAP)
    return keypoint_places(subject, made.rotations, made.joints)


def seen(world, seed, spoil):
    """Pixels (C, T, 25, 3) without feet, with errors as a detector's."""
    clean = np.stack([np.pad(c.project_pinhole(world), ((0, 0), (0, 0), (0, 1)), constant_values=0.9) for c in RIG], 1)
    out = np.moveaxis(spoil(clean, BODY_25, np.random.default_rng(seed)), 1, 0)
    out[:, :, BARE] = 0.0
    return out


def exchanged(pixels):
    flat = pixels.reshape(len(RIG), -1, 3)
    world, _ = triangulate(RIG, flat[..., :2], flat[..., 2])
    found = wrong_way_up(world.reshape(*pixels.shape[1:]), BODY_25, pixels, RIG)
    return [f.kind for f in found] == ["sides"]


@pytest.mark.parametrize("spoil", [noisy, close_up])
@pytest.mark.parametrize("motion", ["walk", "captured-punch"])
def test_sides_are_exchanged_only_where_they_are(motion, spoil):
    pixels = seen(points(motion, 1), 1, spoil)
    twin = other_sides(BODY_25)
    rows = np.linspace(0, pixels.shape[1] - 1, 12).astype(int)  # as many as are looked at before tracking
    for frames in (pixels, pixels[:, rows]):
        assert not exchanged(frames) and exchanged(frames[:, :, twin])
