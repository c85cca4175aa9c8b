"""Key points weigh less cue_weight masks that know better, and in full cue_weight those that do not."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from benchmarks.synthetic.spoilt_keypoints import spoilt
from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import se3
from hypose.tracking.frame_evidence import keypoint_model, prepare
from hypose.tracking.keypoint_offsets import calibrate_keypoints, weigh_against_masks
from hypose.tracking.start_search import scaled_to_height

N = 6


@pytest.fixture(scope="module")
def clip():
    """A walk's frames with masks and key points, and a body of its size."""
    scene = small_scene(1, N)
    return list(scene.mask_frames(1.0, keypoints=True)), scaled_to_height(human(), scene.subject.stature)


def calibrated(body, frames):
    return calibrate_keypoints(body, keypoint_model(body, BODY_25), [f.keypoints for f in frames], rounds=1)


@pytest.fixture(scope="module")
def model(clip):
    """Where the points sit on the body, and how they scatter."""
    frames, body = clip
    return calibrated(body, frames)


def test_the_more_points_scatter_the_less_they_weigh(clip, model):
    frames, body = clip
    rough = spoilt(frames, "noisy", np.random.default_rng(0))
    plain, noisy = (
        weigh_against_masks(body, m, f).cue_weight for m, f in ((model, frames), (calibrated(body, rough), rough))
    )
    assert plain.shape == (4, len(BODY_25)) and (plain <= 1).all() and (noisy > 0).all()
    assert np.median(noisy[:, model.known]) < 0.5 * np.median(plain[:, model.known])


def test_points_weigh_in_full_beside_masks_that_are_elsewhere(clip, model):
    frames, body = clip
    there = se3(np.eye(3), (0.0, 0.0, 0.1))
    rig = CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ there) for c in frames[0].silhouettes.rig))
    aside = [replace(f, silhouettes=replace(f.silhouettes, rig=rig)) for f in frames]
    right, wrong = (weigh_against_masks(body, model, f).cue_weight[:, model.known] for f in (frames, aside))
    assert np.median(right) < 0.6 and np.median(wrong) == 1 and (wrong > right).mean() > 0.9


def test_solves_weigh_points_less_where_there_are_masks(clip, model):
    frames, body = clip
    model = replace(model, cue_weight=np.where(np.indices((4, len(BODY_25))).sum(0) % 2, 0.25, 1.0))
    pose = np.zeros(body.skeleton.dof)
    pose[:3] = (0, 0, 1)
    alone = prepare(replace(frames[0], silhouettes=None), body, pose, use_keypoints=True, keypoints_on_body=model)
    assert alone.terms == (alone.keypoints.term,)
    both = prepare(frames[0], body, pose, use_keypoints=True, keypoints_on_body=model)
    np.testing.assert_array_equal(both.keypoints.term.points, alone.keypoints.term.points)
    expected = both.keypoints.term.points[..., 2] * model.cue_weight[:, model.known]
    np.testing.assert_allclose(both.keypoints.terms[0].points[..., 2], expected)
