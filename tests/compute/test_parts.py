"""Parts of a body against a mask, as counting pixel by pixel has it."""

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike

from hypose.body.default_body import human
from hypose.compute.parts import covered, draw_parts, parts_against_mask, touched_area

PARTS = 5


def scene(rng: np.random.Generator, w: int, h: int) -> tuple[np.ndarray, ...]:
    """Triangles of PARTS parts about a picture, some of them behind the camera or nowhere, and a mask of blobs."""
    uv = rng.uniform(-10, [w + 10, h + 10], (60, 2))
    z = rng.uniform(0.5, 3, 60)
    z[3], uv[5], uv[6, 0], uv[9, 1] = -1.0, np.nan, np.inf, np.nan
    uv[7:9] = np.rint(uv[7:9])
    faces = rng.integers(0, 60, (40, 3)).astype(np.int32)
    faces = np.where(rng.random((40, 1)) < 0.5, faces, faces[:, :1] + np.arange(3))  # slivers too
    part = rng.integers(0, PARTS, 40).astype(np.uint8)
    mask = (cv2.GaussianBlur(rng.random((h, w)).astype(np.float32), (0, 0), 2) > 0.5).astype(np.uint8)
    return uv, z, (faces % 60).astype(np.int32), part, mask


def planes_of(drawn: np.ndarray, width: int) -> np.ndarray:
    return np.unpackbits(drawn, axis=2, count=width, bitorder="little").astype(bool)


def opened(bits: ArrayLike) -> np.ndarray:
    return cv2.morphologyEx(np.asarray(bits, np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))


def grown(bits: ArrayLike) -> np.ndarray:
    return cv2.dilate(np.asarray(bits, np.uint8), np.ones((3, 3), np.uint8))


def counted(planes: np.ndarray, mask: np.ndarray, points: np.ndarray, radius: np.ndarray, ignored: np.ndarray):
    """Area, exposed, outside and bare, by their definitions."""
    body = planes.any(0).astype(np.uint8)
    outside = opened(1 - grown(np.maximum(mask, ignored))) > 0
    bare = opened(mask * (1 - ignored) * (1 - grown(body))) > 0
    alone = (planes.sum(0) == 1) & (ignored == 0)
    y, x = np.nonzero(bare)
    near = [int(((x - u) ** 2 + (y - v) ** 2 < r**2).sum()) for (u, v), r in zip(points, radius, strict=True)]
    of_parts = [[int((p & where).sum()) for p in planes] for where in (np.ones_like(alone), alone, outside)]
    return (*of_parts, near)


@pytest.mark.parametrize("width", [1, 2, 63, 64, 65, 127, 128, 150])
def test_counts_are_those_of_their_definitions(width: int, rng: np.random.Generator) -> None:
    for trial in range(6):
        h = int(rng.integers(1, 90))
        uv, z, faces, part, mask = scene(rng, width, h)
        ignored = None if trial % 2 else (rng.random((h, width)) < 0.2).astype(np.uint8)
        points, radius = rng.uniform(0, [width, h], (4, 2)), rng.uniform(1, 30, 4)
        drawn = draw_parts(uv, z, faces, part, PARTS, (h, width))
        planes = planes_of(drawn, width)
        for p in range(PARTS):
            np.testing.assert_array_equal(planes[p], covered(uv, z, faces[part == p], (h, width)))
        seen = parts_against_mask(mask, ignored, drawn, points, radius)
        nothing = np.zeros_like(mask)
        expected = counted(planes, mask, points, radius, nothing if ignored is None else ignored)
        for found, right in zip(seen[:4], expected, strict=True):
            assert found.tolist() == right
        np.testing.assert_array_equal(seen.body, planes.any(0))


def test_of_a_closed_mesh_the_faces_that_turn_to_the_camera_cover_all(rng):
    body = human()
    for _ in range(8):
        pose = np.zeros(body.skeleton.dof)
        pose[6:] = rng.uniform(-0.6, 0.6, len(pose) - 6)
        vertices = body.skin(pose, body.fine) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
        uv, z = 160 * vertices[:, :2] / (vertices[:, 2:] + 4) + [50, 45], vertices[:, 2] + 4
        every = covered(uv, z, body.fine.faces, (90, 100))
        assert every.sum() > 200
        np.testing.assert_array_equal(covered(uv, z, body.fine.faces, (90, 100), closed=True), every)


def test_points_touch_the_connected_pieces_of_an_overlap() -> None:
    mask = np.zeros((40, 70), np.uint8)
    mask[5:10, 5:10], mask[10, 10], mask[20:30, 30:60] = 1, 1, 1  # the second is connected over a corner
    bits, every = (np.packbits(m, axis=1, bitorder="little") for m in (mask, np.ones_like(mask)))
    at = np.array([[6.0, 6], [69, 39], [-1, 7], [np.nan, 7]])
    assert touched_area(bits, every, (70, 40), 1, at) == (26, 300)
    assert touched_area(bits, every, (70, 40), 1, at[1:]) == (0, 300)
    assert touched_area(bits, every, (70, 40), 2, at[1:]) == (0, 75)
