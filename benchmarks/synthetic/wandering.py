"""A person who walks about before cameras that start at different times: key points as a detector gives them, and the
truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.synthetic.spoilt_keypoints import like_a_detector
from hypose.cameras.camera import CameraRig
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import Array, se3, so3_exp
from hypose.synthetic.motions import act
from hypose.synthetic.performance import Performance, centred, chain
from hypose.synthetic.scenes import DISTORTION, keypoint_places, look_at
from hypose.synthetic.subjects import SyntheticSubject, dress, load_subjects

RATE = 30.0
_MARGIN = 2.0  # s of motion before the first and after the last frame


@dataclass(frozen=True)
class WanderingSettings:
    """cameras: how many; spread_deg: of the arc on which they stand; motion: wander, circle, or one of `act`; seconds;
    largest: offset between cameras, frames; noise_px, bias_px: sd of a detection's error, and of its constant part;
    size: of the pictures, px; distorted: wide lenses; centre_px: sd of the principal point from the picture's middle.
    """

    cameras: int = 4
    spread_deg: float = 360.0
    motion: str = "wander"
    seconds: float = 20.0
    largest: float = 30.0
    noise_px: float = 5.0
    bias_px: float = 2.5
    size: tuple[int, int] = (1280, 720)
    distorted: bool = False
    centre_px: float = 0.0


@dataclass(frozen=True)
class Wandering:
    """points (C, T, 25, 3) px of the pictures and confidence; rig: the true cameras; late (C,) frames by which each is
    late; height m."""

    points: Array
    rig: CameraRig
    late: Array
    height: float


def wandering(seed: int, settings: WanderingSettings) -> Wandering:
    """Make a clip in which a person walks about."""
    rng = np.random.default_rng([77, seed])
    subjects = load_subjects()
    subject = dress(subjects[sorted(subjects)[seed % len(subjects)]], 0.02, rng)
    seconds = settings.seconds + 2 * (_MARGIN + max(settings.largest / RATE - 1, 0))
    if settings.motion == "wander":
        performance = wander(subject, seconds, rng)
    elif settings.motion == "circle":
        performance = act("walk", subject, seconds, RATE, rng, radius=rng.uniform(0.8, 1.3))
    else:
        performance = act(settings.motion, subject, seconds, RATE, rng)
    world = keypoint_places(subject, performance.rotations, performance.joints)
    spline = CubicSpline(np.arange(len(world)) / RATE, world, axis=0)
    rig = _rig(rng, settings)
    late = np.r_[0.0, rng.uniform(-settings.largest, settings.largest, len(rig) - 1)]
    late = np.clip(late - np.median(late), -settings.largest, settings.largest)
    middle = (seconds - settings.seconds) / 2
    clean = []
    for camera, x in zip(rig, late, strict=True):  # frame t of a late camera shows an earlier moment
        uv = camera.project(spline(middle + (np.arange(int(settings.seconds * RATE)) - x) / RATE))
        seen = np.isfinite(uv).all(-1) & np.all((uv >= 0) & (uv < camera.size), axis=-1)
        clean.append(np.concatenate([np.nan_to_num(uv), 0.8 * np.asarray(seen)[..., None]], -1))
    points = like_a_detector(np.stack(clean, 1), BODY_25, rng, RATE, settings.noise_px)
    bias = rng.normal(size=(1, len(rig), 25, 2)) * settings.bias_px
    points[..., :2] += np.where(points[..., 2:] > 0, bias, 0.0)
    return Wandering(np.ascontiguousarray(points.transpose(1, 0, 2, 3)), rig, late, subject.stature)


def _rig(rng: np.random.Generator, settings: WanderingSettings) -> CameraRig:
    """Cameras at 3.5 to 6 m that show a person of 1.8 m in 50 to 68 % of the picture's height."""
    n, (width, height) = settings.cameras, settings.size
    arc = settings.spread_deg
    azimuth = np.linspace(0, arc, n, endpoint=arc < 360) + rng.uniform(-0.35, 0.35, n) * arc / n + rng.uniform(0, 360)
    out = []
    for k, angle in enumerate(np.radians(azimuth)):
        away = rng.uniform(3.5, 6.0)
        focal = rng.uniform(0.5, 0.68) * height * away / 1.8
        place = [away * np.cos(angle), away * np.sin(angle), rng.uniform(1.0, 2.6)]
        target = [rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(0.8, 1.0)]
        lens = DISTORTION if settings.distorted else None
        camera = look_at(f"cam{k + 1}", place, target, focal, (width, height), lens)
        roll = se3(so3_exp([0, 0, np.radians(rng.normal(0, 1.5))]), np.zeros(3))
        k_matrix = camera.K.copy()
        if settings.centre_px:
            k_matrix[:2, 2] += rng.normal(size=2) * settings.centre_px
        out.append(replace(camera, K=k_matrix, camera_from_world=roll @ camera.camera_from_world))
    return CameraRig(tuple(out))


def wander(subject: SyntheticSubject, seconds: float, rng: np.random.Generator) -> Performance:
    """Turns to the left and right with gestures between them; of five draws the one that stays most in the middle."""
    best = None
    n = int(seconds * RATE)
    for _ in range(5):
        parts, total = [], 0.0
        while total < seconds + 2:
            if rng.random() < 0.2:
                length = rng.uniform(1.5, 3.0)
                part = act(str(rng.choice(["wave", "box"])), subject, length, RATE, rng)
            else:
                length = rng.uniform(1.2, 3.0)
                radius = rng.uniform(0.5, 1.6) * rng.choice([-1, 1])
                pace = {"amplitude": rng.uniform(0.7, 1.05), "speed": rng.uniform(0.7, 1.15)}
                part = act("walk", subject, length, RATE, rng, radius=radius, **pace)
            parts.append(part)
            total += length - 0.5
        whole = chain("wander", parts, subject)
        if len(whole) < n:
            continue
        ground = whole.root[:n, :2]
        reach = np.linalg.norm(ground - (ground.max(0) + ground.min(0)) / 2, axis=1).max()
        if best is None or reach < best[0]:
            best = reach, whole
    assert best is not None
    p = best[1]
    return centred(Performance("wander", p.times[:n], p.rotations[:n], p.root[:n], p.joints[:n]))
