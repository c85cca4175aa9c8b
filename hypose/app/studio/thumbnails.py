"""The small picture of a result in a list: the person, cut out of a recorded picture, with the skeleton."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from hypose.app.reports.result_pictures import Image
from hypose.app.studio.catalog import NotFound
from hypose.app.studio.view_pictures import ViewPictures
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array

_SIZE = (192, 144)
"""px, width and height."""
_ROOM = 1.35
"""The picture's height over that of the joints in it."""
_QUALITY = 82
_LEFT, _RIGHT, _MIDDLE = (74, 160, 245), (245, 178, 91), (247, 245, 242)  # BGR; as in View


@dataclass(frozen=True)
class Glimpse:
    """What is kept of a motion for its picture: rows with their joints (J, 3) m, of which the first that has a picture
    is shown."""

    rows: tuple[tuple[int, Array], ...]
    skeleton: Skeleton


def glimpse_of(motion: Motion) -> Glimpse:
    """The frame in the middle, and the first one, for where the pictures end before."""
    seen = np.flatnonzero(np.isfinite(motion.joints).all((1, 2)))
    rows = [int(seen[k]) for k in (len(seen) // 2, 0)] if len(seen) else []
    return Glimpse(tuple((t, motion.joints[t].copy()) for t in rows), motion.skeleton)


def thumbnail(glimpse: Glimpse, pictures: ViewPictures) -> bytes:
    """A JPEG of it as the first camera with a picture sees it; NotFound when none has one."""
    for row, joints in glimpse.rows:
        found = pictures.seen(row, joints)
        if found is not None:
            return _drawn(*found, glimpse.skeleton)
    raise NotFound("There are no pictures of this result.")


def _drawn(image: Image, points: Array, skeleton: Skeleton) -> bytes:
    h, w = image.shape[:2]
    inside = points[np.isfinite(points).all(1)]
    low, high = (inside.min(0), inside.max(0)) if len(inside) else (np.zeros(2), np.array([w, h], dtype=float))
    across, up = (_ROOM * (high - low)).tolist()
    tall = min(float(h), max(24.0, up, across * _SIZE[1] / _SIZE[0]))
    wide = min(float(w), tall * _SIZE[0] / _SIZE[1])
    tall = wide * _SIZE[1] / _SIZE[0]
    corner = np.clip((low + high) / 2 - (wide / 2, tall / 2), 0, np.maximum((w - wide, h - tall), 0))
    scale = _SIZE[0] / wide
    cut = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    small = cv2.warpAffine(image, cut, _SIZE, flags=cv2.INTER_AREA)
    at = scale * (points - corner)
    names = skeleton.joint_names
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0 or not np.isfinite(at[[joint, parent]]).all():
            continue
        a, b = ((round(float(x)), round(float(y))) for x, y in at[[parent, joint]])
        colour = _LEFT if names[joint].startswith("left") else _RIGHT if names[joint].startswith("right") else _MIDDLE
        cv2.line(small, a, b, (20, 20, 20), 4, cv2.LINE_AA)
        cv2.line(small, a, b, colour, 2, cv2.LINE_AA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
