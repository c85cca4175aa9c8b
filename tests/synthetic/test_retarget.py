import numpy as np
import pytest

from benchmarks.synthetic.retarget import retarget


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
    knees = p.joints[:, [14, 17]] - (p.joints[:, [13, 16]] + p.joints[:, [15, 18]]) / 2
    forward = p.rotations[:, :1] @ np.array([0.0, -1.0, 0.0])
    assert (knees * forward).sum(-1).min() > -0.03  # knees bend forwards
