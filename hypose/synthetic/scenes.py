"""Scene: a subject that moves in front of cameras, with exact truth and the evidence that the cameras would give.

Truth: times, joints (T, 19, 3), rotations (T, 19, 3, 3), vertices on demand. Evidence: `mask_frames` (silhouettes from
    the truth) or `rgb_frames` (colour pictures for the real background model). The same seed gives the same
    scene, picture for picture, in any order of calls.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.default_body import JOINT_NAMES
from hypose.cameras.camera import Camera, CameraRig
from hypose.compute.parts import covered
from hypose.compute.zbuffer import rasterize
from hypose.errors import InputError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.keypoints import BODY_25, to_keypoints
from hypose.geometry import Array, Image, Mask, frame_of, rotation_between, se3, so3_exp, unit
from hypose.synthetic.motions import act
from hypose.synthetic.performance import OfPerformance, Performance, moved
from hypose.synthetic.render_rgb import (
    Backdrop,
    Outfit,
    Sensor,
    develop,
    light_at,
    make_outfit,
    make_room,
    noise_bank,
    render_person,
    render_room,
)
from hypose.synthetic.subjects import SyntheticSubject, dress, load_subjects

# ---- faults --------------------------------------------------------------------------------------------------------
# Faults of real recordings, by name: in the images, the timing and the calibration. Simulated key points too.


@dataclass(frozen=True)
class Corruptions:
    """Faults of a synthetic recording; the defaults corrupt nothing.

    occluder: "", "table" or "treadmill", in front of the person in several views; it belongs to the room.
    dropped: share of frames that a camera does not deliver (its last image is repeated).
    dead_camera: index of a camera whose images are black from a third of the recording on, -1 for none.
    desync: delay of each camera in frames; the c-th camera is late by desync[c % len], so (0, 1, 0, 2) delays the
        second camera by one frame and the fourth by two.
    calibration_error: relative standard deviation of the error of the calibration; 0.01 changes focal lengths and
        positions by 1 %.
    """

    occluder: str = ""
    dropped: float = 0.0
    dead_camera: int = -1
    desync: tuple[int, ...] = (0,)
    calibration_error: float = 0.0


CORRUPTIONS: dict[str, dict[str, Any]] = {
    "table": {"occluder": "table"},
    "treadmill": {"occluder": "treadmill"},
    "dropped-frames": {"dropped": 0.08},
    "dead-camera": {"dead_camera": 1},
    "desync": {"desync": (0, 1, 0, 2)},
    "calibration-error": {"calibration_error": 0.01},
    "bad-calibration": {"calibration_error": 0.03},
}
"""Fields of `Corruptions` that each named corruption sets."""


def corruptions(*names: str) -> Corruptions:
    """Combine named corruptions (CORRUPTIONS); where two set the same fault, the later one counts.

    Raises: InputError with the list of names for an unknown name.
    """
    changed: dict[str, Any] = {}
    for name in names:
        if name not in CORRUPTIONS:
            raise InputError(f"There is no corruption {name!r}; the corruptions are {', '.join(CORRUPTIONS)}.")
        changed |= CORRUPTIONS[name]
    return Corruptions(**changed)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], cell: float) -> NDArray[np.float32]:
    """Draw a picture of smooth random noise of standard deviation 0.8.

    rng: random numbers.
    shape: (h, w).
    cell: size of its waves, px.
    Returns: (h, w) float32.
    """
    h, w = shape
    s = max(1, round(cell))
    coarse = rng.normal(size=(h // s + 3, w // s + 3)).astype(np.float32)
    fine = cv2.resize(coarse, ((w // s + 3) * s, (h // s + 3) * s), interpolation=cv2.INTER_CUBIC)
    return np.asarray(fine[:h, :w], dtype=np.float32)


def box_mesh(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[Array, NDArray[np.int32]]:
    """Make a mesh of an axis-aligned box with corners low and high, m.

    Returns: vertices (8, 3) m, and faces (12, 3), counter-clockwise seen from outside.
    """
    x, y, z = zip(low, high, strict=True)
    v = np.array([[a, b, c] for a in x for b in y for c in z], dtype=np.float64)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    f = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return v, np.array(f, dtype=np.int32)


def joined_meshes(parts: Sequence[tuple[Array, NDArray[np.int32]]]) -> tuple[Array, NDArray[np.int32]]:
    """Join meshes, each of vertices (V, 3) and faces (F, 3), into one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = np.concatenate([f + n for n, (_, f) in zip(first, parts, strict=True)])
    return np.concatenate([v for v, _ in parts]), faces.astype(np.int32)


# turn about the vertical (degrees), and boxes (lowest and highest corner, m) of each occluder
_OCCLUDERS = {
    "table": (
        218.0 - 270.0,
        (
            ((-0.8, -1.9, 0.71), (0.8, -1.2, 0.75)),
            *(((x, y, 0.0), (x + 0.05, y + 0.05, 0.71)) for x in (-0.78, 0.73) for y in (-1.88, -1.27)),
            ((-0.75, -1.86, 0.3), (0.75, -1.83, 0.71)),  # its front board hides most
        ),
    ),
    "treadmill": (
        0.0,
        (
            *(((x, -0.75, 0.96), (x + 0.05, 0.35, 1.01)) for x in (-0.58, 0.53)),
            *(((x, y, 0.0), (x + 0.05, y + 0.05, 0.96)) for x in (-0.58, 0.53) for y in (-0.75, 0.3)),
            ((-0.58, -0.8, 1.0), (0.58, -0.75, 1.2)),
        ),
    ),
}


def occluder_mesh(name: str) -> tuple[Array, NDArray[np.int32]] | None:
    """Make the mesh of an occluder in the world.

    name: "" for none. "table": 1.6 x 0.7 m, 0.75 m high, 1.55 m from the centre of the volume, before the cameras near
        azimuth 218 degrees (all rigs but court-4 have one there). "treadmill": two hand rails with posts, 0.55 m left
        and right of the centre, 1.0 m high, and a console bar in front (for people who stay at the centre).
    Returns: vertices (V, 3) m and faces (F, 3); None for "".
    Raises: InputError for an unknown name.
    """
    if name == "":
        return None
    if name not in _OCCLUDERS:
        raise InputError(f"There is no occluder {name!r}; the occluders are {' and '.join(_OCCLUDERS)}.")
    turn, boxes = _OCCLUDERS[name]
    vertices, faces = joined_meshes([box_mesh(low, high) for low, high in boxes])
    return vertices @ so3_exp([0.0, 0.0, np.radians(turn)]).T, faces


def disturb_rig(rig: CameraRig, relative: float, rng: np.random.Generator) -> CameraRig:
    """Disturb the calibration of a rig as a careless calibration would.

    relative: sd; for 0.01 focal lengths change by 1 %, camera positions by 1 % of the distance to the centre of the
        volume per axis, and the image of that centre by 1 % of half the image width.
    Returns: the disturbed rig; image size and lens distortion stay.
    """
    if relative <= 0:
        return rig
    out = []
    target = np.array([0.0, 0.0, 0.95])
    for c in rig.cameras:
        k = c.K.copy()
        k[0, 0] *= 1 + rng.normal(0, relative)
        k[1, 1] = k[0, 0] * c.K[1, 1] / c.K[0, 0]
        r, p = c.camera_from_world[:3, :3], c.position
        new = p + rng.normal(0, relative * np.linalg.norm(target - p), 3)
        # turn it so that the centre stays in sight, up to the aiming error
        aim = rotation_between(r @ (target - new), r @ (target - p))
        wobble = np.append(rng.normal(0, relative * 0.5 * c.size[0] / c.K[0, 0], 2), 0.0)
        r = so3_exp(wobble) @ aim @ r
        out.append(replace(c, K=k, camera_from_world=se3(r, -r @ new)))
    return CameraRig(tuple(out))


def dropped_frames(n_frames: int, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw the frames that a camera does not deliver: single frames and short runs, never the first frame.

    n_frames: number T of frames.
    share: share of the frames that is missing.
    Returns: (T,) True where there is no image.
    """
    out = np.zeros(n_frames, dtype=bool)
    t = 1
    while share > 0 and t < n_frames:
        if rng.random() < share / 1.5:
            length = 1 if rng.random() < 0.67 else 2
            out[t : t + length] = True
            t += length
        t += 1
    return out


# ---- simulated key points --------------------------------------------------------------------------------------------
# 2D key points of a synthetic scene, as a detector would give them.


def surface_landmarks(subject: SyntheticSubject) -> dict[str, tuple[int, Array]]:
    """Compute the positions of nose, eyes, ears, toes and heels on a subject.

    Returns: by name, the joint that carries it and the point (3,) m in the model frame at rest.
    """
    v, j, part = subject.vertices, subject.joints, subject.main_joint
    out: dict[str, tuple[int, Array]] = {}
    head = v[part == 4] if (part == 4).any() else j[4:5] + [[0, -0.1, 0.08], [0, 0.1, 0.08], [0, 0, 0.2]]
    low, high = head.min(0), head.max(0)
    size = high - low
    face = j[4] * [1, 0, 0] + [0, low[1], low[2] + 0.48 * size[2]]
    out["nose"] = (4, face)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out[f"{side}_eye"] = (4, face + [sign * 0.2 * size[0], 0.09 * size[1], 0.12 * size[2]])
        out[f"{side}_ear"] = (4, face + [sign * 0.47 * size[0], 0.5 * size[1], 0.05 * size[2]])
        k = 15 if side == "left" else 18
        foot = v[part == k] if (part == k).any() else j[k] + np.array([[0, -0.18, -0.08], [0, 0.06, -0.08]])
        ground = foot[:, 2].min() + 0.02
        front, back, middle = foot[:, 1].min(), foot[:, 1].max(), float(foot[:, 0].mean())
        out[f"{side}_big_toe"] = (k, np.array([middle - sign * 0.02, front + 0.02, ground]))
        out[f"{side}_small_toe"] = (k, np.array([middle + sign * 0.03, front + 0.05, ground]))
        out[f"{side}_heel"] = (k, np.array([middle, back - 0.01, ground]))
    return out


def keypoint_places(subject: SyntheticSubject, rotations: Array, joints: Array) -> Array:
    """Compute the positions (T, 25, 3) m of the points of BODY_25 on a subject.

    rotations: (T, 19, 3, 3) world_from_joint.
    joints: (T, 19, 3) m.
    """
    marks = surface_landmarks(subject)
    world = np.zeros((len(joints), len(BODY_25), 3))
    for k, name in enumerate(BODY_25):
        if name in ("neck", "mid_hip"):
            a, b = (6, 10) if name == "neck" else (13, 16)
            world[:, k] = (joints[:, a] + joints[:, b]) / 2
        elif name in marks:
            j, point = marks[name]
            world[:, k] = joints[:, j] + rotations[:, j] @ (point - subject.joints[j])
        else:
            world[:, k] = joints[:, JOINT_NAMES.index(name)]
    return world


# ---- cameras and scenes --------------------------------------------------------------------------------------------
RIG_NAMES = ("humaneva-4", "humaneva-7", "ixmas-5", "court-4", "ring-N")
DISTORTION = np.array([-0.18, 0.06, 0.0008, -0.0006, 0.0])
"""Distortion of a common wide lens: barrel distortion of about 20 px in the corners of a 640x480 image."""
_HEIGHTS = (1.6, 2.0, 1.3, 1.8, 1.5, 1.9, 1.4, 2.2)
# First arguments of `circle` for the cameras of a rig that stand on a circle.
_CIRCLES = {
    "humaneva-4": ((35, 145, 215, 325), 4.1, _HEIGHTS[:4], 600, (640, 480)),
    "humaneva-7": ((35, 145, 215, 325, 5, 120, 245), 4.1, _HEIGHTS[:7], 600, (640, 480)),
    "ixmas-5": ((20, 70, 150, 225), 3.8, (2.0, 2.5, 1.8, 2.3), 340, (390, 291)),
    "court-4": ((40, 140, 220, 320), 13.5, (5.0, 5.0, 5.0, 5.0), 640, (640, 480)),
}


def look_at(
    name: str,
    position: ArrayLike,
    target: ArrayLike,
    focal_px: float,
    size: tuple[int, int],
    distortion: Array | None = None,
) -> Camera:
    """Make an upright camera at `position` (3,) m that looks at `target` (3,) m.

    name: name of the camera.
    focal_px: focal length, px.
    size: (width, height), px.
    distortion: (5,) distortion of the lens, or None.
    """
    c, t = np.asarray(position, dtype=np.float64), np.asarray(target, dtype=np.float64)
    upwards = abs(unit(t - c)[2]) < 0.999
    forward, up, right = frame_of(t - c, [0.0, 0.0, 1.0] if upwards else [0.0, 1.0, 0.0]).T
    r = np.stack([right, -up, forward])
    k = np.array([[focal_px, 0, (size[0] - 1) / 2], [0, focal_px, (size[1] - 1) / 2], [0, 0, 1.0]])
    return Camera(name, k, np.zeros(5) if distortion is None else distortion, se3(r, -r @ c), size)


def circle(
    azimuths_deg: Sequence[float],
    radius: float,
    heights: Sequence[float],
    focal_px: float,
    size: tuple[int, int],
    target: ArrayLike = (0.0, 0.0, 0.95),
    distortion: Array | None = None,
    name: str = "cam",
) -> list[Camera]:
    """Make cameras (name)1, (name)2, ... on a circle of `radius` m about the z axis that look at `target` (3,) m.

    azimuths_deg, heights: degrees and m, of each camera.
    focal_px: focal length, px.
    size: (width, height), px.
    distortion: (5,) distortion of the lens, or None.
    """
    return [
        look_at(
            f"{name}{k + 1}",
            [radius * np.cos(np.radians(a)), radius * np.sin(np.radians(a)), h],
            target,
            focal_px,
            size,
            distortion,
        )
        for k, (a, h) in enumerate(zip(azimuths_deg, heights, strict=True))
    ]


def camera_rig(name: str, *, distorted: bool = False) -> CameraRig:
    """Make a rig of cameras by name: humaneva-4, humaneva-7, ixmas-5, court-4, or ring-N with N from 1 to 16.

    name: humaneva-*: 640x480, indoor corners, 4.1 m away, the person about 270 px tall. ixmas-5: 390x291, four cameras
        high on the walls and one overhead. court-4: 640x480, 14 m away in the court's corners 5 m up, the person about
        80 px tall.
    distorted: whether lenses have the distortion DISTORTION; else they are ideal pinholes.
    Returns: the rig, centred at the world's origin; every camera sees the whole of a person within about 1 m of it
        (court-4: 3 m).
    Raises: InputError for an unknown name.
    """
    d = DISTORTION if distorted else None
    ring = re.fullmatch(r"ring-(\d+)", name)
    n = int(ring[1]) if ring else 0
    if name in _CIRCLES:
        cameras = circle(*_CIRCLES[name], distortion=d)
    elif 1 <= n <= 16:
        heights = [_HEIGHTS[k % 8] for k in range(n)]
        cameras = circle([20 + 360 * k / n for k in range(n)], 4.1, heights, 600, (640, 480), distortion=d)
    else:
        raise InputError(
            f"There is no camera rig {name!r}; the rigs are {', '.join(RIG_NAMES)} (N = 1 to 16 cameras in a ring)."
        )
    if name == "ixmas-5":
        cameras.append(look_at("cam5", (0.25, 0.45, 4.9), (0.0, 0.0, 0.9), 330, (390, 291), d))
    return CameraRig(tuple(cameras))


# first numbers of the random streams: (seed, stream, ...)
_CLOTHES, _MOTION, _ROOM, _RIG, _DROPS, _MASKS, _NOISE, _PHASE, _OTHER = range(9)


@dataclass(frozen=True)
class Scene(OfPerformance):
    """Synthetic recording of colour cameras with known truth.

    name: name of the scene.
    subject: true body of the person (dressed).
    performance: motion of the person.
    rig: the true cameras.
    given_rig: the calibration that the user has.
    corruption: faults of the recording.
    seed: seed of all random numbers.
    others: further people in view (subject, performance) that are not to be tracked.
    sensor: properties of the cameras.
    hands_only: whether the clothes leave only face and hands bare, and none has the colour of skin.
    """

    name: str
    subject: SyntheticSubject
    performance: Performance
    rig: CameraRig
    given_rig: CameraRig
    corruption: Corruptions
    seed: int
    others: tuple[tuple[SyntheticSubject, Performance], ...] = ()
    sensor: Sensor = field(default_factory=Sensor)
    hands_only: bool = False

    def delivered(self, view: int, index: int) -> int:
        """Return `index`, or where the camera drops that frame, the last one before that it does not drop."""
        while index > 0 and self._dropped[view, index]:
            index -= 1
        return index

    def shown(self, view: int, index: int) -> int:
        """Return the frame that camera `view` shows as its frame `index`.

        The frame is earlier than `index` by the camera's delay (Corruptions.desync); in place of a dropped frame, it
        is the last one delivered before.
        """
        return max(0, self.delivered(view, index) - self.corruption.desync[view % len(self.corruption.desync)])

    def dead(self, view: int, index: int) -> bool:
        """Return whether the camera's images are black at frame `index`."""
        return view == self.corruption.dead_camera and index >= len(self) // 3

    @property
    def people(self) -> tuple[tuple[SyntheticSubject, Performance], ...]:
        """The tracked subject and the others in view, each with the motion."""
        return (self.subject, self.performance), *self.others

    def skins(self, index: int) -> Iterator[tuple[SyntheticSubject, Array]]:
        """Yield all people with their vertices (V, 3) m in frame `index`; a shorter motion stays at its last frame."""
        for subject, p in self.people:
            k = min(index, len(p) - 1)
            yield subject, subject.skin(p.rotations[k], p.root[k])

    def clean_mask(self, view: int, index: int, scale: float = 1.0) -> Mask:
        """Render the mask (h, w) 0/1 of the subject alone in frame `index` of camera `view`, without faults.

        It is undistorted, at `scale` times the camera's size, and cut only by the occluder.
        """
        return self._mask(view, self.subject, self.vertices(index), scale)

    def mask(self, view: int, index: int, scale: float = 1.0) -> Mask:
        """Render the mask (h, w) 0/1 of all people in the picture that camera `view` shows as its frame `index`.

        It is undistorted, at `scale` times the camera's size, and cut by the occluder.
        """
        masks = [self._mask(view, body, skin, scale) for body, skin in self.skins(self.shown(view, index))]
        return np.bitwise_or.reduce(masks)

    def mask_frames(self, scale: float = 1.0, *, keypoints: bool = False) -> Iterator[Frame]:
        """Yield frames with the silhouettes of all people (`mask`).

        scale: size of the masks relative to the cameras' pictures.
        keypoints: whether to add noisy 2D key points (`keypoint_detections`).
        Views without an image (dropped, dead) are marked unusable with the reason.
        """
        given = self.given_rig.pinhole().scaled(scale)
        w, h = given.sizes.max(0)
        points = [keypoint_detections(self, c) for c in range(len(given))] if keypoints else []
        for t in range(len(self)):
            masks = np.zeros((len(given), h, w), np.uint8)
            reasons = [""] * len(given)
            for c in range(len(given)):
                if self.dead(c, t) or self._dropped[c, t]:
                    reasons[c] = "black image" if self.dead(c, t) else "no frame"
                    continue
                mask = self.mask(c, t, scale)
                masks[c, : mask.shape[0], : mask.shape[1]] = mask
                reasons[c] = "" if mask.any() else "empty mask"
            found = to_keypoints([p[t] for p in points], BODY_25, self.given_rig, given) if keypoints else None
            usable = np.array([not r for r in reasons])
            yield Frame(float(self.times[t]), t, Silhouettes(masks, given, usable, tuple(reasons)), found)

    def occluder_depth(self, view: int, scale: float) -> NDArray[np.float32] | None:
        """Render the depth of the occluder.

        view: index of the camera.
        scale: size of the picture relative to the camera's.
        Returns: (h, w) m, infinite elsewhere; None without an occluder.
        """
        mesh = occluder_mesh(self.corruption.occluder)
        if mesh is None:
            return None
        camera = self.rig.pinhole().scaled(scale)[view]
        return rasterize(camera.project_pinhole(mesh[0]), camera.depths(mesh[0]), mesh[1], camera.size)[0]

    def _mask(self, view: int, subject: SyntheticSubject, vertices: Array, scale: float) -> Mask:
        """Render the mask of one body, cut by the occluder.

        view: index of the camera.
        subject, vertices: the body, and its vertices (V, 3) m, world.
        scale: size of the mask relative to the camera's picture.
        """
        camera, hidden = self.rig.pinhole().scaled(scale)[view], self.occluder_depth(view, scale)
        uv, z = camera.project_pinhole(vertices), camera.depths(vertices)
        if hidden is None:
            return covered(uv, z, subject.faces, camera.size[::-1])
        return (rasterize(uv, z, subject.faces, camera.size)[0] < hidden).astype(np.uint8)

    def rgb_frames(self, view: int) -> Iterator[Image]:
        """Yield the T pictures (h, w, 3) uint8 BGR of camera `view`, with its lens distortion."""
        for t in range(len(self)):
            yield self.rgb_frame(view, t)

    def rgb_frame(self, view: int, index: int) -> Image:
        """Render picture `index` of camera `view`: black from a dead camera, the last delivered one where a frame is
        dropped.
        """
        camera = self.rig[view]
        if self.dead(view, index):
            return np.zeros((camera.size[1], camera.size[0], 3), np.uint8)
        index = self.delivered(view, index)
        backdrop, s = self._backdrops[view], self.shown(view, index)
        picture = backdrop.image.copy()
        skins = list(self.skins(s))
        away = [np.linalg.norm(p.root[min(s, len(p) - 1)] - camera.position) for _, p in self.people]
        for k in np.argsort(-np.array(away), kind="stable"):  # the farthest first
            subject, vertices = skins[k]
            render_person(picture, backdrop, camera, subject, self._outfits[k], vertices, self.sensor.samples)
        return self._develop(picture, view, float(self.times[s]), index + 1)

    def background_frames(self, view: int, n: int = 25) -> list[Image]:
        """Render n pictures of the empty room, taken during the 10 s before the recording; a dead camera delivers them
        too.
        """
        return [self.room_frame(view, -11.0 + 10.0 * k / max(n - 1, 1), -1 - k) for k in range(n)]

    def room_frame(
        self, view: int, time: float, index: int, paint: Callable[[NDArray[np.float32]], None] | None = None
    ) -> Image:
        """Render a picture of the room without people.

        view: index of the camera.
        time: s, which determines the light.
        index: negative number that determines the noise.
        paint: draws something into the picture (h, w, 3) before the noise, or None.
        """
        picture = self._backdrops[view].image.copy()
        if paint is not None:
            paint(picture)
        return self._develop(picture, view, time, index)

    def _develop(self, picture: NDArray[np.float32], view: int, time: float, index: int) -> Image:
        """Add light and noise to a picture.

        picture: (h, w, 3) without noise.
        view: index of the camera.
        time: s, which determines the light.
        index: number that determines the noise; negative without people.
        """
        phase = np.random.default_rng([self.seed, _PHASE, view]).uniform(0, 2 * np.pi, 5)
        rng = np.random.default_rng([self.seed, _NOISE, view, 2 * abs(index) + (index < 0)])
        return develop(picture, light_at(time, self.sensor.drift, phase), self._noise, rng)

    @cached_property
    def _dropped(self) -> NDArray[np.bool_]:
        rngs = [np.random.default_rng([self.seed, _DROPS, c]) for c in range(len(self.rig))]
        return np.stack([dropped_frames(len(self), self.corruption.dropped, r) for r in rngs])

    @cached_property
    def _backdrops(self) -> list[Backdrop]:
        reach = float(np.abs(self.rig.positions[:, :2]).max())
        room = make_room(np.random.default_rng([self.seed, _ROOM]), max(reach, 3.0))
        occluder = occluder_mesh(self.corruption.occluder)
        return [render_room(room, camera, occluder) for camera in self.rig]

    @cached_property
    def _outfits(self) -> list[Outfit]:
        return [
            make_outfit(s, np.random.default_rng([self.seed, _CLOTHES, 1, k]), self.hands_only)
            for k, (s, _) in enumerate(self.people)
        ]

    @cached_property
    def _noise(self) -> NDArray[np.int16]:
        size = self.rig.sizes.max(0)
        rng = np.random.default_rng([self.seed, _NOISE])
        return noise_bank((int(size[0]), int(size[1])), self.sensor.noise_sd, rng)


def keypoint_detections(scene: Scene, view: int, noise_px: float = 4.0) -> Array:
    """Simulate BODY_25 detections of the subject in one camera's own (distorted) images.

    scene: the filmed scene.
    view: index of the camera.
    noise_px: sd of the noise at a person 250 px tall; it grows with the person's size.
    Returns: (T, 25, 3) = (u px, v px, confidence), 0 where missing.

    The noise is half white, half slow, because detectors make similar errors in neighbouring frames. 2 % of the points
    are off by ten times the noise, with low confidence; 2 % are missing. Systematic offsets of detectors and left-right
    swaps are not simulated.
    """
    p, camera = scene.performance, scene.rig[view]
    t = np.array([scene.shown(view, k) for k in range(len(scene))])
    world = keypoint_places(scene.subject, p.rotations[t], p.joints[t])
    uv = camera.project(world)
    rng = np.random.default_rng([scene.seed, 100, view])
    height = np.nanmax(uv[..., 1], axis=1) - np.nanmin(uv[..., 1], axis=1)
    sd = noise_px * height[:, None] / 250.0
    knots = rng.normal(size=(len(t) // 8 + 3, len(BODY_25), 2))
    at = np.arange(len(t)) / 8
    low = at.astype(int)
    s = (at - low)[:, None, None]
    slow = ((1 - s) * knots[low] + s * knots[low + 1]) / np.sqrt((1 - s) ** 2 + s**2)
    white = rng.normal(size=uv.shape)
    wild = rng.random(uv.shape[:2]) < 0.02
    error = (slow + white) / np.sqrt(2) * np.where(wild, 10.0, 1.0)[..., None]
    points = uv + sd[..., None] * error
    confidence = np.clip(rng.normal(0.8, 0.08, uv.shape[:2]) - 0.45 * wild, 0.05, 1.0)
    w, h = camera.size
    inside = np.isfinite(points).all(-1) & (points >= 0).all(-1) & (points < [w, h]).all(-1)
    dead = np.array([scene.dead(view, k) for k in range(len(scene))])
    seen = inside & (rng.random(uv.shape[:2]) > 0.02) & ~dead[:, None]
    return np.where(seen[..., None], np.concatenate([points, confidence[..., None]], -1), 0.0)


def make_scene(
    motion: str | Performance = "walk",
    subject: str | SyntheticSubject = "",
    rig: str | CameraRig = "humaneva-4",
    *,
    seconds: float = 4.0,
    frame_rate: float = 25.0,
    seed: int = 0,
    corruption: Corruptions | tuple[str, ...] = (),
    clothing_m: float = 0.02,
    distorted: bool = False,
    amplitude: float = 1.0,
    speed: float = 1.0,
) -> Scene:
    """Make a scene by names.

    motion: a name of motions.MOTIONS, or a Performance of that subject.
    subject: a name of `load_subjects` ("": chosen by the seed), or a SyntheticSubject.
    rig: a name (`camera_rig`) or a rig; "court-4" adds a second person.
    seconds, frame_rate: s and Hz.
    seed: seed of all random numbers.
    corruption: Corruptions, or names of them.
    clothing_m: thickness of the clothes, 0 to 0.04 m.
    distorted: whether lenses have distortion.
    amplitude, speed: factors of the size and speed of the movement.
    Raises: InputError for an unknown name.
    """
    known = {} if isinstance(subject, SyntheticSubject) else load_subjects()
    if isinstance(subject, str) and subject and subject not in known:
        raise InputError(f"There is no subject {subject!r}; the subjects are {', '.join(known)}.")
    body = subject if isinstance(subject, SyntheticSubject) else known[subject or sorted(known)[seed % len(known)]]
    if clothing_m > 0 and body.clothing_m == 0:
        body = dress(body, clothing_m, np.random.default_rng([seed, _CLOTHES]))
    performance = motion
    if isinstance(performance, str):
        rng = np.random.default_rng([seed, _MOTION])
        performance = act(performance, body, seconds, frame_rate, rng, amplitude, speed)
    cameras = camera_rig(rig, distorted=distorted) if isinstance(rig, str) else rig
    what = corruption if isinstance(corruption, Corruptions) else corruptions(*corruption)
    given = disturb_rig(cameras, what.calibration_error, np.random.default_rng([seed, _RIG]))
    others: tuple[tuple[SyntheticSubject, Performance], ...] = ()
    if rig == "court-4":
        second = known[sorted(known)[(seed + 1) % len(known)]] if known else body
        rng = np.random.default_rng([seed, _OTHER])
        p = act("walk", second, seconds, frame_rate, rng)
        others = ((second, moved(p, float(rng.uniform(0, 6.28)), (2.6, 1.8))),)
    name = f"{performance.name}-{body.name}-{rig if isinstance(rig, str) else len(cameras)}-{seed}"
    return Scene(name, body, performance, cameras, given, what, seed, others)
