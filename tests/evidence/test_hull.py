from dataclasses import replace

import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.hull import common_view_bounds, hull_iou, visual_hull
from tests.evidence.scenes import far_ring, ring, solid_masks

CORNERS = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), -1).reshape(-1, 3)


def test_box_seen_from_many_sides_has_its_volume_height_and_place():
    size, centre = np.array([0.4, 0.3, 1.5]), np.array([0.1, -0.2, 0.93])
    s = solid_masks(far_ring(8), CORNERS * size + centre)
    hull = visual_hull(s, voxel=0.02)
    assert hull.volume == pytest.approx(size.prod(), rel=0.06)
    assert hull.height == pytest.approx(1.5, abs=0.021)
    assert np.allclose(hull.centroid, centre, atol=0.01)
    assert (hull_iou(hull, s) > 0.88).all()


def test_coarse_to_fine_keeps_every_voxel_of_the_plain_search():
    rig = ring(4)
    s = solid_masks(rig, CORNERS * [0.5, 0.4, 1.2] + [0.3, 0.2, 0.8])
    bounds = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.92]])
    voxel = 0.04
    hull = visual_hull(s, bounds, voxel, min_views=4, largest=False)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in (50, 50, 48)), indexing="ij"), -1).reshape(-1, 3)
    centres = bounds[0] + (grid + 0.5) * voxel
    keep = np.ones(len(centres), bool)
    for c, camera in enumerate(rig):
        u, v = np.rint(camera.project_pinhole(centres)).astype(int).T
        inside = (u >= 0) & (u < 320) & (v >= 0) & (v < 240)
        keep &= inside & (s.masks[c][np.clip(v, 0, 239), np.clip(u, 0, 319)] > 0)
    assert {tuple(p) for p in np.round(hull.points, 6)} == {tuple(p) for p in np.round(centres[keep], 6)}


def test_unusable_views_are_left_out():
    s = solid_masks(far_ring(5), CORNERS * [0.4, 0.4, 1.4] + [0, 0, 0.9])
    masks = s.masks.copy()
    masks[1] = 0
    without = replace(
        s, masks=masks, usable=np.arange(5) != 1, reasons=("", "c2, frame 3: the mask is empty", "", "", "")
    )
    hull = visual_hull(without)
    assert hull.height == pytest.approx(1.4, abs=0.031)
    assert np.isnan(hull_iou(hull, without)[1])
    with pytest.raises(EvidenceError, match="c2, frame 3"):
        visual_hull(replace(without, usable=np.arange(5) == 0))


def test_nothing_in_common_is_an_error_that_says_what_to_check():
    s = solid_masks(ring(4), CORNERS * 0.3 + [0, 0, 0.9])
    masks = s.masks.copy()
    masks[0] = 0
    masks[0, 5:15, 5:15] = 1
    with pytest.raises(EvidenceError, match="calibration and synchronisation"):
        visual_hull(replace(s, masks=masks))


def test_parallel_cameras_need_bounds():
    camera = ring(1)[0]
    shifted = replace(camera, name="d", camera_from_world=camera.camera_from_world.copy())
    shifted.camera_from_world[0, 3] += 0.3
    with pytest.raises(EvidenceError, match="bounds"):
        common_view_bounds(CameraRig((camera, shifted)))
