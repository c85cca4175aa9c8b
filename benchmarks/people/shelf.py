"""The Shelf recording (Belagiannis et al. 2014) from the detections that the 4D Association's authors published: four
people, five cameras, 301 frames. Percentage of correct parts in 3D, people that were missed counted as wrong.

--data is the `data` folder of their repository (github.com/zhangyux15/4d_association), which is theirs to give away:
shelf/calibration.json, shelf/detection/0.txt ..., shelf/gt.txt. Their detections are single points with affinities of
limbs; `parsed` makes people of them, view by view, as OpenPose does.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from hypose.cameras.camera import Camera, CameraRig
from hypose.evidence.association import Association, PersonTrack
from hypose.evidence.keypoints import BODY_25
from hypose.geometry import Array

# the authors' order of limbs, as pairs of BODY_25
_LIMBS = np.array(
    [
        [1, 9, 10, 8, 8, 12, 13, 1, 2, 3, 2, 1, 5, 6, 5, 1, 0, 0, 15, 16, 14, 19, 14, 11, 22, 11],
        [8, 10, 11, 9, 12, 13, 14, 2, 3, 4, 17, 5, 6, 7, 18, 0, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24],
    ]
)
# Shelf's 14 joints: right and left leg from the ankle up, right and left arm from the wrist up, then chin and head top
_JOINTS = [BODY_25.index(n) for n in (
    "right_ankle", "right_knee", "right_hip", "left_hip", "left_knee", "left_ankle",
    "right_wrist", "right_elbow", "right_shoulder", "left_shoulder", "left_elbow", "left_wrist",
)]  # fmt: skip
_PARTS = ((9, 10), (8, 7), (10, 11), (7, 6), (3, 4), (2, 1), (4, 5), (1, 0), (12, 13), (12, 14))
ACTORS = 4
_MET = 0.5  # m, mean over the joints, within which somebody found is an actor


def shelf(options: BenchOptions) -> BenchReport:
    """Rows pcp (actor 0 ... 3; all: mean of actors 0 to 2, as published), identity_swaps, ms_per_frame."""
    folder = options.folder("shelf")
    rig, truth = read_rig(folder), read_truth(folder)
    frames = candidates(folder, rig)
    if options.quick:
        frames, truth = frames[:60], truth[:60]
    association = Association(BODY_25, rig, 25.0)
    times = []
    for t, frame in enumerate(frames):
        options.progress("associate", t, len(frames))
        start = time.thread_time()
        association.step(frame)
        times.append(time.thread_time() - start)
    correct, swaps, surplus = judged(association.people(), truth)
    rows = [Row("pcp", f"actor {a}", 100 * float(c.mean()), "%", n=len(c)) for a, c in enumerate(correct) if len(c)]
    known = [float(c.mean()) for c in correct[:3] if len(c)]
    rows += [
        Row("pcp", "all", 100 * float(np.mean(known)), "%"),
        Row("identity_swaps", "all", float(swaps), "", n=len(truth)),
        Row("surplus", "all", surplus, "people per frame", n=len(truth)),
        Row("ms_per_frame", "5 views", 1e3 * float(np.mean(times)), "ms", float(np.std(times)) * 1e3, len(times)),
        Row("p95_ms", "5 views", 1e3 * float(np.percentile(times, 95)), "ms", n=len(times)),
    ]
    return BenchReport(tuple(rows), {"frames": len(frames), "views": len(rig)})


def read_rig(folder: Path) -> CameraRig:
    """The five cameras (pinhole)."""
    found = json.loads((folder / "calibration.json").read_text(encoding="utf-8"))
    cameras = []
    for name, c in sorted(found.items()):
        pose = np.vstack([np.array(c["RT"]).reshape(3, 4), [0, 0, 0, 1]])
        cameras.append(Camera(f"cam{name}", np.array(c["K"]).reshape(3, 3), np.zeros(5), pose, tuple(c["imgSize"])))
    return CameraRig(tuple(cameras))


def candidates(folder: Path, rig: CameraRig) -> list[list[Array | None]]:
    """Per frame and view the people, and what belongs to none of them point by point, (P, 25, 3) px."""
    views = [
        [parsed(points, limbs, camera.size) for points, limbs in _detections(folder / "detection" / f"{c}.txt")]
        for c, camera in enumerate(rig)
    ]
    return [list(frame) for frame in zip(*views, strict=True)]


def read_truth(folder: Path) -> list[dict[int, Array]]:
    """Per frame the actors' joints (15, 3) m, by their number."""
    values = iter((folder / "gt.txt").read_text().split())
    joints, frames = int(next(values)), int(next(values))
    out = []
    for _ in range(frames):
        people = {}
        for _ in range(int(next(values))):
            number = int(next(values))
            people[number] = np.array([float(next(values)) for _ in range(4 * joints)]).reshape(4, joints)[:3].T
        out.append(people)
    return out


def _detections(path: Path) -> Iterator[tuple[list[Array], list[Array]]]:
    """Per frame the points of each joint (n, 3), as shares of the picture, and the affinities of each limb (n, m)."""
    values = iter(path.read_text().split())
    next(values)
    for _ in range(int(next(values))):
        points = []
        for _ in BODY_25:
            n = int(next(values))
            points.append(np.array([float(next(values)) for _ in range(3 * n)]).reshape(3, n).T)
        limbs = []
        for a, b in _LIMBS.T:
            n, m = len(points[a]), len(points[b])
            limbs.append(np.array([float(next(values)) for _ in range(n * m)]).reshape(n, m))
        yield points, limbs


def parsed(points: list[Array], limbs: list[Array], size: tuple[int, int]) -> Array:
    """People (P, 25, 3) px of one picture, the strongest limbs first; points that no limb holds are one candidate
    each."""
    order = [
        (float(limbs[p][i, k]), p, i, k)
        for p in range(len(limbs))
        for i, k in zip(*np.nonzero(limbs[p] > 0), strict=True)
    ]
    people: list[dict[int, int]] = []
    of: dict[tuple[int, int], dict[int, int]] = {}
    for _, p, i, k in sorted(order, reverse=True):
        a, b = (int(j) for j in _LIMBS[:, p])
        one, other = of.get((a, i)), of.get((b, k))
        if one is None and other is None:
            new = {a: i, b: k}
            people.append(new)
            of[a, i] = of[b, k] = new
        elif one is None or other is None:
            person = one if one is not None else other
            joint, number = (b, k) if one is not None else (a, i)
            assert person is not None
            if joint not in person:
                person[joint] = number
                of[joint, number] = person
        elif one is not other and not set(one) & set(other):
            one.update(other)
            for joint, number in other.items():
                of[joint, number] = one
            people = [q for q in people if q is not other]
    people += [{j: i} for j, found in enumerate(points) for i in range(len(found)) if (j, i) not in of]
    out = np.zeros((len(people), len(BODY_25), 3))
    for n, person in enumerate(people):
        for joint, number in person.items():
            out[n, joint] = points[joint][number] * [*size, 1.0]
    return out


def shelf_joints(points: Array) -> Array:
    """BODY_25 in the world (25, 3) -> Shelf's 14 joints and the middle of the hips (15, 3) m. Its chin and head top
    have no key point of their own: chin halfway between shoulders and ears, the top 14.5 cm above, a little forward."""
    out = np.full((15, 3), np.nan)
    out[:12] = points[_JOINTS]
    neck = points[1]
    hips = points[8] if np.isfinite(points[8, 0]) else (points[9] + points[12]) / 2
    facing = np.cross(neck - hips, out[8] - out[9])
    facing /= np.linalg.norm(facing)
    ears = points[[17, 18]]
    ears = ears[np.isfinite(ears[:, 0])]
    head = ears.mean(0) if len(ears) else points[0]
    shoulders = (points[2] + points[5]) / 2
    out[12] = shoulders + (head - shoulders) * 0.5
    out[13] = out[12] + facing * 0.125 + np.array([0, 0, 0.145])
    out[14] = hips
    return out


def judged(people: list[PersonTrack], truth: list[dict[int, Array]]) -> tuple[list[Array], int, float]:
    """Per actor which parts are right (frames, 10), how often one is somebody else than before, and how many people per
    frame are no actor (not all who are there have truth in every frame)."""
    correct: list[list[Array]] = [[] for _ in range(ACTORS)]
    identity: list[list[int]] = [[] for _ in range(ACTORS)]
    surplus = 0
    points = [filled(p) for p in people]
    for t, actors in enumerate(truth):
        there = [i for i, p in enumerate(people) if p.first <= t <= p.last]
        joints = [shelf_joints(points[i][t - people[i].first]) for i in there]
        numbers = list(actors)
        met = {}
        if there and numbers:
            apart = np.array([[_apart(j, actors[a]) for a in numbers] for j in joints])
            for i, k in zip(*linear_sum_assignment(np.minimum(apart, 2.0)), strict=True):
                if apart[i, k] < _MET:
                    met[numbers[k]] = i
        surplus += len(there) - len(met)
        for a in numbers:
            if a not in met:
                correct[a].append(np.zeros(len(_PARTS)))
                continue
            found, true = joints[met[a]], actors[a]
            identity[a].append(there[met[a]])
            error = np.linalg.norm(found - true, axis=1)
            right = [float(error[i] + error[k] < np.linalg.norm(true[i] - true[k])) for i, k in _PARTS]
            correct[a].append(np.array(right))
    swaps = sum(int(np.count_nonzero(np.diff(i))) for i in identity)
    return [np.array(c) for c in correct], swaps, surplus / max(1, len(truth))


def _apart(found: Array, true: Array) -> float:
    d = np.linalg.norm(found[:12] - true[:12], axis=1)
    return float(np.nanmean(d)) if np.isfinite(d).any() else 9.0


def filled(person: PersonTrack) -> Array:
    """(T, K, 3) m: the person's points, those missing between frames where they are known in line between them."""
    out = person.world.copy()
    frames = np.arange(len(out))
    for k in range(out.shape[1]):
        known = np.flatnonzero(np.isfinite(out[:, k, 0]))
        if len(known):
            for axis in range(3):
                out[:, k, axis] = np.interp(frames, known, out[known, k, axis])
    return out
