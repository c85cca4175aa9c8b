"""Rigs from corners: the truth within the noise, symmetric boards, contradictions, cameras without common boards."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.cameras.board_accuracy import solve_scene
from benchmarks.synthetic.calibration_boards import compare_rigs, film_board, ring_of_cameras
from hypose.calibration.board_fit import CalibratedLens, calibrate_lens
from hypose.calibration.boards import Board
from hypose.calibration.from_boards import floor_frame, place_on_floor
from hypose.calibration.rig import calibrate_rig
from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import se3, so3_exp

EVEN = Board("chessboard", 8, 6, 0.08)


def given_lenses(rig):
    return [CalibratedLens(replace(c, camera_from_world=np.eye(4)), 0.2, True) for c in rig]


@pytest.mark.parametrize("fisheye", [False, True])
def test_a_rig_from_a_carried_board(rng, fisheye):
    """The board looks the same turned by 180 degrees, and every camera numbers it as it likes."""
    scene = film_board(ring_of_cameras(rng, 4, fisheye=fisheye), EVEN, rng, 50, turn=True)
    found = solve_scene(scene)
    errors = compare_rigs(found.rig, scene.rig)
    assert found.rms_px == pytest.approx(0.25, rel=0.08)
    assert errors.focal_px.max() < 4
    assert errors.position_m.max() < 0.025
    # numbered alike: boards in the world are where they were, up to the rig's frame and one common turn
    assert all(set(s.ids) == set(range(48)) for seen in found.sightings.values() for s in seen.values())


def test_cameras_without_a_common_board_are_named(rng):
    scene = film_board(ring_of_cameras(rng, 3), EVEN, rng, 30)
    apart = [scene.sightings[0], scene.sightings[1], {f + 1000: s for f, s in scene.sightings[2].items()}]
    with pytest.raises(CalibrationError, match=r"cannot be joined: cam1 .* cam2 .* \| cam3 \(.*frames 10.*no board at"):
        calibrate_rig(given_lenses(scene.rig), apart, EVEN)


def test_contradicting_boards_point_to_synchronisation(rng):
    scene = film_board(CameraRig(ring_of_cameras(rng, 6).cameras[:2]), EVEN, rng, 40)
    shuffled = dict(zip(sorted(scene.sightings[1]), rng.permutation(list(scene.sightings[1].values())), strict=True))
    with pytest.raises(CalibrationError, match="contradict each other: the videos are probably not synchronous"):
        calibrate_rig(given_lenses(scene.rig), [scene.sightings[0], shuffled], EVEN)


def test_lens_needs_different_boards(rng):
    scene = film_board(ring_of_cameras(rng, 3), EVEN, rng, 1, lying=1, turn=True)
    seen = {f: scene.sightings[0][0] for f in range(20)}
    with pytest.raises(CalibrationError, match="in 20 pictures, in 1 different positions"):
        calibrate_lens("cam1", seen, EVEN, (640, 480))


def test_floor_where_the_board_lies_still(rng):
    scene = film_board(ring_of_cameras(rng, 4), EVEN, rng, 40, lying=6)
    found = solve_scene(scene)
    frame, said = floor_frame(found.rig, found.boards, EVEN, None)
    assert frame is not None and frame < 6 and "lies still in frames 0 to 5" in said
    rig, boards = place_on_floor(found.rig, found.boards, EVEN, frame)
    np.testing.assert_allclose(boards[frame][:3, 3], 0, atol=1e-12)
    for camera, true in zip(rig, scene.rig, strict=True):
        assert camera.position[2] == pytest.approx(true.position[2], abs=0.06)
    chosen, _ = floor_frame(found.rig, found.boards, EVEN, 3)
    assert chosen == 3
    with pytest.raises(CalibrationError, match="No board was found near frame 5000"):
        floor_frame(found.rig, found.boards, EVEN, 5000)


def test_without_a_floor_up_is_that_of_the_cameras(rng):
    scene = film_board(ring_of_cameras(rng, 4), EVEN, rng, 30, lying=0)
    boards = dict(enumerate(scene.boards))
    turn = se3(so3_exp([0.5, 0.7, -0.3]), [1, 2, 3])
    moved = CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ np.linalg.inv(turn)) for c in scene.rig))
    frame, said = floor_frame(moved, {f: turn @ b for f, b in boards.items()}, EVEN, None)
    assert frame is None and "the floor is not known" in said
    rig, placed = place_on_floor(moved, {f: turn @ b for f, b in boards.items()}, EVEN, None)
    down = np.stack([c.camera_from_world[1, 2] for c in rig])
    assert (down < -0.7).all()  # images stand upright: their y axes point down in the world
    assert min((b[:3, :3] @ EVEN.points.T + b[:3, 3:])[2].min() for b in placed.values()) == pytest.approx(0, abs=1e-9)
