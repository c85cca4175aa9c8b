"""Detect body ends from several views: a detector's probabilities in images are combined on the visual hull's surface.

In order: oriented surface points, their visibility in every view, the probability that each shows a part, clusters of
likely points, and the body end of each cluster. Source: Alcoverro 2014, section 2.5.1, eqs. 2.16 to 2.19.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.compute.zbuffer import rasterize
from hypose.errors import EvidenceError
from hypose.evidence.frame import Detections, Silhouettes
from hypose.evidence.hull import Hull, visual_hull
from hypose.evidence.skin import ColorTable, learned_table
from hypose.geometry import Array

UNNAMED = -1
"""Part of a detection that may be any of the ends (a skin detector does not distinguish hands and head)."""


def visibility(hull: Hull, rig: CameraRig, usable: NDArray[np.bool_] | None = None) -> Array:
    """Compute how well each camera sees each surface point.

    hull: whose surface points are used.
    rig: pinhole cameras.
    usable: (C,) views that count (default: all).
    A point is seen where no other surface point lies in front of it (z-buffer with cells of two voxels, so that the
    points leave no holes) and it faces the camera. The factor is -z_c . n_q, with the camera's optical axis z_c and the
    normal n_q.
    Returns: (C, S) factors, 0 where not seen; columns sum to 1, or are all 0 where no camera sees the point.
    Source: Alcoverro 2014, eq. 2.16, normalised as after eq. 2.17.
    """
    out = np.zeros((len(rig), len(hull.surface_points)))
    for c, camera in enumerate(rig):
        if usable is not None and not usable[c]:
            continue
        axis = camera.camera_from_world[2, :3]
        depth = hull.surface_points @ axis + camera.camera_from_world[2, 3]
        uv = camera.project_pinhole(hull.surface_points)
        front = (depth > 0.05) & np.isfinite(uv).all(1)
        if not front.any():
            continue
        cell = max(1.0, 2.0 * hull.voxel * camera.K[0, 0] / float(np.median(depth[front])))
        at = np.clip(np.rint(uv[front] / cell), -1e6, 1e6).astype(np.int64)
        cells, number = np.unique(at[:, 1] * 4_000_000 + at[:, 0], return_inverse=True)
        nearest = np.full(len(cells), np.inf)
        np.minimum.at(nearest, number, depth[front])
        facing = -(hull.normals @ axis)
        seen = front & (facing > 0)
        seen[front] &= depth[front] <= nearest[number] + 3.0 * hull.voxel
        out[c, seen] = facing[seen]
    total = out.sum(0)
    return out / np.where(total > 0, total, 1.0)


def surface_probability(hull: Hull, seen: Array, maps: NDArray[np.float32], rig: CameraRig) -> Array:
    """Compute the probability (S,) that each surface point shows a part: sum over views of visibility times
    detector.

    hull: visual hull with S surface points.
    seen: (C, S) from `visibility`.
    maps: (C, h, w) the detector's probability at the pixels of the pinhole rig; 0 outside the images.
    Source: Alcoverro 2014, eq. 2.17.
    """
    out = np.zeros(len(hull.surface_points))
    for c, camera in enumerate(rig):
        some = np.flatnonzero(seen[c] > 0)
        uv = np.rint(camera.project_pinhole(hull.surface_points[some])).astype(np.int64)
        inside = ((uv >= 0) & (uv < np.array(camera.size))).all(1)
        some, uv = some[inside], uv[inside]
        out[some] += seen[c, some] * maps[c, uv[:, 1], uv[:, 0]]
    return out


@dataclass(frozen=True)
class ClusterSettings:
    """Limits of the clusters of surface points that likely show a head or hand; sizes hold for a stature of 1.75 m.

    threshold: least probability of a surface point (Gamma).
    tolerance: m, largest distance of neighbours in a cluster.
    low, high: m^2, smallest and largest surface of a cluster (a hand has 0.02 to 0.05 m^2 on a hull, a head with the
        neck up to 0.15).
    """

    threshold: float = 0.5
    tolerance: float = 0.045
    low: float = 0.004
    high: float = 0.16


def likely_clusters(
    hull: Hull, probability: Array, settings: ClusterSettings = ClusterSettings(), stature: float = 1.75
) -> tuple[Array, Array]:
    """Cluster the likely surface points: points within the tolerance of each other (single linkage).

    hull: visual hull with S surface points.
    settings: limits of a cluster.
    stature: height of the person, m; sizes grow in proportion to it.
    probability: (S,) probability of each surface point.
    Returns: centres (E, 3), m, and mean probabilities (E,), largest cluster first.
    Source: Alcoverro 2014, eq. 2.18 and the clustering after it.
    """
    from scipy.cluster.hierarchy import fcluster, linkage  # takes long to import

    scale = stature / 1.75
    likely = np.flatnonzero(probability >= settings.threshold)
    if len(likely) < 2:
        return np.zeros((0, 3)), np.zeros(0)
    points = hull.surface_points[likely]
    near = max(settings.tolerance * scale, 1.8 * hull.voxel)
    label = fcluster(linkage(points, "single"), near, "distance") - 1
    counts = np.bincount(label)
    # a rim voxel stands for the area of its face, on slanting surfaces for more
    area = counts * hull.voxel**2 / scale**2
    kept = np.flatnonzero((area >= settings.low) & (area <= settings.high))
    kept = kept[np.argsort(-counts[kept], kind="stable")]
    centres = np.stack([np.bincount(label, points[:, a])[kept] / counts[kept] for a in range(3)], 1)
    return centres, np.bincount(label, probability[likely])[kept] / counts[kept]


def assign_ends(points: ArrayLike, ends: ArrayLike, limits: ArrayLike) -> NDArray[np.int64]:
    """Assign detected points to body ends: as many as possible within the limits, then with the least total distance.

    points: (E, 3) m.
    ends: (I, 3) end effectors of the previous pose, m.
    limits: (I,) m (Upsilon).
    Returns: (E,) index of the end of each point, UNNAMED for none; each end gets at most one point.
    Source: Alcoverro 2014, eq. 2.19. Deviations: the printed equation has the least mean distance of an assignment,
        which a single close pair would minimise; this follows the text instead. It is solved exactly instead of
        greedily.
    """
    from scipy.optimize import linear_sum_assignment  # takes long to import

    p, q = np.asarray(points, dtype=np.float64).reshape(-1, 3), np.asarray(ends, dtype=np.float64).reshape(-1, 3)
    limit = np.asarray(limits, dtype=np.float64)
    out = np.full(len(p), UNNAMED, dtype=np.int64)
    distance = np.linalg.norm(p[:, None] - q[None], axis=-1)
    valid = distance <= limit
    # one more assignment is worth more than any sum of distances
    cost = np.where(valid, distance - (1.0 + limit.sum()), 0.0)
    rows, columns = linear_sum_assignment(cost)
    kept = valid[rows, columns]
    out[rows[kept]] = columns[kept]
    return out


def detect_ends(
    silhouettes: Silhouettes,
    maps: NDArray[np.float32],
    centre: Array,
    stature: float = 1.75,
    *,
    voxel: float = 0.03,
    settings: ClusterSettings = ClusterSettings(),
) -> tuple[Detections, Array]:
    """Detect body ends (hands, head, feet), without names, in one frame: clusters of high detector probability on
    the surface of the visual hull.

    stature: height of the person, m.
    voxel: edge length of the hull, m.
    settings: limits of a cluster.
    maps: (C, h, w) probability of a body end at each pixel of the masks.
    centre: (3,) m, approximate place of the person (the start pose's pelvis); the hull is carved within 0.75 statures
        of it.
    Returns: the detections (none without a hull); the hull's centroid (3,), m, as the centre for the next frame.
    With four views or more, one of them may miss a part of the person.
    """
    reach = 0.75 * stature
    bounds = np.stack([centre - reach, centre + reach])
    try:
        hull = visual_hull(silhouettes, bounds, voxel, miss=int(silhouettes.usable.sum() >= 4))
    except EvidenceError:
        return Detections(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int32)), centre
    seen = visibility(hull, silhouettes.rig, silhouettes.usable)
    probability = surface_probability(hull, seen, maps, silhouettes.rig)
    points, score = likely_clusters(hull, probability, settings, stature)
    return Detections(points, score, np.full(len(points), UNNAMED, np.int32)), hull.centroid


END_JOINTS = ("left_wrist", "right_wrist", "head")
"""The joints whose parts a skin detector shows: hands and head."""


def end_colors(
    body: Body, pose: Array, silhouettes: Silhouettes, images: NDArray[np.uint8], prior: float = 0.3
) -> ColorTable:
    """Learn the colours of a person's head and hands against the rest, from one frame with a known pose (D,).

    silhouettes: masks of the frame.
    images: (C, h, w, 3) uint8 BGR at the masks' pixels. Pixels count where the posed body shows a part at least a pixel
        inside the mask.
    prior: share of head and hands among the pixels.
    Returns: table of probabilities, see `skin.ColorTable`.
    """
    mesh = body.fine
    vertices = body.skin(pose, mesh)
    end = np.isin(mesh.main_joint, [body.skeleton.joint(n) for n in END_JOINTS])[mesh.faces].sum(1) >= 2
    ends, rest = [np.zeros((0, 3), np.uint8)], [np.zeros((0, 3), np.uint8)]
    for c in np.flatnonzero(silhouettes.usable):
        camera = silhouettes.rig[int(c)]
        depth = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
        _, face = rasterize(camera.project_pinhole(vertices), depth, mesh.faces, camera.size)
        h, w = face.shape
        inner = cv2.erode(silhouettes.masks[c, :h, :w], np.ones((3, 3), np.uint8)) > 0
        picture, shown = images[c, :h, :w], inner & (face >= 0)
        is_end = shown & end[np.maximum(face, 0)]
        ends.append(picture[is_end])
        rest.append(picture[shown & ~is_end])
    return learned_table(np.concatenate(ends), np.concatenate(rest), prior)
