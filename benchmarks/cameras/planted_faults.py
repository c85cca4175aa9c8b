"""Planted faults: synthetic recordings with one known fault each, and healthy ones, for the calibration doctor.

The same scenes serve twice, once as they are and once with a fault in the calibration, the files, the key points or the
timing. Limits of the doctor were chosen on seeds below 100; benchmarks use seeds from 1000 on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.calibration.diagnose_person import Finding
from hypose.calibration.diagnostics import Observed, ViewFile, examine
from hypose.cameras.camera import Camera, CameraRig
from hypose.evidence.frame import Silhouettes
from hypose.evidence.keypoints import BODY_25, other_sides
from hypose.evidence.one_person import one_person
from hypose.geometry import Array, se3, so3_exp
from hypose.synthetic.performance import moved
from hypose.synthetic.scenes import Scene, keypoint_detections, make_scene

FIRST_SEED = 1000
_LEAD = 6  # frames before the recording, so that a late camera has something to show
_FRAMES = 64
_MOTIONS = ("walk", "box", "wave", "walk", "punch", "combo", "jog")
_RIGS = ("humaneva-4", "ring-5", "humaneva-4", "ring-6", "ring-3")


@dataclass(frozen=True)
class Planted:
    """A recording and what is wrong with it. kinds: findings that name the fault, views: the cameras concerned (any of
    them has to be named; () = no camera in particular). Healthy: no kinds."""

    name: str
    observed: Observed
    kinds: tuple[str, ...] = ()
    views: tuple[str, ...] = ()


def healthy(seed: int, *, late: Sequence[int] = (0,), keypoints: bool = True) -> Planted:
    """A recording without a fault: scene, rig, noise and small errors of calibration by the seed. late: frames by which
    the cameras are late, in turn."""
    rng = np.random.default_rng([seed, 77])
    motion, rig = _MOTIONS[seed % len(_MOTIONS)], _RIGS[int(rng.integers(len(_RIGS)))]
    scene = noisy_scene(
        motion,
        rig=rig,
        seconds=(_FRAMES + _LEAD + 1) / 25.0,
        seed=seed,
        distorted=bool(rng.random() < 0.7),
    )
    what = replace(scene.corruption, desync=tuple(late), calibration_error=0.0)
    scene = replace(scene, corruption=what, given_rig=_slightly_off(scene.rig, rng))
    noise = float(rng.uniform(2.5, 5.0))
    return Planted(f"healthy-{motion}-{rig}-{seed}", observe(scene, noise if keypoints else None))


def observe(scene: Scene, noise_px: float | None, scale: float = 0.5) -> Observed:
    """What the doctor sees of a scene. noise_px of the key points at a person 250 px tall, None: without key points."""
    rows = range(_LEAD, min(_LEAD + _FRAMES, len(scene)))
    masks = []
    for t, frame in enumerate(scene.mask_frames(scale)):
        if t in rows:
            masks.append(frame.silhouettes)
        if t >= rows[-1]:
            break
    points = np.zeros((len(scene.rig), 0, 0, 3))
    if noise_px is not None:
        points = np.stack(
            [keypoint_detections(scene, c, noise_px)[rows[0] : rows[-1] + 1] for c in range(len(scene.rig))]
        )
    clips = tuple(ViewFile(c.size, scene.frame_rate, len(rows)) for c in scene.given_rig)
    return Observed(scene.given_rig, points, BODY_25, masks, clips, scene.frame_rate)


def _slightly_off(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """A good calibration: 0.05 degrees, 3 mm and 0.1 % of the focal length (1 sd)."""
    return CameraRig(tuple(_moved(c, np.radians(0.05), 0.003, rng, 0.001) for c in rig))


def _moved(camera: Camera, turn: float, move: float, rng: np.random.Generator, focal: float = 0.0) -> Camera:
    """The camera turned and moved about itself by normal noise."""
    r = so3_exp(rng.normal(0, turn, 3)) @ camera.camera_from_world[:3, :3]
    p = camera.position + rng.normal(0, move, 3)
    k = camera.K.copy()
    k[:2, :2] *= 1 + rng.normal(0, focal) if focal else 1.0
    return replace(camera, K=k, camera_from_world=se3(r, -r @ p))


# ---- faults ------------------------------------------------------------------------------------------------

Fault = Callable[[Observed, int, np.random.Generator], Planted]


def _camera(o: Observed, c: int, camera: Camera) -> Observed:
    cameras = list(o.rig)
    cameras[c] = camera
    return replace(o, rig=CameraRig(tuple(cameras)), silhouettes=_same_pixels(o, CameraRig(tuple(cameras))))


def _same_pixels(o: Observed, rig: CameraRig) -> list[Silhouettes | None]:
    """The masks as they are undistorted with another rig's lenses; the poses are the other rig's."""
    maps = [_between(a, b, s) for a, b, s in zip(o.rig, rig, _small(o), strict=True)] if o.silhouettes else []
    out: list[Silhouettes | None] = []
    for s in o.silhouettes:
        if s is None:
            out.append(None)
            continue
        small = CameraRig(tuple(b.scaled(k.size).pinhole() for b, k in zip(rig, s.rig, strict=True)))
        masks = s.masks
        if any(m is not None for m in maps):
            masks = masks.copy()
            for c, m in enumerate(maps):
                if m is not None:
                    w, h = s.rig[c].size
                    masks[c, :h, :w] = cv2.remap(s.masks[c, :h, :w], *m, cv2.INTER_NEAREST)
        out.append(replace(s, masks=masks, rig=small))
    return out


def _small(o: Observed) -> CameraRig:
    return next(s.rig for s in o.silhouettes if s is not None)


def _between(true: Camera, given: Camera, small: Camera) -> tuple[np.ndarray, np.ndarray] | None:
    """Maps from the image undistorted by the given lens to that undistorted by the true lens."""
    if np.array_equal(true.distortion, given.distortion):
        return None
    w, h = small.size
    y, x = np.mgrid[:h, :w].astype(np.float64)
    ratio = np.array(given.size) / np.array(small.size)
    at = (np.stack([x, y], -1) + 0.5) * ratio - 0.5
    rays = np.concatenate([(at - given.K[:2, 2]) / given.K[[0, 1], [0, 1]], np.ones((h, w, 1))], -1)
    seen = replace(given, camera_from_world=np.eye(4)).project(rays)
    back = (true.undistort_points(seen) + 0.5) / ratio - 0.5
    return back[..., 0].astype(np.float32), back[..., 1].astype(np.float32)


def _clip(o: Observed, c: int, clip: ViewFile) -> Observed:
    clips = list(o.clips)
    clips[c] = clip
    return replace(o, clips=tuple(clips))


def _points(o: Observed, c: int, xy: Array, order: ArrayLike | None = None) -> Observed:
    points = o.keypoints.copy()
    points[c, ..., :2] = np.where(points[c, ..., 2:] > 0, xy, 0.0)
    if order is not None:
        points[c] = points[c][:, order]
    return replace(o, keypoints=points)


def _masks(o: Observed, c: int, change: Callable[[np.ndarray], np.ndarray]) -> Observed:
    """The masks (h, w) of one view changed."""
    w, h = _small(o)[c].size
    out: list[Silhouettes | None] = []
    for s in o.silhouettes:
        if s is not None:
            masks = s.masks.copy()
            masks[c, :h, :w] = change(masks[c, :h, :w])
            s = replace(s, masks=masks)
        out.append(s)
    return replace(o, silhouettes=out)


def _size(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    w, h = o.rig[c].size
    f = float(rng.choice([0.5, 0.75, 2 / 3]))
    return Planted(
        "size", _clip(o, c, replace(o.clips[c], size=(round(w * f), round(h * f)))), ("size",), (o.rig.names[c],)
    )


def _scaled(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    f = float(rng.choice([0.5, 0.75, 2.0]))
    made = _points(o, c, (o.keypoints[c, ..., :2] + 0.5) * f - 0.5)
    if rng.random() < 0.5:
        w, h = o.rig[c].size
        made = _clip(made, c, replace(o.clips[c], size=(round(w * f), round(h * f))))
    return Planted("scaled", made, ("scaled", "size"), (o.rig.names[c],))


def _cropped(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    w, h = o.rig[c].size
    cut = round(float(rng.uniform(0.1, 0.2)) * w)
    left = int(rng.choice([0, cut // 2, cut]))
    made = _points(o, c, o.keypoints[c, ..., :2] - np.array([left, 0.0]))
    made = _clip(made, c, replace(o.clips[c], size=(w - cut, h)))
    # the masks are those of the cut image, stretched to the calibrated size by the loader
    small = _small(o)[c].size
    a = np.array([[w / (w - cut), 0, -left * small[0] / (w - cut)], [0, 1, 0]])
    made = _masks(made, c, lambda m: cv2.warpAffine(m, a, small, flags=cv2.INTER_NEAREST))
    return Planted("cropped", made, ("cropped", "size"), (o.rig.names[c],))


def _frame_rate(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    rate = float(rng.choice([24.0, 30.0, 50.0]))
    return Planted("frame_rate", _clip(o, c, replace(o.clips[c], frame_rate=rate)), ("frame_rate",), (o.rig.names[c],))


def _frame_count(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    frames = len(o.silhouettes) - int(rng.integers(5, 20))
    return Planted("frame_count", _clip(o, c, replace(o.clips[c], frames=frames)), ("frame_count",), (o.rig.names[c],))


def _keypoint_lag(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    lag = int(rng.choice([-2, -1, 1, 2, 3]))
    points = np.zeros_like(o.keypoints)
    n = points.shape[1]
    points[:, max(0, -lag) : n - max(0, lag)] = o.keypoints[:, max(0, lag) : n - max(0, -lag)]
    return Planted("keypoint_lag", replace(o, keypoints=points), ("keypoint_lag",), ())


def _keypoint_shift(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(5, 12)
    shift = size * np.array([np.cos(angle), 0.6 * np.sin(angle)])
    # the images are shifted, the key points agree with the calibration
    small = _small(o)[c].size
    move = -shift * np.array(small) / np.array(o.rig[c].size)
    a = np.array([[1, 0, move[0]], [0, 1, move[1]]])
    made = _masks(o, c, lambda m: np.asarray(cv2.warpAffine(m * 255, a, small, flags=cv2.INTER_LINEAR)) > 127)
    return Planted("keypoint_shift", made, ("keypoint_shift",), (o.rig.names[c],))


def _extrinsics(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    camera = o.rig[c]
    axis = rng.normal(size=3)
    turn = so3_exp(axis / np.linalg.norm(axis) * np.radians(rng.uniform(1.0, 3.0)))
    r = turn @ camera.camera_from_world[:3, :3]
    p = camera.position + rng.normal(0, 0.03, 3)
    made = _camera(o, c, replace(camera, camera_from_world=se3(r, -r @ p)))
    return Planted("extrinsics", made, ("extrinsics",), (camera.name,))


def _swapped(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    d = int((c + rng.integers(1, len(o.rig))) % len(o.rig))
    cameras = list(o.rig)
    a, b = o.rig[c], o.rig[d]
    cameras[c] = replace(b, name=a.name)
    cameras[d] = replace(a, name=b.name)
    rig = CameraRig(tuple(cameras))
    return Planted("swapped", replace(o, rig=rig, silhouettes=_same_pixels(o, rig)), ("swapped",), (a.name, b.name))


def _unit(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    f = float(rng.choice([1000.0, 0.001, 10.0, 0.1, 3.2808]))
    cameras = []
    for k in o.rig:
        pose = k.camera_from_world.copy()
        pose[:3, 3] *= f
        cameras.append(replace(k, camera_from_world=pose))
    rig = CameraRig(tuple(cameras))
    return Planted("unit", replace(o, rig=rig, silhouettes=_same_pixels(o, rig)), ("unit",), ())


def _mirrored(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    w, _ = o.rig[c].size
    xy = np.array([w - 1.0, 0]) + np.array([-1.0, 1.0]) * o.keypoints[c, ..., :2]
    return _flipped(o, c, "mirrored", xy, other_sides(o.names), 1)


def _turned(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    xy = np.array(o.rig[c].size) - 1.0 - o.keypoints[c, ..., :2]
    return _flipped(o, c, "turned", xy, None, -1)


def _flipped(o: Observed, c: int, kind: str, xy: Array, order: ArrayLike | None, code: int) -> Planted:
    made = o if not o.keypoints.size else _points(o, c, xy, order)
    return Planted(kind, _masks(made, c, lambda m: cv2.flip(m, code)), (kind,), (o.rig.names[c],))


def _distortion(o: Observed, c: int, rng: np.random.Generator) -> Planted:
    """Of all cameras; a rig without distortion gets coefficients that are 64 times too large for its lenses."""
    way = int(rng.integers(3))
    cameras = []
    for k in o.rig:
        bent = k.distortion if np.abs(k.distortion).max() > 0 else np.array([-0.18, 0.06, 0.0008, -0.0006, 0.0])
        cameras.append(replace(k, distortion=(64 * bent, -bent, -2 * bent)[way]))
    rig = CameraRig(tuple(cameras))
    return Planted("distortion", replace(o, rig=rig, silhouettes=_same_pixels(o, rig)), ("distortion",), ())


FAULTS: dict[str, Fault] = {
    "size": _size,
    "scaled": _scaled,
    "cropped": _cropped,
    "frame_rate": _frame_rate,
    "frame_count": _frame_count,
    "keypoint_lag": _keypoint_lag,
    "keypoint_shift": _keypoint_shift,
    "extrinsics": _extrinsics,
    "swapped": _swapped,
    "unit": _unit,
    "mirrored": _mirrored,
    "turned": _turned,
    "distortion": _distortion,
}
"""The faults that are planted into a healthy recording; "late" (a camera out of step) is made with the scene."""
_MASK_FAULTS = ("late", "extrinsics", "swapped", "unit", "mirrored", "turned", "size", "frame_rate")


def planted(base: Planted, kind: str, seed: int) -> Planted:
    """A healthy recording with one fault of a kind, camera and size by the seed."""
    rng = np.random.default_rng([seed, 78])
    o = base.observed
    c = int(rng.integers(len(o.rig)))
    if kind == "late":
        late = [0] * len(o.rig)
        late[c] = int(rng.integers(1, 6))
        made = healthy(seed, late=late, keypoints=o.keypoints.size > 0)
        return Planted("late", made.observed, ("late",), (o.rig.names[c],))
    return FAULTS[kind](o, c, rng)


def with_bystander(fault: Planted, seed: int) -> Planted:
    """The same recording with somebody else walking 1.2 m aside, in all views or, by the seed, in one; the doctor is
    given the person whom `hypose.evidence.one_person` finds among both. The same fault is planted into what the
    detector says of the other one; the masks show the person alone, as they do once others are cut off."""
    o = fault.observed
    rng = np.random.default_rng([seed, 79])
    names, own = o.rig.names, o.keypoints
    base = healthy(seed)
    theirs = _of_bystander(base.observed.rig, seed, own.shape[1])
    other = Planted("other", replace(base.observed, keypoints=theirs))
    if fault.kinds and fault.name != "late":
        other = planted(other, fault.name, seed)
    points = other.observed.keypoints
    assert points is not None
    shown = range(len(names)) if rng.random() < 0.6 else [int(rng.integers(len(names)))]
    small = o.rig.pinhole()
    candidates: list[list[Array | None]] = []
    for t in range(own.shape[1]):
        frame: list[Array | None] = []
        for c, camera in enumerate(o.rig):
            people = np.stack([own[c, t], points[c, t]] if c in shown else [own[c, t]])
            uv = camera.undistort_points(people[..., :2])
            confidence = np.where(np.isfinite(uv).all(-1), people[..., 2], 0.0)
            found = np.concatenate([np.nan_to_num(uv), confidence[..., None], people[..., :2]], -1)
            frame.append(found[rng.permutation(len(found))])
        candidates.append(frame)
    one = one_person(candidates, o.names, small, o.frame_rate, keep_misfits=True)
    raw = one.points[..., [3, 4, 2]].transpose(1, 0, 2, 3)
    return replace(fault, observed=replace(o, keypoints=raw, people=one.notes))


def _of_bystander(rig: CameraRig, seed: int, frames: int) -> Array:
    """(C, T, K, 3) px of the calibrated pictures."""
    motion = _MOTIONS[(seed + 3) % len(_MOTIONS)]
    scene = make_scene(motion, rig="ring-4", seconds=(frames + 1) / 25.0, seed=seed + 5000)
    scene = replace(scene, rig=rig, given_rig=rig, performance=moved(scene.performance, shift=(0.9, -0.8)))
    return np.stack([keypoint_detections(scene, c, 4.0)[:frames] for c in range(len(rig))])


def judged(fault: Planted, findings: Sequence[Finding]) -> tuple[bool, int]:
    """Whether the fault was found (kind and camera), and how many findings are wrong."""
    right = [
        f
        for f in findings
        if f.kind in fault.kinds and (not fault.views or not f.views or set(f.views) & set(fault.views))
    ]
    wrong = [f for f in findings if f not in right and f.fault]
    return bool(right), len(wrong)


def doctor(options: BenchOptions) -> BenchReport:
    """Verdicts on planted faults and healthy recordings: precision = right findings / all findings, recall = faults
    found with their kind and camera / faults planted. Cases: all (key points and masks), silhouettes (masks alone)."""
    seeds = options.seed_range(50, quick=6, first=FIRST_SEED)
    rows: list[Row] = []
    for case, count in (("all", len(seeds)), ("silhouettes", max(len(seeds) // 3, 3))):
        kinds = ("late", *FAULTS) if case == "all" else _MASK_FAULTS
        wrong, clean, found = 0, list[bool](), dict[str, list[bool]]()
        for k in range(count):
            options.progress(case, k, count)
            base = healthy(seeds.start + k, keypoints=case == "all")
            faulty = planted(base, kinds[k % len(kinds)], seeds.start + k)
            _, false = judged(base, examine(base.observed)[0].findings)
            right, more = judged(faulty, examine(faulty.observed)[0].findings)
            wrong += false + more
            clean.append(false == 0)
            found.setdefault(faulty.name, []).append(right)
        every = [x for some in found.values() for x in some]
        rows += [
            Row("verdict_precision", case, sum(every) / max(sum(every) + wrong, 1), "1", n=2 * count),
            Row("verdict_recall", case, float(np.mean(every)), "1", n=count),
            Row("healthy_without_finding", case, float(np.mean(clean)), "1", n=count),
        ]
        rows += [Row("recall", f"{case}, {k}", float(np.mean(v)), "1", n=len(v)) for k, v in sorted(found.items())]
    return BenchReport(tuple(rows), {"first_seed": seeds.start, "frames": _FRAMES})
