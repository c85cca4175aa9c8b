"""Pictures of a body with a texture that sticks to it, before a plain or a cluttered wall."""

import cv2
import numpy as np

from hypose.cameras.camera import Camera
from hypose.compute.zbuffer import interpolate, rasterize
from hypose.synthetic.scenes import look_at

SIZE = (240, 200)


def camera(body, azimuth=40.0, distance=3.5):
    """A camera so many metres from a body at the origin; at 3.5 m it sees it about 150 px tall."""
    a = np.radians(azimuth)
    place = np.array([distance * np.sin(a), -distance * np.cos(a), 0.3])
    return look_at("cam", place, np.array([0.0, 0, -0.05]), 290.0, SIZE)


def wall(seed=0, clutter=0):
    """(h, w, 3) float: a soft texture, and `clutter` rectangles."""
    rng = np.random.default_rng(seed)
    w, h = SIZE
    picture = 130 + 12 * cv2.GaussianBlur(rng.normal(size=(h, w, 1)), (0, 0), 6)[..., None] * 6
    picture = np.repeat(picture, 3, axis=2)
    for _ in range(clutter):
        x, y = int(rng.integers(w)), int(rng.integers(h))
        color = rng.uniform(60, 200, 3).tolist()
        cv2.rectangle(picture, (x, y), (x + int(rng.integers(8, 60)), y + int(rng.integers(8, 80))), color, -1)
    return picture


def picture(body, pose, view: Camera, background, seed=0):
    """(h, w, 3) uint8 of the body's fine mesh in a pose."""
    rng = np.random.default_rng(seed)
    rest = body.fine.vertices
    waves = sum(np.cos(rest @ (f * rng.normal(size=3)) + rng.uniform(0, 6)) for f in (20, 20, 40, 40, 70))
    part = body.fine.main_joint
    color = np.array([60.0, 50, 90]) + 20 * (part[:, None] % 3) * [1, 0.3, -0.5] + 12 * waves[:, None]
    v = body.skin(pose, body.fine)
    h = v @ view.projection[:, :3].T + view.projection[:, 3]
    drawing = h[:, :2] / h[:, 2:], h[:, 2], body.fine.faces
    _, face = rasterize(*drawing, view.size)
    out = background.copy()
    shown = face >= 0
    out[shown] = interpolate(face, *drawing, color)
    out = cv2.GaussianBlur(out, (0, 0), 0.6) + rng.normal(0, 1.5, out.shape)
    return np.clip(out, 0, 255).astype(np.uint8)


def mask(body, pose, view: Camera):
    """(h, w) uint8 silhouette."""
    v = body.skin(pose, body.fine)
    h = v @ view.projection[:, :3].T + view.projection[:, 3]
    return (rasterize(h[:, :2] / h[:, 2:], h[:, 2], body.fine.faces, view.size)[1] >= 0).astype(np.uint8)
