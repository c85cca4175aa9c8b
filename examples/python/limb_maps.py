"""A cue of your own that is measured per frame: label images that give the limb of the person at each pixel.

Human-parsing networks make such maps. Labels distinguish an arm in front of the trunk from one behind it; outlines do
not. A search counts the pixels where a body shows another limb; a solve draws bones into their regions. Give the maps
of a frame as `replace(frame, more=(LimbMaps(labels, rig),))`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.compute.arrays import PreparedMasks, prepare_masks
from hypose.compute.part_colours import colour_sums
from hypose.errors import InputError
from hypose.evidence.terms import Evidence, Limb, RowTerm
from hypose.geometry import Array

_OF_ONE_SIDE = (("shoulder",), ("elbow", "wrist"), ("hip",), ("knee", "ankle"))
LABELS = tuple(tuple(f"{side}_{n}" for n in names) for side in ("left", "right") for names in _OF_ONE_SIDE)
"""Joints whose skin is a limb: upper arm, forearm, thigh and shank of the left side, then of the right side. A pixel of
LABELS[k] has the label k + 2; 1 is the trunk with the head, 0 is unknown."""


@dataclass(frozen=True)
class LimbSettings:
    """Weights of limb label images in searches and solves. Chosen on folded arms and serves of the seeds 500 and 503
    (benchmark `arms`).

    wrong: cost of a pixel of the wrong limb in a search, relative to one outside the mask.
    along: places on a limb's bone, in lengths of the bone, that a solve draws to the middle line of its region;
        values
        above 1 are in the hand.
    weight: weight of such a place in one view; sd_of_height: sd of its offset, in heights of the person.
    few: pixels that a limb must show to have a region; middles: pixels of its middle line that are used."""

    wrong: float = 0.5
    along: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3)
    weight: float = 0.05
    sd_of_height: float = 0.02
    few: int = 12
    middles: int = 12


_SETTINGS = LimbSettings()


@dataclass(frozen=True)
class LimbMaps:
    """Limb label images of one instant: the limb that each pixel shows.

    labels: (C, h, w) uint8, see LABELS, undistorted, padded with 0 to the common size.
    rig: the pinhole cameras of these images.
    Raises: InputError where the shape or a label is wrong."""

    labels: NDArray[np.uint8]
    rig: CameraRig

    def __post_init__(self) -> None:
        needed = len(self.rig), *self.rig.sizes.max(0)[::-1].tolist()
        if np.shape(self.labels) != needed or np.max(self.labels) > len(LABELS) + 1:
            raise InputError(
                f"Limb maps need labels 0 to {len(LABELS) + 1} of shape {needed}, got {np.shape(self.labels)} "
                f"and labels up to {np.max(self.labels)}."
            )

    def prepared(self, body: Body) -> LimbEvidence:
        """Prepare the maps for a search and for solves of a body."""
        usable = np.array([view.any() for view in self.labels], dtype=np.bool_)
        masks = prepare_masks(self.labels > 0, usable, self.rig.sizes, self.rig.projections)
        return LimbEvidence(usable, (self._term(body),), masks, self.labels.astype(np.uint16))

    def _term(self, body: Body) -> RowTerm:
        """Build the rows of a solve: from the middle line of each limb's region to the nearest points of its bone."""
        s, along, targets, view, joint, scale = body.skeleton, _SETTINGS.along, [], [], [], []
        for c, labels in enumerate(self.labels):
            height = cv2.boundingRect((labels > 0).view(np.uint8))[3]
            for k, names in enumerate(LABELS):
                middle = _middle_line((labels == k + 2).view(np.uint8))
                if len(middle):
                    targets.append(middle)
                    view.append(c)
                    joint.append(s.joint(names[0]))
                    scale.append(_SETTINGS.sd_of_height * height)
        bones = [share * s.rest_offsets[s.parents == j][0] for j in joint for share in along]
        projections = self.rig.projections[np.array(view, dtype=np.int64)]

        def residuals(points: Array) -> tuple[Array, Array]:
            return _to_bones(points.reshape(len(targets), len(along), 3), projections, targets, np.array(scale))

        carrier = np.repeat(np.array(joint, dtype=np.int64), len(along))
        return RowTerm(carrier, residuals, np.reshape(bones, (-1, 3)), np.full(len(carrier), _SETTINGS.weight))


def _middle_line(region: NDArray[np.uint8]) -> Array:
    """Find at most `middles` pixels (M, 2) on the middle line of a region (h, w); none where it is too small."""
    x, y, w, h = cv2.boundingRect(region)
    if w * h < _SETTINGS.few:
        return np.zeros((0, 2))
    inside = cv2.distanceTransform(np.pad(region[y : y + h, x : x + w], 1), cv2.DIST_L2, 5)
    row, column = np.nonzero((inside > 1) & (inside == cv2.dilate(inside, np.ones((5, 5), np.uint8))))
    every = np.unique(np.linspace(0, max(len(row) - 1, 0), min(_SETTINGS.middles, len(row))).astype(int))
    return np.column_stack([column, row])[every].astype(np.float64) + (x - 1, y - 1)


def _to_bones(points: Array, projections: Array, targets: Sequence[Array], scale: Array) -> tuple[Array, Array]:
    """Compute the offset (P, 2) of points on bones from the mean of the pixels that are nearest to each, and its
    derivative (P, 2, 3), in sd; NaN where no pixel is nearest.

    points (G, A, 3) of G bones, each in one view; projections (G, 3, 4); targets: G x (M, 2) px; scale (G,) px.
    """
    h = np.einsum("gij,gaj->gai", projections[:, :, :3], points) + projections[:, None, :, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = np.where(h[..., 2:] > 0, h[..., :2] / h[..., 2:], np.nan)
    r = np.full(uv.shape, np.nan)
    for g in np.flatnonzero(np.isfinite(uv).all((1, 2))).tolist():
        nearest = np.linalg.norm(targets[g][:, None] - uv[g], axis=-1).argmin(1)
        for a in np.unique(nearest):
            r[g, a] = uv[g, a] - targets[g][nearest == a].mean(0)
    across = projections[:, None, :2, :3] - uv[..., None] * projections[:, None, 2:, :3]
    slope = across / (h[..., 2] * scale[:, None])[..., None, None]
    return (r / scale[:, None, None]).reshape(-1, 2), slope.reshape(-1, 2, 3)


@dataclass(frozen=True)
class LimbEvidence(Evidence):
    """Limb labels of a frame for searches and solves.

    masks: the labelled pixels; labels: (C, h, w) their limbs.
    """

    masks: PreparedMasks
    labels: NDArray[np.uint16]

    def energy(self, body: Body, poses: Array, limb: Limb | None = None) -> Array:
        """Compute the share (N,) of the labelled pixels where a body shows another limb, summed over the views,
        times `wrong`."""
        count, use = len(LABELS) + 2, self.masks.usable
        wrong = 1.0 - np.eye(count, dtype=np.float32)[1:]
        wrong[:, 0] = 0
        table = np.repeat(wrong[None], len(use), 0)
        sums = colour_sums(body.skin(poses), body.coarse.faces, limb_of_faces(body), self.masks, self.labels, table)[0]
        return _SETTINGS.wrong * (sums[:, use] / np.maximum(self.masks.areas[use], 1)).sum(1)


def limb_of_faces(body: Body) -> NDArray[np.uint8]:
    """Look up to which limb each face (F,) of the body's coarse mesh belongs: the limb's label in LABELS, minus 1."""
    return limb_of_joints(body.skeleton.joint_names)[body.coarse.face_joint]


def limb_of_joints(names: Sequence[str]) -> NDArray[np.uint8]:
    """Look up to which limb each joint (J,) belongs, by its name: the limb's label in LABELS, minus 1."""
    return np.array([next((k + 1 for k, own in enumerate(LABELS) if n in own), 0) for n in names], dtype=np.uint8)


if __name__ == "__main__":
    from hypose.body.default_body import human
    from hypose.compute.part_colours import shown_parts
    from hypose.synthetic.scenes import camera_rig
    from hypose.tracking.start_search import known_pose

    person, cameras = human(), camera_rig("humaneva-4").pinhole()
    right, wrong = (known_pose(person, name) for name in ("standing", "hands-up"))
    drawn = person.skin(right), person.coarse.faces, limb_of_faces(person)
    shown = np.stack([shown_parts(*drawn, c.projection, c.size[::-1])[0] for c in cameras])
    energies = LimbMaps(shown, cameras).prepared(person).energy(person, np.stack([right, wrong]))
    print(f"energy of the labels: {energies[0]:.2f} at the right pose, {energies[1]:.2f} with the hands up")
