"""What cannot be measured is said in one sentence: wrong units, a person cut off, a pose that is not held."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.pipeline.start_choice import check_borders, check_start, cut_edges
from hypose.pipeline.subject import SubjectOptions, estimate_subject
from hypose.synthetic.scenes import camera_rig
from hypose.tracking.start_search import known_pose


@pytest.fixture(scope="module")
def views():
    return camera_rig("humaneva-4").scaled(0.375)


def seen(views, pose_name="standing", shift=(0.0, 0.0)):
    """A frame with exact masks of the template; shift: px by which all images are moved."""
    body = human()
    pose = known_pose(body, pose_name)
    pose[5] = 0.7
    pose[2] -= body.skin(pose)[:, 2].min()
    vertices = body.skin(pose)
    masks, cameras = [], []
    for camera in views:
        moved = np.array(camera.K)
        moved[:2, 2] += shift
        camera = replace(camera, K=moved)
        cameras.append(camera)
        depth = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
        masks.append(covered(camera.project_pinhole(vertices), depth, body.coarse.faces, camera.size[::-1]))
    return Frame(0.0, 0, silhouettes=make_silhouettes([m.astype(np.uint8) for m in masks], CameraRig(tuple(cameras))))


def enlarged(frame, factor):
    """The frame with the calibration in another unit."""
    cameras = []
    for camera in frame.silhouettes.rig:
        pose = np.array(camera.camera_from_world)
        pose[:3, 3] *= factor
        cameras.append(replace(camera, camera_from_world=pose))
    return replace(frame, silhouettes=replace(frame.silhouettes, rig=CameraRig(tuple(cameras))))


def estimate(frame, **options):
    return estimate_subject(lambda i: frame, 2, SubjectOptions(frames=1, rate=25.0, **options))


@pytest.mark.parametrize(("factor", "unit"), [(100, "cm"), (1000, "mm")])
def test_a_giant_is_a_wrong_unit(views, factor, unit):
    with pytest.raises(EvidenceError, match=rf'Frame 0: .* m tall; calibration_unit = "{unit}"') as caught:
        estimate(enlarged(seen(views), factor))
    assert "would make that 1." in str(caught.value)


def test_a_person_cut_off_by_every_view(views):
    frame = seen(views, shift=(0.0, 70.0))
    edges = [cut_edges(frame.silhouettes, c) for c in range(4)]
    assert all(e == ("bottom",) for e in edges)
    with pytest.raises(EvidenceError, match=r"No view ever shows the whole person \(.*bottom border.*--height"):
        estimate(frame)
    # with the height known it is said and done without
    assert all("bottom border in 2 of 2 frames" in n for n in check_borders([frame, frame], 1.7))


def test_one_view_that_cuts_is_named(views):
    whole, cut = seen(views).silhouettes, seen(views, shift=(0.0, 70.0)).silhouettes
    masks = whole.masks.copy()
    masks[1] = cut.masks[1]
    notes = check_borders([Frame(0.0, 0, silhouettes=replace(whole, masks=masks))], None)
    assert len(notes) == 1 and notes[0].startswith(whole.rig.names[1]) and "1 of 1 frames" in notes[0]
    assert check_borders([Frame(0.0, 0, silhouettes=whole)], None) == ()


def test_a_start_that_explains_nothing():
    check_start(0.6, 7)
    with pytest.raises(EvidenceError, match="Frame 7: no body in a known pose"):
        check_start(0.2, 7)


def test_a_pose_that_is_not_held_is_named(views):
    with pytest.raises(EvidenceError, match=r"Frame 0 does not show the pose 'hands-up'.*--start hull"):
        estimate(seen(views), start="hands-up")
