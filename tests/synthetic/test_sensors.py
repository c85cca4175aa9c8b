import numpy as np
import pytest

from benchmarks.synthetic import sensors as sim
from benchmarks.synthetic.treadmill import treadmill_recording
from hypose.app.live.simulated_sensors import ring_sensors
from hypose.fusion import joints as jt


@pytest.fixture(scope="module")
def recording():
    return treadmill_recording("A", np.random.default_rng(3))


def test_rays_meet_capsules_where_they_should(rng):
    capsule = np.array([[0.0, 0, 0, 0, 0, 1, 0.1], [2, 0, 0, 2, 0, 0, 0.3]])
    out = np.empty(4)
    to = np.array([[0, 0, 0.5], [2, 0, 0], [0, 0, 1.5], [0, 0, 1.05]]) - [0, -3, 0.5]
    directions = to / np.linalg.norm(to, axis=1, keepdims=True)
    sim.cast_rays(np.array([0.0, -3, 0.5]), directions, capsule, out)
    assert out[0] == pytest.approx(2.9)
    hit = np.array([0, -3, 0.5]) + out[1] * directions[1]
    assert np.linalg.norm(hit - [2, 0, 0]) == pytest.approx(0.3)
    assert out[2] > 1e8
    top = np.array([0, -3, 0.5]) + out[3] * directions[3]
    assert np.linalg.norm(top - [0, 0, 1]) == pytest.approx(0.1)


def test_the_person_faces_the_front_sensor_and_left_is_left(recording):
    first = recording.truth[0]
    assert first[jt.LEFT_SHOULDER, 0] > first[jt.RIGHT_SHOULDER, 0]
    assert first[jt.HEAD, 2] > 1.3
    toes = np.cross(first[jt.LEFT_SHOULDER] - first[jt.RIGHT_SHOULDER], [0, 0, 1])
    assert toes[1] < 0
    front = recording.truth_in(0)
    assert np.all(front[..., 2] > 1.5)  # in front of the sensor
    assert front[0, jt.HEAD, 1] < front[0, jt.LEFT_FOOT, 1]  # y down
    assert np.degrees(recording.heading).max() == pytest.approx(45, abs=0.5)


def test_what_is_hidden_is_inferred_and_wrong_what_is_seen_is_nearly_right(recording):
    hidden = recording.visible < sim.HIDDEN_BELOW
    assert 0.05 < hidden.mean() < 0.5
    assert np.nanmedian(recording.error[~hidden]) < 0.05
    assert np.nanmedian(recording.error[hidden]) > 1.7 * np.nanmedian(recording.error[~hidden])
    reported = recording.state > 0
    assert (recording.state[hidden & reported] == 1).mean() == pytest.approx(0.7, abs=0.04)
    assert (recording.state[~hidden & reported] == 1).mean() == pytest.approx(0.05, abs=0.02)
    assert np.isnan(recording.positions[recording.state == 0]).all()


def test_a_sensor_behind_exchanges_the_sides_in_episodes():
    base = treadmill_recording("B", np.random.default_rng(0))
    cameras = ring_sensors([0, 180])
    seen = sim.simulate(
        base.truth, base.heading, cameras, np.random.default_rng(1), sim.SensorModel(drop_out=0), np.zeros((0, 7))
    )
    sides = seen.positions[:, :, jt.LEFT_HIP] - seen.positions[:, :, jt.RIGHT_HIP]
    true = [seen.truth_in(k)[:, jt.LEFT_HIP] - seen.truth_in(k)[:, jt.RIGHT_HIP] for k in (0, 1)]
    swapped = [(sides[:, k] * true[k]).sum(-1) < 0 for k in (0, 1)]
    assert swapped[0].mean() < 0.02
    assert 0.2 < swapped[1].mean() < 0.95


def test_the_same_seed_gives_the_same_recording_and_nothing_is_shared():
    a, b, c = (treadmill_recording("A", np.random.default_rng(s)) for s in (5, 5, 6))
    np.testing.assert_array_equal(a.positions, b.positions)
    np.testing.assert_array_equal(a.joint_depth, b.joint_depth)
    assert not np.array_equal(a.positions, c.positions)
