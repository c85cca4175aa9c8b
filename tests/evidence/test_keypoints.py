import json
from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import (
    BODY_25,
    BODY_25B,
    COCO_17,
    HALPE_26,
    keypoint_names,
    landmark_of,
    thick_skeleton,
    to_keypoints,
    triangulate_keypoints,
)
from hypose.io.keypoints.keypoint_files import parse_openpose
from tests.evidence.scenes import ring


def person(count=25, scale=1.0, at=(100.0, 100.0), confidence=0.8):
    rng = np.random.default_rng(count)
    uv = rng.uniform(0, 100 * scale, (count, 2)) + at
    return np.column_stack([uv, np.full(count, confidence)])


def document(*people):
    return json.dumps({"version": 1.3, "people": [{"pose_keypoints_2d": list(np.ravel(p))} for p in people]})


def test_sets_are_consistent():
    assert BODY_25[8] == "mid_hip" and BODY_25[4] == "right_wrist" and BODY_25[24] == "right_heel"
    assert BODY_25B[9] == "left_wrist" and HALPE_26[20] == "left_big_toe"
    assert keypoint_names("body_25b") == BODY_25B
    with pytest.raises(InputError, match="BODY_25B"):
        keypoint_names("BODY_26")


def test_people_are_read():
    a, b = person(), person(scale=2)
    out = parse_openpose(document(a, b))
    assert out.shape == (2, 25, 3) and np.allclose(out, [a, b])
    assert not len(parse_openpose(document()))
    assert not len(parse_openpose({"people": [{"pose_keypoints_2d": []}, {}]}))
    assert parse_openpose(document(person(17))).shape == (1, 17, 3)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("{people", "property name"),
        (b"\xff\xfe\x00", "not what is expected"),
        ("[1, 2]", "not what is expected"),
        ('{"frames": []}', "has no 'people'"),
        ('{"people": [{"keypoints": [1, 2, 3]}]}', "person 0 has no 'pose_keypoints_2d'"),
        ('{"people": [[1, 2]]}', "person 0 holds something that is not"),
        ('{"people": [{"pose_keypoints_2d": ["a", 2, 3]}]}', "could not convert string to float"),
        ('{"people": [{"pose_keypoints_2d": [[1, 2], 3]}]}', "person 0 holds something that is not"),
        ('{"people": [{"pose_keypoints_2d": [1, 2, 3, 4]}]}', "cannot reshape array of size 4"),
        (document(person(17), person(25)), "people have 17, 25 key points"),
        (document(np.where(np.arange(25)[:, None] == 2, [np.inf, 1, 0.9], person())), "is infinite"),
    ],
)
def test_foreign_files_are_refused_with_the_file_named(content, sentence):
    with pytest.raises(InputError) as problem:
        parse_openpose(content, "pose/cam1/0012.json")
    assert sentence in str(problem.value) and "pose/cam1/0012.json" in str(problem.value)


def test_key_points_are_undistorted_and_scaled():
    camera = replace(ring(1)[0], distortion=np.array([-0.2, 0.05, 0.001, 0.0, 0.0]))
    rig = CameraRig((camera,))
    small = rig.scaled(0.5).pinhole()
    x = np.random.default_rng(0).uniform(-0.6, 0.6, (17, 3)) + [0, 0, 0.9]
    seen = np.column_stack([camera.project(x), np.full(17, 0.9)])
    out = to_keypoints([seen], COCO_17, rig, small)
    assert np.allclose(out.points[0, :, :2], small[0].project_pinhole(x), atol=1e-3)
    with pytest.raises(InputError, match="c1"):
        to_keypoints([seen[:5]], COCO_17, rig, small)


def frames_of(rig, x, rng, noise=0.5):
    points = np.stack([np.concatenate([c.project_pinhole(x), np.full((*x.shape[:2], 1), 0.9)], -1) for c in rig])
    points[..., :2] += rng.normal(0, noise, points[..., :2].shape)
    return [Keypoints(points[:, t], COCO_17, rig) for t in range(x.shape[0])], points


def test_triangulation_drops_one_wrong_view():
    rng = np.random.default_rng(4)
    rig = ring(4)
    x = rng.uniform(-0.5, 0.5, (6, 17, 3)) + [0, 0, 0.9]
    frames, points = frames_of(rig, x, rng)
    good, residual, n = triangulate_keypoints(frames)
    assert np.linalg.norm(good - x, axis=-1).max() < 0.03 and (n == 4).all() and residual.max() < 2
    points[1, 2, 5, :2] += 60  # left and right swapped by the detector
    points[2, 3, 6, 2] = 0  # hidden in one view
    points[:3, 4, 7, 2] = 0  # seen by one camera only
    points[[0, 2], 5, 8, :2] += [[90, 0], [0, -90]]  # two wrong views of four: no majority
    out, residual, n = triangulate_keypoints([Keypoints(points[:, t], COCO_17, rig) for t in range(6)])
    assert np.linalg.norm(out[2, 5] - x[2, 5]) < 0.03 and n[2, 5] == 3 and residual[2, 5] < 2
    assert n[3, 6] == 3 and np.linalg.norm(out[3, 6] - x[3, 6]) < 0.03
    assert np.isnan(out[4, 7]).all() and n[4, 7] == 0 and np.isnan(residual[4, 7])
    assert np.isnan(out[5, 8]).all()
    assert np.array_equal(out[0], good[0])


def test_landmarks_on_the_body():
    body = human()
    joint, offset, known = landmark_of(BODY_25, body)
    assert known.all()
    rest = body.skeleton.rest_joints
    at = {n: rest[joint[k]] + offset[k] for k, n in enumerate(BODY_25)}
    s = body.skeleton
    for name in ("left_shoulder", "right_elbow", "left_hip", "right_ankle"):
        assert np.allclose(at[name], rest[s.joint(name)])
    assert np.allclose(at["mid_hip"], 0.5 * (at["left_hip"] + at["right_hip"]))
    assert at["nose"][2] > at["neck"][2] + 0.1 and at["nose"][1] < at["neck"][1]  # the body faces -y
    assert at["left_big_toe"][0] > 0 > at["right_big_toe"][0]
    assert at["left_heel"][1] > at["left_big_toe"][1]
    assert not landmark_of(("tail",), body)[2].any()


def test_thick_skeleton_covers_limbs_and_leaves_unseen_ones_out():
    p = np.zeros((17, 3))
    at = dict(zip(COCO_17, range(17), strict=True))
    for name, u, v in (
        ("left_shoulder", 70, 40),
        ("right_shoulder", 50, 40),
        ("left_hip", 66, 80),
        ("right_hip", 54, 80),
        ("left_elbow", 90, 50),
        ("left_wrist", 110, 60),
    ):
        p[at[name]] = [u, v, 0.9]
    p[at["right_elbow"]] = [30, 50, 0.1]
    mask = thick_skeleton(p, COCO_17, (120, 140), 4)
    assert mask[60, 60] and mask[50, 90] and mask[55, 100] and mask[60, 110]
    assert not mask[50, 30] and not mask[100, 60]
    assert mask[46, 100] == 0 and mask[52, 100] == 1
