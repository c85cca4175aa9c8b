"""Joint refinement: derivatives against finite differences, recovery of the truth, known boards, bad starts."""

import numpy as np
import pytest

from benchmarks.synthetic.calibration_boards import film_board, ring_of_cameras
from hypose.calibration.board_fit import collect_observations
from hypose.calibration.boards import Board
from hypose.calibration.bundle import NOISE_PX, bundle_adjust
from hypose.cameras.camera import Camera
from hypose.geometry import se3, so3_exp

BOARD = Board("chessboard", 9, 6, 0.08)


def _disturbed(scene, rng):
    cameras = []
    for i, c in enumerate(scene.rig):
        turn = np.zeros(3) if i == 0 else rng.normal(0, 0.02, 3)
        place = np.zeros(3) if i == 0 else rng.normal(0, 0.05, 3)
        pose = se3(so3_exp(turn) @ c.camera_from_world[:3, :3], c.camera_from_world[:3, 3] + place)
        k = c.K * [[1.02, 1, 1], [1, 1.02, 1], [1, 1, 1]]
        cameras.append(Camera(c.name, k, np.zeros_like(c.distortion), pose, c.size, c.fisheye))
    turns = so3_exp(rng.normal(0, 0.03, (len(scene.boards), 3)))
    boards = se3(turns @ scene.boards[:, :3, :3], scene.boards[:, :3, 3] + rng.normal(0, 0.03, (len(turns), 3)))
    return cameras, boards


def test_the_truth_is_recovered_without_noise(rng):
    scene = film_board(ring_of_cameras(rng, 3), BOARD, rng, 25, noise_px=0.0)
    cameras, boards = _disturbed(scene, rng)
    obs = collect_observations(dict(enumerate(scene.sightings)), range(25))
    found = bundle_adjust(cameras, boards, BOARD.points, obs, noise_px=1e-3)
    assert found.rms_px < 1e-3
    for a, b in zip(found.cameras, scene.rig, strict=True):
        assert abs(a.K[0, 0] - b.K[0, 0]) < 0.02
        assert np.linalg.norm(a.position - b.position) < 1e-3
    # the first camera stays where it is
    np.testing.assert_array_equal(found.cameras[0].camera_from_world, scene.rig[0].camera_from_world)


def test_standard_deviations_are_those_of_the_errors():
    """Over many noisy scenes the focal errors have the predicted size."""
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        scene = film_board(ring_of_cameras(rng, 3), BOARD, rng, 25, noise_px=NOISE_PX)
        obs = collect_observations(dict(enumerate(scene.sightings)), range(25))
        found = bundle_adjust(list(scene.rig), scene.boards, BOARD.points, obs)
        error = [a.K[0, 0] - b.K[0, 0] for a, b in zip(found.cameras, scene.rig, strict=True)]
        ratios += list(np.array(error) / found.focal_sd)
        assert found.rms_px == pytest.approx(NOISE_PX, rel=0.1)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.5
