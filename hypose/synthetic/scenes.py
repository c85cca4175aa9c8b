"""Scene: a subject that moves in front of a rig, with exact truth and the evidence that cameras would give of
it.

Truth: times, joints (T, 19, 3), rotations (T, 19, 3, 3), vertices on demand. Evidence: `mask_frames`
(silhouettes straight from the truth, corrupted) or `rgb_frames` (colour pictures for the real background
model). The same seed gives the same scene, picture for picture, in whatever order they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera, CameraRig
from hypose.compute import covered, rasterize
from hypose.errors import InputError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.keypoints import BODY_25, to_keypoints
from hypose.geometry import Array, Image
from hypose.synthetic.corruptions import (
    Corruptions,
    corrupt_mask,
    corruptions,
    disturb_rig,
    dropped_frames,
    occluder_mesh,
)
from hypose.synthetic.motions import act
from hypose.synthetic.performance import OfPerformance, Performance, moved
from hypose.synthetic.render_rgb import (
    Backdrop,
    Outfit,
    Room,
    Sensor,
    develop,
    light_at,
    make_outfit,
    make_room,
    noise_bank,
    render_person,
    render_room,
    shadow_mask,
)
from hypose.synthetic.rigs import rig as named_rig
from hypose.synthetic.simulated_keypoints import keypoint_detections
from hypose.synthetic.subjects import SyntheticSubject, dress, load_subjects

# first numbers of the random streams: (seed, stream, ...)
_CLOTHES, _MOTION, _ROOM, _RIG, _DROPS, _MASKS, _NOISE, _PHASE, _OTHER = range(9)


@dataclass(frozen=True)
class Scene(OfPerformance):
    """subject: the truth body (dressed). performance: what it does. rig: the cameras as they are, given_rig:
    the calibration that the user has. corruption: what goes wrong. seed: of everything random. others:
    further people in view (subject, performance) that are not to be tracked. hands_only: the clothes leave only face
    and hands bare, and none has the colour of skin."""

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

    def vertices(self, index: int) -> Array:
        """(V, 3) m: the subject's skin (and clothes) in frame `index`."""
        p = self.performance
        return self.subject.skin(p.rotations[index], p.root[index])

    def shown(self, view: int, index: int) -> int:
        """The frame that camera `view` shows as its frame `index`: late by its desynchronisation, the last
        one delivered before a dropped one."""
        while index > 0 and self._dropped[view, index]:
            index -= 1
        return max(0, index - self.corruption.desync[view % len(self.corruption.desync)])

    def dead(self, view: int, index: int) -> bool:
        """True when the camera's images are black."""
        return view == self.corruption.dead_camera and index >= len(self) // 3

    def clean_mask(self, view: int, index: int, scale: float = 1.0) -> NDArray[np.uint8]:
        """(h, w) 0/1: the subject alone in frame `index` through camera `view`, undistorted, at `scale` times
        its size; cut by what stands in front, by nothing else."""
        camera = self.rig.pinhole().scaled(scale)[view]
        return _mask(camera, self.subject, self.vertices(index), self._occluder_depth(view, scale))

    def mask_frames(self, scale: float = 1.0, *, keypoints: bool = False) -> Iterator[Frame]:
        """Frames with silhouettes straight from the truth, corrupted, undistorted, at `scale` times the
        cameras' size.

        Views without an image (dropped, dead) are marked unusable with the reason. keypoints: with noisy 2D key points
        (detections.keypoint_detections) beside the masks.
        """
        given = self.given_rig.pinhole().scaled(scale)
        cameras = self.rig.pinhole().scaled(scale)
        w, h = cameras.sizes.max(0)
        points = [keypoint_detections(self, c) for c in range(len(cameras))] if keypoints else []
        for t in range(len(self)):
            masks = np.zeros((len(cameras), h, w), np.uint8)
            usable, reasons = np.ones(len(cameras), bool), [""] * len(cameras)
            for c, camera in enumerate(cameras):
                if self.dead(c, t) or self._dropped[c, t]:
                    usable[c] = False
                    reasons[c] = "black image" if self.dead(c, t) else "no frame"
                    continue
                mask = self._corrupted(c, t, camera, scale)
                masks[c, : mask.shape[0], : mask.shape[1]] = mask
                if not mask.any():
                    usable[c], reasons[c] = False, "empty mask"
            found = None
            if keypoints:
                found = to_keypoints([p[t] for p in points], BODY_25, self.given_rig, given)
            yield Frame(float(self.times[t]), t, Silhouettes(masks, given, usable, tuple(reasons)), found)

    def _corrupted(self, view: int, index: int, camera: Camera, scale: float) -> NDArray[np.uint8]:
        s = self.shown(view, index)
        hidden = self._occluder_depth(view, scale)
        mask = shadow = np.zeros((camera.size[1], camera.size[0]), np.uint8)
        for subject, p in ((self.subject, self.performance), *self.others):
            k = min(s, len(p) - 1)
            v = subject.skin(p.rotations[k], p.root[k])
            mask = mask | _mask(camera, subject, v, hidden)
            if self.corruption.shadow > 0:
                shadow = shadow | shadow_mask(camera, subject.faces, v)
        if hidden is not None:
            shadow = shadow * ~np.isfinite(hidden)
        rng = np.random.default_rng([self.seed, _MASKS, view, index])
        return corrupt_mask(mask, shadow.astype(np.uint8) & (1 - mask), self.corruption, rng, scale)

    def rgb_frames(self, view: int) -> Iterator[Image]:
        """The T pictures (h, w, 3) uint8 BGR of camera `view`, with its lens distortion."""
        for t in range(len(self)):
            yield self.rgb_frame(view, t)

    def rgb_frame(self, view: int, index: int) -> Image:
        """Picture `index` of camera `view`; black from a dead camera, the last delivered one where a frame is
        dropped."""
        camera = self.rig[view]
        if self.dead(view, index):
            return np.zeros((camera.size[1], camera.size[0], 3), np.uint8)
        while index > 0 and self._dropped[view, index]:
            index -= 1
        backdrop, s = self._backdrop(view), self.shown(view, index)
        picture = backdrop.image.copy()
        people = []
        for k, (subject, p) in enumerate(((self.subject, self.performance), *self.others)):
            t = min(s, len(p) - 1)
            distance = float(np.linalg.norm(p.root[t] - camera.position))
            people.append((-distance, k, subject, subject.skin(p.rotations[t], p.root[t])))
        for _, k, subject, vertices in sorted(people, key=lambda x: x[:2]):  # the farthest first
            render_person(picture, backdrop, camera, subject, self._outfits[k], vertices, self.sensor.samples)
        return self._develop(picture, view, float(self.times[s]), index + 1)

    def background_frames(self, view: int, n: int = 25) -> list[Image]:
        """n pictures of the empty room, taken during the 10 s before the recording; black ones from no
        camera."""
        return [self.room_frame(view, -11.0 + 10.0 * k / max(n - 1, 1), -1 - k) for k in range(n)]

    def room_frame(
        self, view: int, time: float, index: int, paint: Callable[[NDArray[np.float32]], None] | None = None
    ) -> Image:
        """A picture of the room without people, in the light of `time` (s); index: of its noise, negative. paint: puts
        something into the picture (h, w, 3)."""
        picture = self._backdrop(view).image.copy()
        if paint is not None:
            paint(picture)
        return self._develop(picture, view, time, index)

    def _develop(self, picture: NDArray[np.float32], view: int, time: float, index: int) -> Image:
        phase = np.random.default_rng([self.seed, _PHASE, view]).uniform(0, 2 * np.pi, 5)
        rng = np.random.default_rng([self.seed, _NOISE, view, 2 * abs(index) + (index < 0)])
        return develop(picture, light_at(time, self.sensor.drift, phase), self._noise, rng)

    @cached_property
    def _dropped(self) -> NDArray[np.bool_]:
        rngs = [np.random.default_rng([self.seed, _DROPS, c]) for c in range(len(self.rig))]
        return np.stack([dropped_frames(len(self), self.corruption.dropped, r) for r in rngs])

    @cached_property
    def _room(self) -> Room:
        reach = float(np.abs(self.rig.positions[:, :2]).max())
        return make_room(np.random.default_rng([self.seed, _ROOM]), max(reach, 3.0))

    def _backdrop(self, view: int) -> Backdrop:
        if view not in self._backdrops:
            mesh = occluder_mesh(self.corruption.occluder)
            self._backdrops[view] = render_room(self._room, self.rig[view], mesh)
        return self._backdrops[view]

    @cached_property
    def _backdrops(self) -> dict[int, Backdrop]:
        return {}

    @cached_property
    def _outfits(self) -> list[Outfit]:
        people = [self.subject, *(s for s, _ in self.others)]
        return [
            make_outfit(s, np.random.default_rng([self.seed, _CLOTHES, 1, k]), self.hands_only)
            for k, s in enumerate(people)
        ]

    @cached_property
    def _noise(self) -> NDArray[np.int16]:
        size = self.rig.sizes.max(0)
        rng = np.random.default_rng([self.seed, _NOISE])
        return noise_bank((int(size[0]), int(size[1])), self.sensor.noise_sd, rng)

    @cached_property
    def _occluder_depths(self) -> dict[tuple[int, float], NDArray[np.float32]]:
        return {}

    def _occluder_depth(self, view: int, scale: float) -> NDArray[np.float32] | None:
        mesh = occluder_mesh(self.corruption.occluder)
        if mesh is None:
            return None
        known = self._occluder_depths
        if (view, scale) not in known:
            camera = self.rig.pinhole().scaled(scale)[view]
            known[view, scale] = rasterize(*_projected(camera, mesh[0]), mesh[1], camera.size)[0]
        return known[view, scale]


def _projected(camera: Camera, vertices: Array) -> tuple[Array, Array]:
    z = vertices @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    return camera.project_pinhole(vertices), z


def _mask(
    camera: Camera, subject: SyntheticSubject, vertices: Array, hidden: NDArray[np.float32] | None
) -> NDArray[np.uint8]:
    uv, z = _projected(camera, vertices)
    if hidden is None:
        return covered(uv, z, subject.faces, (camera.size[1], camera.size[0]))
    depth = rasterize(uv, z, subject.faces, camera.size)[0]
    return (depth < hidden).astype(np.uint8)


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
    """A scene by names.

    motion: a name of motions.MOTIONS, or a Performance of that subject; subject: a name of `load_subjects`
    ("": chosen by the seed) or a Subject, dressed in clothing_m (0 to 0.04); rig: a name (rigs.rig) or a rig;
    corruption: Corruptions or names of them. `court-4` puts a second person into view.
    """
    known = {} if isinstance(subject, SyntheticSubject) else load_subjects()
    if isinstance(subject, SyntheticSubject):
        body = subject
    elif subject in known:
        body = known[subject]
    elif subject == "":
        body = known[sorted(known)[seed % len(known)]]
    else:
        raise InputError(f"There is no subject {subject!r}; the subjects are {', '.join(known)}.")
    if clothing_m > 0 and body.clothing_m == 0:
        body = dress(body, clothing_m, np.random.default_rng([seed, _CLOTHES]))
    if isinstance(motion, Performance):
        performance = motion
    else:
        rng = np.random.default_rng([seed, _MOTION])
        performance = act(motion, body, seconds, frame_rate, rng, amplitude, speed)
    cameras = named_rig(rig, distorted=distorted) if isinstance(rig, str) else rig
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
