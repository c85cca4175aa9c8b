"""Scenes of one camera: reproducible, and the tracker's body is near the truth without being it."""

import numpy as np
import pytest

from benchmarks.synthetic.mono_scenes import arm_scene, body_scene
from benchmarks.synthetic.mono_subjects import MeasuringError, measured_body
from hypose.body.default_body import human
from hypose.synthetic.subjects import load_subjects


@pytest.fixture(scope="module")
def arm():
    return arm_scene(100, seconds=2.0)


@pytest.fixture(scope="module")
def body():
    return body_scene(102, seconds=0.4, motion="box")


def test_the_same_seed_gives_the_same_pictures(arm) -> None:
    again = arm_scene(100, seconds=2.0)
    np.testing.assert_array_equal(arm.image(7), again.image(7))
    assert (arm.image(7) != arm.image(8)).any()
    assert arm.image(0).shape == (288, 384, 3)
    assert arm.image(0).dtype == np.uint8


@pytest.mark.parametrize("name", ["arm", "body"])
def test_the_start_is_near_the_truth_and_in_the_limits(name, request) -> None:
    scene = request.getfixturevalue(name)
    error = np.linalg.norm(scene.estimated_marks(scene.start) - scene.true_marks()[0], axis=-1)
    assert 0.001 < error.mean() < 0.04
    s = scene.body.skeleton
    assert (scene.start >= s.lower).all()
    assert (scene.start <= s.upper).all()


def test_lengths_are_measured_within_the_given_error() -> None:
    subject = load_subjects()["woman_03"]
    exact = measured_body(human(), subject, MeasuringError(0.0, 0.0), np.random.default_rng(0))
    for a, b in ((6, 7), (7, 8), (13, 14), (14, 15)):
        mine, true = (np.linalg.norm(j[a] - j[b]) for j in (exact.skeleton.rest_joints, subject.joints))
        assert abs(mine / true - 1) < 0.01
    wrong = measured_body(human(), subject, MeasuringError(0.03, 0.07), np.random.default_rng(0))
    assert abs(wrong.stature / exact.stature - 1) > 1e-4
    assert abs(wrong.stature / exact.stature - 1) < 0.12


def test_captured_motion(shared_data) -> None:
    scene = body_scene(101, mocap=shared_data("mocap/02.asf").parent)
    assert len(scene.performance) == 30
    uv = scene.camera.project(scene.performance.joints)
    assert ((uv > 0) & (uv < scene.camera.size)).all()
