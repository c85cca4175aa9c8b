"""Clips that are fused in two pieces."""

import numpy as np
import pytest

from benchmarks.synthetic.treadmill import treadmill_recording
from hypose.errors import InputError
from hypose.fusion.fuse import FusionSettings, fuse_clip


@pytest.fixture(scope="module")
def frames():
    return treadmill_recording("A", np.random.default_rng(5)).frames()[:70]


@pytest.mark.parametrize(
    ("method", "diagnose"),
    [("fit", False), ("fit", True), ("swarm", False), ("published", False), ("published-window", False)],
)
@pytest.mark.parametrize("after", [1, 33, 70])
def test_a_clip_in_two_pieces_is_the_clip(frames, method, diagnose, after):
    settings = FusionSettings(diagnose=diagnose, seed=3)
    kept = {}

    def watch(so_far):
        if len(so_far.frames) == after:
            kept.update(so_far.arrays())

    whole = fuse_clip(frames, method, settings, watch=watch)
    assert all(a.dtype.kind in "fiub" for a in kept.values())
    seen = []
    pieces = fuse_clip(frames, method, settings, done=kept, watch=lambda s: seen.append(len(s.frames)))
    assert seen == list(range(after + 1, 71))
    np.testing.assert_array_equal(pieces.motion.joints, whole.motion.joints)
    np.testing.assert_array_equal(pieces.motion.joint_sd, whole.motion.joint_sd)
    np.testing.assert_array_equal(pieces.shares, whole.shares)
    np.testing.assert_array_equal(pieces.restarts, whole.restarts)
    np.testing.assert_array_equal(pieces.swapped, whole.swapped)
    if whole.choice is not None:
        np.testing.assert_array_equal(pieces.choice, whole.choice)


def test_arrays_of_another_clip_are_refused(frames):
    kept = {}
    fuse_clip(frames, watch=lambda s: kept.update(s.arrays()) if len(s.frames) == 20 else None)
    with pytest.raises(InputError, match="20 frames are fused already, the clip has 10"):
        fuse_clip(frames[:10], done=kept)
    for name, array in (
        ("fit.lengths", np.zeros(3)),
        ("frame.joints", np.zeros((5, 15, 3))),
        ("frames", np.array("x")),
    ):
        with pytest.raises(InputError, match="does not belong to this clip"):
            fuse_clip(frames, done={**kept, name: array})
    with pytest.raises(InputError, match="does not belong to this clip"):
        fuse_clip(frames, "swarm", done=kept)
    with pytest.raises(InputError, match="does not belong to this clip"):
        fuse_clip(frames, done={})
