"""Compute the visual hull: the space that all silhouettes leave to the person (space carving on voxels, coarse to
fine).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array

_COARSE = 24  # cells along the longest side of the space at the coarsest level
_MAX_CELLS = 20_000_000


@dataclass(frozen=True)
class Hull:
    """Occupied voxels of a visual hull.

    occupancy: (nx, ny, nz) bool.
    origin: (3,) centre of voxel [0, 0, 0] in the world, m.
    voxel: edge length, m.
    """

    occupancy: NDArray[np.bool_]
    origin: Array
    voxel: float

    @cached_property
    def points(self) -> Array:
        """Centres (M, 3) of the occupied voxels in the world, m."""
        return self.origin + np.argwhere(self.occupancy) * self.voxel

    @property
    def volume(self) -> float:
        """Volume of the hull, m^3."""
        return float(self.occupancy.sum()) * self.voxel**3

    @property
    def centroid(self) -> Array:
        """Mean of the occupied voxels (3,) in the world, m."""
        return self.points.mean(0)

    @property
    def height(self) -> float:
        """Extent of the hull along world z, m."""
        return float(np.ptp(self.points[:, 2])) + self.voxel

    @cached_property
    def _rim(self) -> NDArray[np.int64]:
        """Indices (S, 3) of the occupied voxels that touch free space."""
        return np.argwhere(self.occupancy & ~np.asarray(ndimage.binary_erosion(self.occupancy), dtype=np.bool_))

    @property
    def surface_points(self) -> Array:
        """Centres (S, 3) of the voxels that touch free space, m."""
        return self.origin + self._rim * self.voxel

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals (S, 3) at surface_points.

        Each points away from the centre of the occupied voxels in a 5 x 5 x 5 neighbourhood; (0, 0, 1) where that
        centre is the voxel itself.
        """
        solid, step = np.pad(self.occupancy, 2), np.arange(-2, 3)
        offsets = np.stack(np.meshgrid(step, step, step, indexing="ij"), -1).reshape(-1, 3)
        strides = np.array([solid.shape[1] * solid.shape[2], solid.shape[2], 1])
        around = solid.ravel()[((self._rim + 2) @ strides)[:, None] + offsets @ strides]  # (S, 125)
        inward = around.astype(np.float32) @ offsets.astype(np.float32)
        norm = np.linalg.norm(inward, axis=1, keepdims=True)
        return np.where(norm > 1e-6, -inward / np.maximum(norm, 1e-6), [0.0, 0.0, 1.0]).astype(np.float64)


def common_view_bounds(rig: CameraRig) -> Array:
    """Compute the cube that all cameras look at: around the point nearest to all optical axes, as far as the farthest
    camera.

    rig: two cameras or more.
    Returns: (2, 3) lowest and highest corner, m.
    Raises: EvidenceError where the axes do not meet.
    """
    directions = np.stack([c.camera_from_world[2, :3] for c in rig])
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    a = across.sum(0)
    if len(rig) < 2 or np.linalg.eigvalsh(a)[0] < 0.02 * len(rig):
        raise EvidenceError(
            f"The optical axes of the cameras {', '.join(rig.names)} (nearly) run in parallel, so the place of "
            f"the person "
            "cannot be estimated; give the bounds of the space."
        )
    centre = np.linalg.solve(a, np.einsum("cij,cj->i", across, rig.positions))
    reach = float(np.linalg.norm(rig.positions - centre, axis=1).max())
    return np.stack([centre - reach, centre + reach])


def visual_hull(
    silhouettes: Silhouettes,
    bounds: Array | None = None,
    voxel: float = 0.03,
    miss: int = 0,
    min_views: int | None = None,
    largest: bool = True,
    surely: int | None = None,
) -> Hull:
    """Compute the visual hull of the usable silhouettes.

    A voxel is occupied where at most `miss` of the views that see its centre have no person there, and at least
    min_views have one. It works coarse to fine: a cell is refined unless more than `miss` views have no person anywhere
    in its image.
    bounds: (2, 3) space to search, m (default: the cameras' common view).
    voxel: edge length, m.
    miss: number of views that may miss the person.
    min_views: default three quarters of the usable views, at least 2, as far as `miss` allows.
    largest: keep only the largest connected body.
    surely: where there are ignored pixels, which may show a person or not, number of views that must show one in pixels
        that are not ignored. Default: three, or all views; two where the person's expected place is known, since masks
        end there and other people can hide a leg from two of four views.
    Raises: EvidenceError where fewer than min_views views are usable, or nothing is left; InputError where the
        masks fill too much space.
    Source: shape from inconsistent silhouettes, Landabaso, Pardas & Casas 2008; Alcoverro 2014, section 2.3.4, places
        the body by such a hull.
    """
    views = np.flatnonzero(silhouettes.usable)
    if min_views is None:
        min_views = max(2, min(-(-3 * len(views) // 4), len(views) - miss))
    if len(views) < min_views:
        raise EvidenceError(
            f"A visual hull needs {min_views} usable silhouettes, there {'is' if len(views) == 1 else 'are'} "
            f"{len(views)}: "
            f"{'; '.join(r for r in silhouettes.reasons if r) or 'too few cameras'}."
        )
    rig = silhouettes.rig
    box = common_view_bounds(rig) if bounds is None else np.asarray(bounds, dtype=np.float64)
    extent = box[1] - box[0]
    levels = max(0, int(np.ceil(np.log2(extent.max() / (voxel * _COARSE)))))
    cells = np.ceil(extent / (voxel * 2**levels)).astype(np.int64)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), -1).reshape(-1, 3)
    given, ignored = silhouettes.informative, silhouettes.ignored
    if surely is None:
        surely = min(len(views), 3 if silhouettes.expected is None else 2)
    free_of = given if ignored is None else silhouettes.masks | ignored
    sums = {int(c): np.asarray(cv2.integral(free_of[c]), np.int32) for c in views}
    corner = np.stack(np.meshgrid(*[(0, 1)] * 3, indexing="ij"), -1).reshape(8, 3)
    for level in range(levels, -1, -1):
        edge = voxel * 2**level
        centres = box[0] + (index + 0.5) * edge
        free, hits = np.zeros(len(index), np.int16), np.zeros(len(index), np.int16)
        for k, c in enumerate(views):
            camera = silhouettes.rig[int(c)]
            empty, hit = _free_cells(camera, free_of[c], sums[int(c)], centres, edge if level else 0.0)
            free += empty
            hits += hit
            # voxels that are already excluded are not tested again
            left = len(views) - 1 - k
            open_ = (free <= miss) & (hits + left >= min_views)
            index, centres, free, hits = index[open_], centres[open_], free[open_], hits[open_]
        if level:
            index = (2 * index[:, None] + corner).reshape(-1, 3)
            if len(index) > _MAX_CELLS:
                raise InputError(
                    f"The masks fill too much space for {voxel:g} m voxels; use larger ones or give bounds."
                )
    if ignored is not None:
        plain = [_free_cells(rig[int(c)], given[c], sums[int(c)], centres, 0.0)[1] for c in views]
        index = index[np.sum(plain, axis=0) >= surely]
    if len(index) == 0:
        raise EvidenceError(
            "The visual hull is empty: the silhouettes of the cameras "
            f"{', '.join(rig.names[c] for c in views)} have no point in common; check calibration and "
            f"synchronisation, or "
            "allow one missing view."
        )
    low = index.min(0)
    occupancy = np.zeros(index.max(0) - low + 1, dtype=np.bool_)
    occupancy[tuple((index - low).T)] = True
    if largest:  # the largest connected body of voxels
        label = np.zeros(occupancy.shape, np.int32)
        count = ndimage.label(occupancy, np.ones((3, 3, 3)), output=label)
        if count != 1:
            best = int(np.bincount(label.ravel())[1:].argmax()) + 1
            where = ndimage.find_objects(label, best)[best - 1]
            occupancy, low = label[where] == best, low + [s.start for s in where]
    return Hull(occupancy, box[0] + (low + 0.5) * voxel, voxel)


def _free_cells(
    camera: Camera, mask: NDArray[np.uint8], sums: NDArray[np.int32], centres: Array, edge: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Decide for cubes (M,) whether this view surely shows no person there, and whether it possibly shows one.

    camera: camera of the view.
    mask: (h, w) 0 or 1.
    sums: (h + 1, w + 1) its integral image.
    centres: (M, 3) centres of the cubes, m.
    Returns: (M,) true where the whole cube projects into the image and on no pixel of a person; (M,) true where some
        pixel of a person may belong to it.
    edge: edge of the cubes, m; 0: only their centres are tested.
    """
    w, h = camera.size
    x = centres @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    radius = 0.5 * np.sqrt(3.0) * edge
    front = x[:, 2] > radius + 1e-6
    z = np.where(front, x[:, 2], 1.0)
    u = camera.K[0, 0] * x[:, 0] / z + camera.K[0, 1] * x[:, 1] / z + camera.K[0, 2]
    v = camera.K[1, 1] * x[:, 1] / z + camera.K[1, 2]
    u, v = np.clip(u, -1e6, 1e6), np.clip(v, -1e6, 1e6)
    if edge == 0.0:
        iu, iv = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
        inside = front & (iu >= 0) & (iu < w) & (iv >= 0) & (iv < h)
        person = mask[np.clip(iv, 0, h - 1), np.clip(iu, 0, w - 1)] > 0
        return inside & ~person, inside & person
    # an upper bound of the image of the ball around the cube: |d(u)| <= r (f + |u - cx|) / (z - r)
    depth = np.maximum(z - radius, 1e-6)
    ru = radius * (camera.K[0, 0] + abs(camera.K[0, 1]) + np.abs(u - camera.K[0, 2])) / depth + 1
    rv = radius * (camera.K[1, 1] + np.abs(v - camera.K[1, 2])) / depth + 1
    near = ~front & (x[:, 2] > -radius)  # holds or touches the camera's plane: nothing is known
    u0, u1, v0, v1 = np.floor(u - ru), np.ceil(u + ru), np.floor(v - rv), np.ceil(v + rv)
    within = front & (u0 >= 0) & (u1 < w) & (v0 >= 0) & (v1 < h)
    a0, a1 = np.clip(u0, 0, w).astype(np.int64), np.clip(u1 + 1, 0, w).astype(np.int64)
    b0, b1 = np.clip(v0, 0, h).astype(np.int64), np.clip(v1 + 1, 0, h).astype(np.int64)
    pixels = sums[b1, a1] - sums[b0, a1] - sums[b1, a0] + sums[b0, a0]
    return within & (pixels == 0), near | (front & (pixels > 0))


def hull_iou(hull: Hull, silhouettes: Silhouettes) -> Array:
    """Compute the intersection over union (C,) of a hull, drawn in each view, and the mask of that view; NaN for
    views that are not usable.
    """
    step = np.array([-0.5, 0.5]) * hull.voxel
    cubes = hull.surface_points[:, None] + np.stack(np.meshgrid(step, step, step), -1).reshape(8, 3)
    pictures = np.zeros_like(silhouettes.masks)
    for c, camera in enumerate(silhouettes.rig):
        w, h = camera.size
        corners = camera.project_pinhole(cubes.reshape(-1, 3)).reshape(-1, 8, 2)
        corners = np.clip(corners[np.isfinite(corners).all((1, 2))], -4 * max(w, h), 4 * max(w, h))
        for cube in np.rint(corners).astype(np.int32):
            cv2.fillConvexPoly(pictures[c, :h, :w], cv2.convexHull(cube), 1)
    masks = silhouettes.masks > 0
    both, either = (pictures & masks).sum((1, 2)), (pictures | masks).sum((1, 2))
    return np.where(silhouettes.usable, both / np.maximum(either, 1), np.nan)
