import numpy as np
import pytest

from hypose.errors import InputError
from hypose.fusion.register import check_same_person, register
from tests.fusion.people import in_reference, moving_person, seen, sensor_poses


def stacked(frames):
    return np.stack([f.positions for f in frames]), np.stack([f.state for f in frames])


def test_a_window_registers_exactly_without_noise(rng):
    truth, poses = moving_person(40), sensor_poses(rng, 4)
    found = register(*stacked(seen(truth, poses, rng)))
    world = found.apply(stacked(seen(truth, poses, rng))[0])
    assert np.abs(world - in_reference(truth, poses)[:, None]).max() < 1e-9
    assert found.registered.all() and found.residual.max() < 1e-9
    assert np.linalg.det(found.common_from_sensor[:, :3, :3]) == pytest.approx(np.ones(4))


def test_a_third_of_wrong_joints_does_not_move_the_robust_registration(rng):
    truth, poses = moving_person(60), sensor_poses(rng, 2)
    positions, state = stacked(seen(truth, poses, rng, noise=0.005))
    wrong = rng.random(positions.shape[:3]) < 0.3
    wrong[:, 0] = False
    positions = np.where(wrong[..., None], positions + rng.normal(0.3, 0.2, positions.shape), positions)
    world = register(positions, state).apply(positions)
    error = np.linalg.norm(world[:, 1] - in_reference(truth, poses), axis=-1)[~wrong[:, 1]]
    assert np.median(error) < 0.015


def test_a_sensor_that_shares_nothing_with_the_reference_is_tied_to_another_one(rng):
    truth, poses = moving_person(90), sensor_poses(rng, 3)
    positions, state = stacked(seen(truth, poses, rng))
    positions[:45, 2], positions[45:, 0] = np.nan, np.nan
    found = register(positions, state)
    assert found.registered.all()
    assert np.abs(found.apply(positions)[50:, 2] - in_reference(truth, poses)[50:]).max() < 1e-8


def test_a_sensor_without_a_person_stays_out_and_its_joints_missing(rng):
    positions, state = stacked(seen(moving_person(30), sensor_poses(rng, 3), rng))
    positions[:, 1] = np.nan
    found = register(positions, state)
    assert found.registered.tolist() == [True, False, True]
    assert np.isnan(found.apply(positions)[:, 1]).all()


def test_recordings_of_different_people_are_refused(rng):
    poses = sensor_poses(rng, 2)
    tall, child = moving_person(60), moving_person(60, scale=0.65)
    both = stacked(seen(tall, poses, rng, 0.005))[0]
    both[:, 1] = stacked(seen(child, poses, rng, 0.005))[0][:, 1]
    with pytest.raises(InputError, match="'a' and 'b' do not seem to see the same person.*limbs differ by"):
        check_same_person(both, register(both), ("a", "b"))
    # the same body at another time
    later = stacked(seen(tall, poses, rng, 0.005))[0]
    later[:, 1] = later[::-1, 1]
    later[:, 1, :, :] += np.linspace(0, 3, 60)[:, None, None]
    with pytest.raises(InputError, match="joints stay .* cm apart after registration.*both clocks agree"):
        check_same_person(later, register(later), ("a", "b"))
    check_same_person(
        stacked(seen(tall, poses, rng, 0.02))[0], register(stacked(seen(tall, poses, rng))[0]), ("a", "b")
    )


def test_a_sensor_that_reports_a_point_is_refused(rng):
    positions = rng.normal(size=(20, 2, 15, 3))
    positions[:, 1] = [0.0, 0.0, 2.0]
    with pytest.raises(InputError, match="'b' reports all joints at one point"):
        check_same_person(positions, register(positions), ("a", "b"))
