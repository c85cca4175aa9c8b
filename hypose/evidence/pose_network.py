"""Find people in a picture with two small networks: one detects them, the other gives landmarks and a mask of one crop.

Source: Bazarevsky, V. et al. (2020). BlazePose: On-device real-time body pose tracking (arXiv 2006.10204); the models
and the geometry of the crops are those of MediaPipe 0.10.21 (Apache 2.0).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from hypose.evidence.keypoints import BLAZEPOSE_33
from hypose.geometry import Array, Image

CROP, DETECTOR = 256, 224
"""px: side of the networks' input pictures"""
_LEAST_PROBABILITY = 0.5
"""Probability from which a square or a crop shows a person, and a pixel of a crop is the person."""
_WIDER = 1.25
"""Half side of a crop in radii of the circle around the body."""
_SAME, _NEARBY = 0.35, 0.5
"""Distances between hip centres, in radii: below _SAME two crops show the same person; below _NEARBY a detection is of
a person who is tracked already."""
_PART = 0.75
"""Side of the parts of a picture that the detector processes, relative to the picture's shorter side."""


@dataclass(frozen=True)
class Crop:
    """Square of a picture in which a person is searched, by two points in px of the picture.

    hips: (2,) centre of the hips, which is the centre of the square.
    top: (2,) point above it on the circle around the whole body.
    """

    hips: Array
    top: Array

    @property
    def radius(self) -> float:
        """Radius of the circle, px."""
        return float(np.linalg.norm(self.top - self.hips))

    @property
    def from_picture(self) -> Array:
        """Affine map (2, 3) from pixels of the picture to pixels of the crop, in which the body is upright."""
        x, y = self.top - self.hips
        up = np.array([x, y]) / max(np.hypot(x, y), 1e-6)
        scale = CROP / (2 * _WIDER * max(self.radius, 1.0))
        turn = scale * np.array([[-up[1], up[0]], [-up[0], -up[1]]])
        middle = 0.5 * CROP - 0.5
        return np.column_stack([turn, middle - turn @ self.hips])


@dataclass(frozen=True)
class Sighting:
    """One person in one picture.

    points: (K, 3) px of the picture, and confidence 0..1.
    mask: (CROP, CROP) float32 probability of each pixel of the crop; None: the detector gives no masks.
    crop: the square of the mask.
    following: where to search for the person in the next picture.
    """

    points: Array
    mask: NDArray[np.float32] | None = None
    crop: Crop | None = None
    following: Crop | None = None


class PoseDetector(Protocol):
    """Interface of a detector that finds people in the pictures of a view, one picture after the other."""

    @property
    def keypoint_set(self) -> str:
        """Name of the detector's set of key points, one of `hypose.evidence.keypoints.KEYPOINT_SETS`."""
        ...

    @property
    def identity(self) -> dict[str, Any]:
        """All values that determine the detector's results, as JSON values: program, version, model, settings."""
        ...

    @property
    def gives_masks(self) -> bool:
        """Whether the detector finds masks as well as key points; then several threads may call it at once."""
        ...

    def look(self, image: Image, number: int, before: Sequence[Crop], /) -> list[Sighting]:
        """Detect the people in a picture.

        image: (h, w, 3) BGR; pixel centres at integers.
        number: number of the picture in the video.
        before: expected places of the people of the previous picture.
        Returns: one item per person found; empty where there is none. It must depend on these arguments alone, so
            that interrupted work can be resumed.
        """
        ...


@dataclass(frozen=True)
class PoseNetwork:
    """Detector of points and masks of the people in consecutive pictures.

    detect: from (224, 224, 3) float32 RGB -1..1 to boxes (2254, 12), offsets from the anchors, px, and scores (2254,),
        logits.
    landmarks: from (256, 256, 3) float32 RGB 0..1 to points (39, 5) x, y px of the crop, z, logits of visibility and
        presence; probability of a person; mask (CROP, CROP), logits.
    identity: everything that determines the result, as JSON values.
    people: largest number of people in a picture.
    every: number of pictures after which the detector searches for new people, even where a person is tracked.
    """

    detect: Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], NDArray[np.float32]]]
    landmarks: Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], float, NDArray[np.float32]]]
    identity: dict[str, Any]
    people: int = 4
    every: int = 10
    keypoint_set: str = "BLAZEPOSE_33"
    gives_masks: bool = True

    def look(self, image: Image, number: int, before: Sequence[Crop] = ()) -> list[Sighting]:
        """Detect the people in a picture (h, w, 3) BGR; number: number of the picture in the video; before: squares
        in which people are expected.
        """
        found = self._in_crops(image, before, [])
        if not found or (number % self.every == 0 and len(found) < self.people):
            known = [f.following for f in found if f.following is not None]
            new = [c for c in self._detected(image) if all(_apart(c, k) > _NEARBY for k in known)]
            found = self._in_crops(image, new[: self.people - len(found)], found)
        return found

    def _in_crops(self, image: Image, crops: Sequence[Crop], found: list[Sighting]) -> list[Sighting]:
        """Add the people in the crops to those found, unless they are the same.

        image: (h, w, 3) BGR.
        crops: where to search.
        found: people found before, who come first in the result.
        """
        out = list(found)
        for crop in crops:
            person = self._person(image, crop)
            if person is None or person.following is None:
                continue
            others = [f.following for f in out if f.following is not None]
            if all(_apart(person.following, other) > _SAME for other in others):
                out.append(person)
        return out

    def _person(self, image: Image, crop: Crop) -> Sighting | None:
        """Detect the person in a crop; None where there is none."""
        to_crop = crop.from_picture
        part = cv2.warpAffine(image, to_crop, (CROP, CROP), flags=cv2.INTER_LINEAR)
        given = np.asarray(cv2.cvtColor(part, cv2.COLOR_BGR2RGB)[None], dtype=np.float32) / np.float32(255)
        points, presence, mask = self.landmarks(given)
        if not presence > _LEAST_PROBABILITY:
            return None
        back = cv2.invertAffineTransform(to_crop)
        uv = points[:, :2].astype(np.float64) @ back[:, :2].T + back[:, 2]
        count, (height, width) = len(BLAZEPOSE_33), image.shape[:2]
        score = expit(points[:count, 3]) * expit(points[:count, 4])
        inside = ((uv[:count] > -1) & (uv[:count] < (width, height))).all(1)
        following = Crop(uv[count], uv[count + 1])
        if not 4 < following.radius < 4 * max(width, height):
            return None
        person = np.column_stack([uv[:count], np.where(inside, score, 0.0)])
        return Sighting(person, expit(mask), crop, following)

    def _detected(self, image: Image) -> list[Crop]:
        """Detect people in the picture and in parts of it; return their crops, the most certain first."""
        found = [one for part in _squares(image.shape[1], image.shape[0]) for one in self._in_square(image, *part)]
        out = list[Crop]()
        for _, crop in sorted(found, key=lambda one: -one[0]):
            if all(_apart(crop, other) > _SAME for other in out):
                out.append(crop)
        return out

    def _in_square(self, image: Image, x: int, y: int, side: int) -> Iterator[tuple[float, Crop]]:
        """Detect people in a square of the picture, which may reach beyond it; yield scores and crops.

        x, y: left upper corner of the square, px.
        side: its length, px.
        """
        part = image[max(y, 0) : y + side, max(x, 0) : x + side]
        scale = DETECTOR / side
        size = max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale))
        left, top = round(max(-x, 0) * scale), round(max(-y, 0) * scale)
        square = np.zeros((DETECTOR, DETECTOR, 3), np.uint8)
        small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
        square[top : top + size[1], left : left + size[0]] = small[: DETECTOR - top, : DETECTOR - left]
        boxes, scores = self.detect(cv2.cvtColor(square, cv2.COLOR_BGR2RGB).astype(np.float32)[None] / 127.5 - 1)
        corner = np.array([max(x, 0) - left / scale, max(y, 0) - top / scale])
        for k in np.flatnonzero(expit(scores) > _LEAST_PROBABILITY):
            hips, above = (DETECTOR * _ANCHORS[k] + boxes[k, n : n + 2].astype(np.float64) for n in (4, 6))
            crop = Crop((hips + 0.5) / scale - 0.5 + corner, (above + 0.5) / scale - 0.5 + corner)
            if crop.radius > 4:
                yield float(scores[k]), crop


def _squares(width: int, height: int) -> list[tuple[int, int, int]]:
    """List the squares (x, y, side), px, that the detector processes: the whole picture, and parts for people who are
    too small in the whole.

    width, height: width and height of the picture, px.
    """
    most, side = max(width, height), round(_PART * min(width, height))

    def begins(length: int) -> list[int]:
        return np.linspace(0, length - side, int(np.ceil(2 * (length - side) / side)) + 1).round().astype(int).tolist()

    parts = [(x, y, side) for y in begins(height) for x in begins(width)]
    return [((width - most) // 2, (height - most) // 2, most), *parts]


def _anchors() -> Array:
    """Compute the centres (2254, 2) of the detector's anchors, as shares of its input."""
    out = []
    for stride, count in ((8, 2), (16, 2), (32, 6)):
        side = DETECTOR // stride
        y, x = np.divmod(np.repeat(np.arange(side * side), count), side)
        out.append(np.column_stack([x, y]) / side + 0.5 / side)
    return np.concatenate(out)


_ANCHORS = _anchors()


def _apart(a: Crop, b: Crop) -> float:
    """Compute the distance between the hips of two crops, in radii of the smaller one.

    a, b: the crops.
    """
    return float(np.linalg.norm(a.hips - b.hips)) / max(min(a.radius, b.radius), 1.0)


def owners_of_pixels(people: Sequence[Sighting], places: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Combine the people's masks into one picture (h, w), in which bit k of a pixel is set where it shows person k.

    people: at most 8 people.
    places: (h, w, 2) position of its pixels in the picture.
    """
    out = np.zeros(places.shape[:2], np.uint8)
    for k, found in enumerate(people):
        if found.crop is None or found.mask is None:
            continue
        turn = found.crop.from_picture.astype(np.float32)
        at = places @ turn[:, :2].T + turn[:, 2]
        shown = cv2.remap(found.mask, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0) > _LEAST_PROBABILITY
        out |= np.left_shift(np.asarray(shown).astype(np.uint8), k)
    return out
