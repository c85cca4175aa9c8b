"""Small synthetic pictures and rigs with known truth."""

import cv2
import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.evidence.frame import Silhouettes
from hypose.geometry import se3
from hypose.tracking.start_search import known_pose


def ring(count=4, radius=3.5, height=1.2, size=(320, 240), focal=260.0, target=(0.0, 0.0, 0.9), start=0.3):
    """Cameras on a ring, looking at the target."""
    cameras = []
    for i in range(count):
        a = 2 * np.pi * i / count + start
        position = np.array([radius * np.cos(a), radius * np.sin(a), height])
        z = np.asarray(target) - position
        z = z / np.linalg.norm(z)
        x = np.cross(z, [0, 0, 1])
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z])
        k = np.array([[focal, 0, size[0] / 2 - 0.5], [0, focal, size[1] / 2 - 0.5], [0, 0, 1]])
        cameras.append(Camera(f"c{i + 1}", k, np.zeros(5), se3(rotation, -rotation @ position), size))
    return CameraRig(tuple(cameras))


def far_ring(count, target=(0.0, 0.0, 0.9)):
    """Cameras so far away, and one along each axis, that the hull of a box is the box but for whole pixels."""
    return ring(count, 40.0, target[2], (320, 320), 5000.0, target, start=0.0)


def solid_masks(rig, inside_points):
    """Silhouettes of a convex solid, by its points (N, 3): pixels whose centre is in the hull of the images."""
    masks = []
    for camera in rig:
        u, v = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
        outline = cv2.convexHull(camera.project_pinhole(inside_points).astype(np.float32))[:, 0]
        side = []
        for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, 0), strict=True):
            side.append((bx - ax) * (v - ay) - (by - ay) * (u - ax))
        side = np.stack(side)
        masks.append(((side >= 0).all(0) | (side <= 0).all(0)).astype(np.uint8))
    return Silhouettes(np.stack(masks), rig, np.ones(len(rig), bool), ("",) * len(rig))


def on_floor(body, place):
    """The pose (D,) of a body that stands on the floor at a place (2,) m."""
    pose = known_pose(body, "standing")
    pose[:3] = *place, 0.0
    pose[2] -= body.skin(pose)[:, 2].min()
    return pose


def masks_of(shapes, rig):
    """The union of the masks of bodies."""
    size = rig.sizes.max(0)
    masks = np.zeros((len(rig), size[1], size[0]), np.uint8)
    for shape in shapes:
        for c, (y0, y1, x0, x1) in enumerate(shape.boxes):
            masks[c, y0:y1, x0:x1] |= shape.drawn(c)
    return Silhouettes(masks, rig, np.ones(len(rig), bool), ("",) * len(rig))


def room(rng, shape=(240, 320), grey=False):
    """A textured picture."""
    low = rng.integers(70, 200, (shape[0] // 20, shape[1] // 20, 1 if grey else 3)).astype(np.float32)
    picture = cv2.resize(low, shape[::-1], interpolation=cv2.INTER_CUBIC).reshape(*shape, -1)
    return np.clip(np.broadcast_to(picture, (*shape, 3)), 60, 210)


def ellipse(shape, t, axes=(28, 62)):
    """The person: an ellipse that walks from left to right. t in 0..1."""
    mask = np.zeros(shape, np.uint8)
    centre = (int(60 + t * (shape[1] - 120)), int(115 + 8 * np.sin(9 * t)))
    cv2.ellipse(mask, centre, axes, 8 * np.sin(5 * t), 0, 360, 1, -1)
    return mask


def picture(rng, background, mask, shadow=0.65, grey=False, noise=3.0):
    """The scene with a textured person and a cast shadow beside the feet."""
    h, w = mask.shape
    out = background.copy()
    if shadow:
        ys, xs = np.nonzero(mask)
        cast = np.zeros_like(mask)
        cv2.ellipse(cast, (int(xs.mean()) + 26, int(ys.max()) - 4), (34, 14), 0, 0, 360, 1, -1)
        out[(cast > 0) & (mask == 0)] *= shadow
    texture = room(np.random.default_rng(5), (h, w), grey)
    # blue clothes in the colour scene, only darker than the room in the grey one
    person = texture * (0.6 if grey else 1) + (0 if grey else np.array([70.0, -45.0, -70.0]))
    out[mask > 0] = person[mask > 0]
    return np.clip(out + rng.normal(0, noise, out.shape), 0, 255).astype(np.uint8)


def iou(a, b):
    """Intersection over union of two masks, which are where they are not 0."""
    return ((a > 0) & (b > 0)).sum() / ((a > 0) | (b > 0)).sum()
