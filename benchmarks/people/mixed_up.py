"""`bench mixed-up`: a person tracked from key points in which people, views or sides are mixed up, four ways.

What is wrong is done to the detections as a program would write them, before the person is chosen. Masks show the
person alone (level-1 corrupted). Nothing is given: body and start are found in the clip.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.action_scenes import subject_of_seed
from benchmarks.multiview.product import aligned_joints
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.cameras.camera import Camera, CameraRig
from hypose.evidence.frame import Frame, Keypoints
from hypose.evidence.keypoints import BODY_25
from hypose.evidence.one_person import one_person
from hypose.geometry import Array
from hypose.pipeline.run import track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED
from hypose.synthetic.performance import moved
from hypose.synthetic.scenes import Scene, keypoint_detections, make_scene

FIRST_SEED = 3000
_SECONDS = 3.0
_MOTIONS = ("walk", "box", "combo")
_TWIN = [
    BODY_25.index(n.replace("left_", "right_") if n.startswith("left_") else n.replace("right_", "left_"))
    for n in BODY_25
]
Candidates = list[list[list[Array]]]
"""Per frame and view the people, (25, 3) px each."""


def mixed_up(options: BenchOptions) -> BenchReport:
    """Rows max_mm, mean_mm (DEGRADATION/EVIDENCE: largest over the frames, and mean, of a frame's mean error over 15
    joints), beyond_130 and said (EVIDENCE: runs beyond 130 mm, and the share of them whose worst frame is doubted or
    lost, or in which it is said that somebody is left out)."""
    seeds = options.seed_range(3, first=FIRST_SEED)
    ways = dict(list(WAYS.items())[:1]) if options.quick else WAYS
    rows: list[Row] = []
    parts = [
        options.part(f"{seed}", lambda s=seed, k=k: _measured(s, ways, options, k, len(seeds)))
        for k, seed in enumerate(seeds)
    ]
    for way in ways:
        for evidence in ("keypoints", "both"):
            of = [p[f"{way}/{evidence}"] for p in parts]
            rows.append(row("max_mm", f"{way}/{evidence}", [o["max"] for o in of], "mm"))
            rows.append(row("mean_mm", f"{way}/{evidence}", [o["mean"] for o in of], "mm"))
    for evidence in ("keypoints", "both"):
        every = [o for p in parts for name, o in p.items() if name.endswith(f"/{evidence}")]
        beyond = [o for o in every if o["max"] > 130]
        rows.append(Row("beyond_130", evidence, float(len(beyond)), "runs", n=len(every)))
        rows.append(
            Row("said", evidence, float(np.mean([o["said"] for o in beyond])) if beyond else 1.0, "1", n=len(beyond))
        )
    return BenchReport(tuple(rows), {"first_seed": seeds.start, "seconds": _SECONDS, "rig": "humaneva-4"})


def _measured(
    seed: int, ways: Mapping[str, Callable[..., Candidates]], options: BenchOptions, done: int, of: int
) -> dict[str, Any]:
    scene, other = _scenes(seed)
    frames = list(scene.mask_frames(1.0, keypoints=True))
    small = next(f.keypoints.rig for f in frames if f.keypoints is not None)
    out: dict[str, Any] = {}
    for n, (way, spoil) in enumerate(ways.items()):
        options.progress(way, done * len(ways) + n, of * len(ways))
        rng = np.random.default_rng([seed, n])
        found = one_person(undistorted(spoil(scene, other, rng), scene.given_rig, small), BODY_25, small, 25.0)
        given = [replace(f, keypoints=Keypoints(found.points[t], BODY_25, small)) for t, f in enumerate(frames)]
        for evidence in ("keypoints", "both"):
            out[f"{way}/{evidence}"] = _tracked(scene, given, evidence, seed, bool(found.notes))
    return out


def _tracked(scene: Scene, frames: list[Frame], evidence: str, seed: int, noted: bool) -> dict[str, Any]:
    used = [replace(f, silhouettes=None) for f in frames] if evidence == "keypoints" else frames
    result = track_source(FrameList(used), 25.0, TrackOptions(seed=seed, evidence=evidence))
    motion = result.motion
    error = np.linalg.norm(aligned_joints(motion, scene) - scene.joints[: len(motion)], axis=-1)[:, EVALUATED]
    by_frame = 1e3 * error.mean(1)
    worst = int(by_frame.argmax())
    doubted = any(
        x is not None and bool(np.any(x[worst])) for x in (motion.low_confidence, motion.low_confidence_joints)
    )
    return {
        "max": float(by_frame.max()),
        "mean": float(by_frame.mean()),
        "said": noted or doubted or bool(motion.lost[worst]),
    }


def _scenes(seed: int) -> tuple[Scene, Scene]:
    """The person, and somebody else in the same room, 1.1 m aside."""
    motion, rig = _MOTIONS[seed % len(_MOTIONS)], "humaneva-4"
    scene = noisy_scene(motion, subject_of_seed(seed), rig, seconds=_SECONDS, seed=seed)
    other = make_scene("wave", subject_of_seed(seed + 3), rig, seconds=_SECONDS, seed=seed + 500)
    return scene, replace(other, performance=moved(other.performance, shift=(1.0, -0.5)))


def detections(scene: Scene) -> Candidates:
    """What a detector finds of the scene's person alone."""
    views = [keypoint_detections(scene, c) for c in range(len(scene.rig))]
    return [[[v[t]] for v in views] for t in range(len(scene))]


def undistorted(candidates: Candidates, rig: CameraRig, small: CameraRig) -> list[list[Array | None]]:
    """Detections (25, 3) px of the cameras as people (P, 25, 3) in undistorted px of the small ones."""
    out: list[list[Array | None]] = []
    for frame in candidates:
        row_: list[Array | None] = []
        for people, camera, into in zip(frame, rig, small, strict=True):
            row_.append(np.stack([_into(p, camera, into) for p in people]) if people else None)
        out.append(row_)
    return out


def _into(points: Array, camera: Camera, small: Camera) -> Array:
    uv = (camera.undistort_points(points[:, :2]) + 0.5) * (np.array(small.size) / camera.size) - 0.5
    return np.where(points[:, 2:] > 0, np.concatenate([uv, points[:, 2:]], 1), 0.0)


# ---- what is mixed up ---------------------------------------------------------------------------------------


def _sides_exchanged(scene: Scene, other: Scene, rng: np.random.Generator) -> Candidates:
    """Left and right exchanged in one view in 30 % of the frames."""
    found, view = detections(scene), int(rng.integers(len(scene.rig)))
    for frame in found:
        if rng.random() < 0.3:
            frame[view] = [p[_TWIN] for p in frame[view]]
    return found


def _two_exchanged(scene: Scene, other: Scene, rng: np.random.Generator) -> Candidates:
    found = detections(scene)
    a, b = (int(i) for i in rng.permutation(len(scene.rig))[:2])
    for frame in found:
        frame[a], frame[b] = frame[b], frame[a]
    return found


def _bystander(scene: Scene, other: Scene, rng: np.random.Generator) -> Candidates:
    """Another person in one view; in 40 % of the frames the person is not detected there."""
    found, view = detections(scene), int(rng.integers(len(scene.rig)))
    for frame, theirs in zip(found, detections(other), strict=True):
        frame[view] = [*theirs[view], *([] if rng.random() < 0.4 else frame[view])]
    return found


def _mirror(scene: Scene, other: Scene, rng: np.random.Generator) -> Candidates:
    """The person's picture in a mirror on the wall, in two views: a reflected body, its sides exchanged."""
    found, p = detections(scene), scene.performance
    wall = scene.joints.mean((0, 1))[1] + 1.2
    across, far = np.array([1.0, -1.0, 1.0]), np.array([0.0, 2 * wall, 0.0])
    behind = replace(
        p, joints=p.joints * across + far, root=p.root * across + far, rotations=np.diag(across) @ p.rotations
    )
    theirs = detections(replace(scene, performance=behind, seed=scene.seed + 900))
    for frame, mirrored in zip(found, theirs, strict=True):
        for c in range(2):
            frame[c] = [mirrored[c][0][_TWIN], *frame[c]]
    return found


WAYS: Mapping[str, Callable[..., Candidates]] = {
    "sides exchanged, 30 %": _sides_exchanged,
    "two cameras exchanged": _two_exchanged,
    "bystander instead, 40 %": _bystander,
    "mirror in two views": _mirror,
}
"""Four ways, in one view each where nothing else is said."""
