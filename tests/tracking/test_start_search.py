"""Starts from silhouettes alone: postures on a body, the search over them, and what stays open."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.geometry import so3_exp, so3_log
from hypose.synthetic.scenes import camera_rig
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.left_right import turn_pose
from hypose.tracking.start_search import _ONE_ARM, _TOGETHER, postures, starts_in_frame, weigh_starts

POSTURES = [f"{legs}, arms {arms}" for legs, all_ in _TOGETHER for arms in all_] + [
    f"{legs}, {side} arm {arm}" for legs in ("standing", "sitting") for arm in _ONE_ARM for side in ("left", "right")
]


def masks_of(body, pose, cameras, also=()):
    """Silhouettes of a posed body, and of boxes ((low), (high)) m."""
    out = []
    for camera in cameras:
        mask = np.zeros((camera.size[1], camera.size[0]), bool)
        for vertices, faces in [(body.skin(pose), body.coarse.faces), *also]:
            z = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
            for side in (faces, faces[:, ::-1]):
                mask |= covered(camera.project_pinhole(vertices), z, np.ascontiguousarray(side), camera.size[::-1]) > 0
        out.append(mask.astype(np.uint8))
    masks = np.stack(out)
    return Silhouettes(masks, cameras, np.ones(len(masks), bool), ("",) * len(masks))


@pytest.fixture(scope="module")
def cameras():
    return CameraRig(tuple(camera_rig("humaneva-4").scaled(0.4)))


def sitting(body, name="sitting, arms on thighs", heading=2.0):
    pose = turn_pose(postures(body)[POSTURES.index(name)], heading)
    pose[2] -= body.skin(pose)[:, 2].min()
    return pose


def prepared(body, silhouettes):
    return prepare(Frame(0.0, 0, silhouettes), body, np.zeros(body.skeleton.dof))


def box(low, high):
    corners = np.array([[(low, high)[k][i] for i, k in enumerate(bits)] for bits in np.ndindex(2, 2, 2)], float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return corners, np.array(faces)


@pytest.mark.parametrize("chair", [False, True])
def test_a_seated_person_is_found_whatever_the_heading_and_on_a_chair(body, cameras, chair):
    pose = sitting(body)
    joints = body.joints(pose[None])[0]
    x, y = joints[0, :2]
    seat = float(joints[0, 2]) - 0.12
    also = [box((x - 0.2, y - 0.2, seat - 0.05), (x + 0.2, y + 0.2, seat))] if chair else []
    also += [box((x + a, y + b, 0), (x + a + 0.04, y + b + 0.04, seat)) for a in (-0.2, 0.16) for b in (-0.2, 0.16)][
        : 4 * chair
    ]
    frame = prepared(body, masks_of(body, pose, cameras, also))
    found = starts_in_frame(body, frame)
    best = found[0]
    assert [s.cost for s in found] == sorted(s.cost for s in found)
    away = np.linalg.norm(best.body.joints(best.pose[None])[0] - joints, axis=-1)
    assert away.mean() < (0.09 if chair else 0.06)
    again = starts_in_frame(body, frame)[0]
    assert np.array_equal(again.pose, best.pose)  # nothing is drawn at random
    given = starts_in_frame(body, frame, body.stature)
    assert all(s.body.stature == body.stature for s in given)


def test_what_the_frames_do_not_decide_is_unsure(body, cameras):
    """Of two starts that differ in nothing but their cost the cheaper is believed; legs elsewhere are doubted by it."""
    pose = sitting(body)
    frame = prepared(body, masks_of(body, pose, cameras))
    best = starts_in_frame(body, frame, body.stature)[0]
    away = best.pose.copy()
    away[0] += 0.3
    far = replace(best, pose=away, cost=best.cost + 0.002)
    found = weigh_starts([best, far], [])
    assert found.best.pose is best.pose and 0.5 < found.weights[0] < 0.6
    assert np.allclose(found.unsure[1], found.weights[1]) and not found.unsure[0].any()
    around = best.pose.copy()
    around[3:6] = so3_log(so3_exp(np.array([0, 0, np.pi])) @ so3_exp(around[3:6]))
    found = weigh_starts([best, replace(best, pose=around, cost=best.cost + 0.002)], [])
    assert found.unsure[0].max() == found.weights[1] and not found.unsure[1].any()


def test_what_is_too_small_for_a_person_is_said(body, cameras):
    """Calibrations of another size, or views of other cameras, leave a hull that may be anywhere, and tiny."""
    pose = np.zeros(body.skeleton.dof)
    pose[2] = 0.9
    box = np.array([(x, y, z) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.9, 1.1)])
    nobody = []
    for camera in cameras:
        uv = camera.project_pinhole(box)
        mask = np.zeros((camera.size[1], camera.size[0]), np.uint8)
        (x0, y0), (x1, y1) = uv.min(0).astype(int), uv.max(0).astype(int)
        mask[y0:y1, x0:x1] = 1
        nobody.append(mask)
    masks = Silhouettes(np.stack(nobody), cameras, np.ones(len(nobody), bool), ("",) * len(nobody))
    frame = prepare(Frame(0.0, 0, masks), body, pose)
    with pytest.raises(EvidenceError, match="no person; check the calibration"):
        starts_in_frame(body, frame)
