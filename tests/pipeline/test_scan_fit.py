"""The template inside a scan: joints of people whose truth is known, stances, and the pose undone."""

import numpy as np
import pytest

from benchmarks.synthetic.scans import scan_of
from hypose.body.default_body import human
from hypose.geometry import so3_exp
from hypose.pipeline.mesh_subject import (
    find_stances,
    fit_template,
    surface_samples,
    unposed,
)
from hypose.synthetic.subjects import load_subjects
from hypose.tracking.start_search import KNOWN_POSES, known_pose

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.mark.parametrize(("name", "arms"), [("heavy", "t"), pytest.param("broad", "standing", marks=pytest.mark.slow)])
def test_joints_of_a_scanned_person(name, arms, rng):
    subject = load_subjects()[name]
    vertices, joints = scan_of(subject, arms, 0.002, rng)
    surface = surface_samples(vertices, subject.faces, 1500, rng)
    fit, stance = fit_template(surface, human(), find_stances(surface, human()))
    assert stance.up == "+z"
    found = fit.body.joints(fit.pose) @ stance.upright_from_file
    error = np.linalg.norm(found - joints, axis=1)
    assert error.mean() < 0.015
    assert error.max() < 0.035
    assert fit.far < 0.01
    assert fit.body.stature == pytest.approx(subject.stature, abs=0.03)


@pytest.mark.parametrize("arms", KNOWN_POSES)
def test_stances_are_found_in_any_axes(arms, rng):
    subject = load_subjects()["neutral"]
    vertices, _ = scan_of(subject, arms, 0.0, rng)
    heading = so3_exp(np.array([0, 0, rng.uniform(-3, 3)]))
    for rotation, up in ((np.eye(3), "+z"), (Y_UP, "+y")):
        turned = vertices @ (rotation @ heading).T
        best = find_stances(surface_samples(turned, subject.faces, 1500, rng), human())[0]
        assert best.up == up
        assert best.arms == arms
        # the rotation undoes the turn: the person faces -y again, up to a few degrees
        back = best.upright_from_file @ rotation @ heading
        assert np.trace(back) > 3 - 0.35


def test_undoing_a_pose_is_the_inverse_of_skinning(rng):
    body = human()
    pose = known_pose(body, "t")
    pose[:6] = [0.3, -0.2, 1.0, 0.1, 0.2, 2.0]
    posed = body.skin(pose, body.fine)
    rest = unposed(body, pose, posed, body.fine.dense_weights(19))
    np.testing.assert_allclose(rest, body.fine.vertices, atol=2e-5)  # skinning works in float32
