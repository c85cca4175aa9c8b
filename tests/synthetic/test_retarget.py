import numpy as np
import pytest

from benchmarks.synthetic.retarget import retarget
from hypose.body.default_body import JOINT_NAMES, PARENTS
from hypose.geometry import so3_log
from hypose.tracking.published_recipes import CAPTURED_MOTION


@pytest.fixture
def mocap(shared_data):
    return shared_data("mocap/02.asf").parent


@pytest.mark.parametrize(("clip", "speed", "flies"), [("02_01", 1.3, False), ("02_03", 3.0, True)])
def test_captured_walk_and_run(mocap, person, clip, speed, flies):
    p = retarget(mocap / "02.asf", mocap / f"{clip}.amc", person, 25.0, keep_trend=1.0)
    assert p.frame_rate == pytest.approx(25.0)
    way = p.root[-1, :2] - p.root[0, :2]
    assert np.linalg.norm(way) / p.times[-1] == pytest.approx(speed, rel=0.25)
    facing = (p.rotations[:, 0] @ np.array([0.0, -1.0, 0.0])).mean(0)[:2]
    assert facing @ way / np.linalg.norm(way) > 0.9  # it runs where it faces
    low = np.array([person.skin(p.rotations[t], p.root[t])[:, 2].min() for t in range(len(p))])
    assert low.min() > -0.01 and np.median(low) < 0.02
    assert (low.max() > 0.03) == flies
    assert (p.joints[:, 4, 2] > p.joints[:, 0, 2] + 0.4).all()  # head up


def test_sigma_0_is_the_motion_of_captured_people(mocap, person):
    """Root mean squares of the changes between two frames, over a walk, a run and a boxer in equal parts."""
    joints = {"spine": "chest", "neck": "head", **{j: j for j in ("shoulder", "elbow", "hip", "knee", "ankle")}}
    parents = np.maximum(PARENTS, 0)
    parents[[JOINT_NAMES.index(n) for n in ("chest", "head")]] = 0, JOINT_NAMES.index("chest")  # two joints turn as one
    squares, heading = {"pelvis": np.zeros(6), **{joint: np.zeros(3) for joint in joints}}, 0.0
    for clip in ("02_01", "02_03", "02_05"):
        p = retarget(mocap / "02.asf", mocap / f"{clip}.amc", person, 25.0, keep_trend=1.0)
        own = np.swapaxes(p.rotations[:, parents], -1, -2) @ p.rotations
        own[:, 0] = p.rotations[:, 0]
        turns = np.square(so3_log(own[1:] @ np.swapaxes(own[:-1], -1, -2))).mean(0)
        speed = np.square(np.diff(p.root, axis=0)).mean(0)
        heading = max(heading, float(np.sqrt(turns[0, 2] + speed[:2].sum() / 0.9**2)))  # the fastest, on a circle
        squares["pelvis"] += np.concatenate([speed, turns[0]]) / 3
        for joint, name in joints.items():
            of = [n for n in JOINT_NAMES if n.endswith(name)]
            squares[joint] += turns[[JOINT_NAMES.index(n) for n in of]].mean(0) / 3
    x, y, z, roll, pitch, _ = squares["pelvis"]
    own = np.sqrt([(x + y) / 2, (x + y) / 2, z, (roll + pitch) / 2, (roll + pitch) / 2])
    expected = {"pelvis": np.append(own, heading)}
    expected |= {"ankle": np.sqrt(squares["ankle"][:2])}
    expected |= {j: np.sqrt(squares[j].sum() / 3) for j in ("spine", "neck", "shoulder", "hip")}
    expected |= {j: np.sqrt(squares[j].sum()) for j in ("elbow", "knee")}
    for joint, sd in expected.items():
        np.testing.assert_allclose(CAPTURED_MOTION[joint], sd, rtol=0.1, err_msg=joint)  # steps grow with the legs
