from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.treadmill import treadmill_recording
from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt
from hypose.fusion.fuse import common_positions, fuse_clip
from tests.fusion.people import in_reference, moving_person, seen, sensor_poses


@pytest.mark.parametrize("n", [1, 2])
def test_the_other_joints_of_larger_sets_are_passed_through(n, rng):
    known = jt.joint_sets()[n]
    truth, poses = moving_person(20), sensor_poses(rng, 2)
    anchor = rng.integers(0, 15, len(known.joint_names))
    full = truth[:, anchor] + 0.02
    full[:, known.common] = truth
    local = np.einsum("kij,tnj->tkni", poses[0], full) + poses[1][:, None]
    frames = [
        SensorJoints(p, np.full(p.shape[:2], 2), np.full(2, t / 30), known.joint_names, ("a", "b"))
        for t, p in enumerate(local)
    ]
    fused = fuse_clip(frames)
    names = fused.motion.skeleton.joint_names
    assert sorted(names) == sorted(
        {*jt.COMMON, *(known.joint_names[i] for i in range(len(names)) if i not in known.common)}
    )
    target = full @ poses[0][0].T + poses[1][0]
    for i, name in enumerate(known.joint_names):
        if i not in known.common:
            assert np.abs(fused.motion.joints[5:, names.index(name)] - target[5:, i]).max() < 0.02


def test_bad_input_is_refused_in_a_sentence(rng):
    poses = sensor_poses(rng, 2)
    frames = seen(moving_person(30), poses, rng, 0.005)
    with pytest.raises(InputError, match="no frames to fuse"):
        fuse_clip([])
    with pytest.raises(InputError, match="no fusion method 'magic'"):
        fuse_clip(frames, "magic")
    other = SensorJoints(frames[3].positions, frames[3].state, frames[3].times, jt.COMMON, ("s0", "spare"))
    with pytest.raises(InputError, match="Frame 3 has the sensors s0, spare instead of s0, s1"):
        fuse_clip([*frames[:3], other])
    kinect = jt.joint_sets()[1].joint_names
    wide = SensorJoints(np.zeros((2, 25, 3)), np.full((2, 25), 2), np.zeros(2), kinect, ("s0", "s1"))
    with pytest.raises(InputError, match=r"Frame 3 has 25 joints .* instead of 15"):
        fuse_clip([*frames[:3], wide])
    nothing = [SensorJoints(np.full((2, 15, 3), np.nan), f.state, f.times, jt.COMMON, ("s0", "s1")) for f in frames]
    with pytest.raises(InputError, match="No sensor reports any joint in the whole clip"):
        fuse_clip(nothing)


@pytest.mark.parametrize("mark", [np.nan, -9999.0])
@pytest.mark.parametrize("method", ["fit", "swarm", "published", "published-window"])
def test_missing_joints_and_frames_never_reach_the_result(method, mark, rng):
    truth, poses = moving_person(40), sensor_poses(rng, 3)
    frames = []
    for t, f in enumerate(seen(truth, poses, rng, 0.005)):
        p = f.positions.copy()
        p[rng.random((3, 15)) < 0.25] = mark
        p[1] = mark if 10 <= t < 20 else p[1]
        p[:] = mark if 25 <= t < 28 else p
        frames.append(SensorJoints(p, f.state, f.times, f.joint_names, f.sensor_names))
    fused = fuse_clip(frames, method)
    known = np.isfinite(fused.motion.joints).all(-1)
    # "published" knows a sensor once it has shown its triangle; from then on a joint is never missing again
    assert (known.all() if method != "published" else known[12:].all()) and (known[1:] >= known[:-1]).all()
    assert np.nanmax(np.abs(common_positions(fused.motion) - in_reference(truth, poses))) < 0.5
    assert fused.motion.extrapolated.tolist() == [25 <= t < 28 for t in range(40)]


@pytest.mark.parametrize("method", ["fit", "swarm"])
def test_a_person_that_nobody_sees_is_lost_after_half_a_second(method):
    frames = treadmill_recording("A", np.random.default_rng(5)).frames()[:90]
    nobody = replace(
        frames[0],
        positions=np.full_like(frames[0].positions, np.nan),
        state=np.zeros_like(frames[0].state),
        times=np.full(3, np.nan),
    )
    frames[30:60] = [nobody] * 30
    motion = fuse_clip(frames, method).motion
    assert motion.extrapolated[30:60].all()
    assert not motion.lost[:43].any() and motion.lost[46:60].all() and not motion.lost[60:].any()
