"""BVH: an independent reader (bvhio) and a small one here find the joints where the motion has them."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.geometry import so3_exp
from hypose.io.motions.animation import Y_UP, write_bvh
from tests import missing


@pytest.fixture(scope="module")
def written(small_motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("bvh") / "a.bvh"
    write_bvh(path, small_motion)
    return path


def read(path):
    """Names, parents, offsets, frames of a BVH, and its frame time: every joint has Z X Y rotations."""
    names, parents, offsets, stack, end = [], [], [], [], False
    lines = iter(path.read_text().splitlines())
    for line in lines:
        words = line.split()
        if words[0] in ("ROOT", "JOINT"):
            parents.append(stack[-1] if stack else -1)
            names.append(words[1])
        elif words[0] == "End":
            end = True
        elif words[0] == "{":
            stack.append(len(names) - 1)
        elif words[0] == "}":
            stack.pop()
            end = False
        elif words[0] == "OFFSET" and not end:
            offsets.append([float(w) for w in words[1:]])
        elif words[0] == "CHANNELS":
            assert words[-3:] == ["Zrotation", "Xrotation", "Yrotation"]
        elif words[0] == "MOTION":
            break
    assert next(lines).startswith("Frames:")
    time = float(next(lines).split()[2])
    return (
        names,
        parents,
        np.array(offsets),
        np.array([[float(w) for w in row.split()] for row in lines]),
        time,
    )


def test_joints_are_where_the_motion_has_them(written, small_motion):
    names, parents, offsets, frames, time = read(written)
    assert sorted(names) == sorted(small_motion.skeleton.joint_names) and len(frames) == len(small_motion)
    assert time == pytest.approx(1 / 30, abs=1e-6)
    angles = np.radians(frames[:, 3:].reshape(len(frames), -1, 3))
    z, x, y = (so3_exp(angles[..., k, None] * np.eye(3)[a]) for k, a in ((0, 2), (1, 0), (2, 1)))
    local = z @ x @ y
    turn, place = [None] * len(names), [None] * len(names)
    for j, p in enumerate(parents):
        turn[j] = local[:, j] if p < 0 else turn[p] @ local[:, j]
        place[j] = frames[:, :3] if p < 0 else place[p] + turn[p] @ offsets[j]
    for j, name in enumerate(names):
        expected = small_motion.joints[:, small_motion.skeleton.joint(name)] @ Y_UP.T
        np.testing.assert_allclose(place[j] / 100, expected, atol=1e-6)


def test_bvhio_agrees_to_a_tenth_of_a_millimetre(written, small_motion):
    bvhio = missing.module("bvhio", "agreement with bvhio", "pip install bvhio")
    root = bvhio.readAsHierarchy(str(written))
    for t in range(0, len(small_motion), 7):
        root.loadPose(t)
        for j, name in enumerate(small_motion.skeleton.joint_names):
            joint = root.filter(name, isEqual=True)[0]
            got = np.array(joint.PositionWorld) / 100
            np.testing.assert_allclose(got, Y_UP @ small_motion.joints[t, j], atol=1e-4, err_msg=f"{name} {t}")


def test_angles_are_continuous_though_the_body_turns_once(written):
    frames = read(written)[3]
    assert np.abs(np.diff(frames[:, 3:], axis=0)).max() < 90
    assert abs(abs(frames[-1, 5] - frames[0, 5]) - 360) < 60


def test_frames_without_a_pose_hold_the_last(tmp_path, small_motion, written):
    poses = small_motion.poses.copy()
    poses[[0, 9, 10]] = np.nan
    write_bvh(tmp_path / "b.bvh", replace(small_motion, poses=poses))
    whole, held = read(written)[3], read(tmp_path / "b.bvh")[3]
    assert len(held) == len(whole) and np.isfinite(held).all()
    np.testing.assert_allclose(held[[0, 9, 10], :3], whole[[1, 8, 8], :3], atol=1e-5)


@pytest.mark.parametrize(
    ("poses", "message"), [(None, "no poses"), (np.full((60, 36), np.nan), "no frame with a finite pose")]
)
def test_a_motion_without_poses_is_one_sentence(tmp_path, small_motion, poses, message):
    with pytest.raises(InputError, match=message):
        write_bvh(tmp_path / "a.bvh", replace(small_motion, poses=poses))
