"""Parts of the body on the hull's surface: normals, visibility, probability, clusters; and skin colour."""

from types import SimpleNamespace

import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.evidence.body_parts import (
    ClusterSettings,
    detect_ends,
    likely_clusters,
    surface_probability,
    visibility,
)
from hypose.evidence.frame import Silhouettes
from hypose.evidence.hull import Hull
from hypose.evidence.silhouettes import make_silhouettes
from hypose.evidence.skin import learned_table, skin_map, skin_posterior, skin_table
from hypose.synthetic.scenes import look_at

SIZE = (200, 160)


@pytest.fixture(scope="module")
def ring() -> CameraRig:
    """Four cameras 3 m around a point 1 m above the origin."""
    at = [(3, 0, 1.4), (0, 3, 1.2), (-3, 0, 1.0), (0, -3, 1.3)]
    return CameraRig(tuple(look_at(f"cam{k}", p, [0, 0, 1], 300, SIZE) for k, p in enumerate(at)))


def ball(centre=(0.0, 0.0, 1.0), radius: float = 0.2, voxel: float = 0.02) -> Hull:
    n = int(radius / voxel) + 3
    grid = np.stack(np.meshgrid(*[np.arange(-n, n + 1)] * 3, indexing="ij"), -1) * voxel
    return Hull(np.linalg.norm(grid, axis=-1) <= radius, np.array(centre) - n * voxel, voxel)


def sphere_masks(rig: CameraRig, spheres) -> Silhouettes:
    """Exact masks of spheres (centre, radius)."""
    masks = []
    for camera in rig:
        w, h = camera.size
        uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).astype(np.float64)
        origin, rays = camera.rays(uv)
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        mask = np.zeros((h, w), np.uint8)
        for centre, radius in spheres:
            to = np.asarray(centre) - origin
            along = rays @ to
            mask |= (to @ to - along**2 <= radius**2) & (along > 0)
        masks.append(mask)
    return make_silhouettes(masks, rig)


def test_visibility_is_the_cosine_to_the_axis_shared_among_the_cameras_that_see(ring):
    """Alcoverro 2014, eq. 2.16, normalised."""
    surface = ball()
    seen = visibility(surface, ring)
    total = seen.sum(0)
    assert np.allclose(total[total > 0], 1.0)
    assert (total > 0).mean() > 0.9  # from the ring all but the very bottom and top
    # the point that faces the first camera is seen by it most, and not at all by the one behind
    nearest = int(np.argmax(surface.surface_points[:, 0]))
    assert seen[0, nearest] > 0.8 and seen[2, nearest] == 0
    axes = np.stack([c.camera_from_world[2, :3] for c in ring])
    raw = np.maximum(-(surface.normals @ axes.T).T, 0)
    both = (seen[0] > 0) & (seen[1] > 0) & (seen[2] == 0) & (seen[3] == 0)
    assert np.allclose(seen[0, both] / seen[1, both], raw[0, both] / raw[1, both])


def test_probability_is_the_visibility_weighted_detector(ring):
    """Alcoverro 2014, eq. 2.17."""
    surface = ball()
    seen = visibility(surface, ring)
    maps = np.zeros((4, SIZE[1], SIZE[0]), np.float32)
    maps[0], maps[1] = 0.75, 0.25
    probability = surface_probability(surface, seen, maps, ring)
    assert np.allclose(probability, 0.75 * seen[0] + 0.25 * seen[1], atol=1e-6)


def test_clusters_are_told_apart_and_sized():
    """Alcoverro 2014, eq. 2.18 and the clustering by tolerance and size after it."""
    rng = np.random.default_rng(0)
    spots = np.array([[0, 0, 1.5], [0.5, 0, 1.0], [-0.5, 0, 1.0]])
    counts = (200, 60, 5)  # the last is too small
    points = np.concatenate([s + rng.uniform(-0.05, 0.05, (n, 3)) for s, n in zip(spots, counts, strict=True)])
    background = rng.uniform(-1, 1, (300, 3))
    surface = SimpleNamespace(surface_points=np.concatenate([points, background]), voxel=0.02)
    probability = np.concatenate([np.full(265, 0.8), np.full(300, 0.2)])
    centres, score = likely_clusters(surface, probability, ClusterSettings(0.5, 0.06, 0.004, 0.2))
    assert len(centres) == 2
    assert np.abs(centres - spots[:2]).max() < 0.02
    assert score == pytest.approx([0.8, 0.8])
    assert len(likely_clusters(surface, 0.1 * probability)[0]) == 0


def test_ends_are_found_from_maps_and_masks(ring):
    """Three spheres as a body, the upper one and one at the side marked by the detector, where it sees them."""
    spheres = [((0, 0, 1.0), 0.2), ((0, 0, 1.28), 0.08), ((0.25, 0, 1.0), 0.07)]
    silhouettes = sphere_masks(ring, spheres)
    maps = sphere_masks(ring, [spheres[1]]).masks.astype(np.float32)
    side = sphere_masks(ring, [spheres[2]]).masks
    maps[[0, 1, 3]] = np.maximum(maps, side)[[0, 1, 3]]  # the trunk hides it from the third camera
    found, centre = detect_ends(silhouettes, maps, np.array([0.0, 0, 1.0]), voxel=0.02)
    assert len(found.points) >= 2 and (found.part == -1).all()
    for sphere in spheres[1:]:
        assert np.linalg.norm(found.points - sphere[0], axis=1).min() < 0.05
    assert np.linalg.norm(centre - [0, 0, 1.05]) < 0.1


def test_skin_colours_of_the_published_mixtures():
    light, dark, blue, green = skin_posterior(
        np.array([[225, 170, 140], [120, 78, 60], [40, 60, 150], [60, 140, 60.0]])
    )
    assert light > 0.8 and dark > 0.5 and blue < 0.05 and green < 0.05
    table = skin_table()
    assert table[140 >> 2, 170 >> 2, 225 >> 2] == pytest.approx(light, abs=0.05)


def test_a_person_s_own_colours_are_learnt():
    rng = np.random.default_rng(1)
    hands = np.clip(rng.normal([50, 62, 80], 4, (1500, 3)), 0, 255).astype(np.uint8)  # dark, in shade
    shirt = np.clip(rng.normal([30, 40, 120], 4, (6000, 3)), 0, 255).astype(np.uint8)
    table = learned_table(hands, shirt)
    picture = np.zeros((20, 40, 3), np.uint8)
    picture[:, :20], picture[:, 20:] = [50, 62, 80], [30, 40, 120]
    probability = skin_map(picture, picture[..., 0], table)
    assert probability[10, 8] > 0.8 and probability[10, 32] < 0.05
    assert skin_map(picture, picture[..., 0])[10, 8] < 0.5  # which the general model misses
    # colours never seen keep the general answer
    seldom = np.full((8, 8, 3), (140, 170, 225), np.uint8)
    assert skin_map(seldom, seldom[..., 0], table)[4, 4] == pytest.approx(
        skin_map(seldom, seldom[..., 0])[4, 4], abs=0.1
    )
