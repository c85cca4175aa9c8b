"""Check whether the key points of several calibrated views can be of one person, and find out what was misread.

Normal errors of a detector and a calibration are some pixels; a wrong picture size, a wrong axis or exchanged sides
give errors as large as the person. Such misreadings are tried one by one, and one is reported only where it explains
the points far better.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hypose.cameras.camera import PARALLEL, CameraRig, triangulate, widest_angle
from hypose.geometry import Array, se3_inverse

_FRAMES = 24
_FINE = 0.06  # median distance from the other views' triangulation, in sizes of the person in that picture
_DOUBTFUL = 0.025  # disagreement from which misreadings are tried
_BETTER = 0.35  # largest share of the disagreement that a misreading may leave to be accepted
_NO_BODY = 0.3
_CONFIDENT = 0.2
# m, of an adult
_LENGTHS = (
    *(
        (f"{side}_{a}", f"{side}_{b}", length)
        for side in ("left", "right")
        for a, b, length in (
            ("shoulder", "elbow", 0.30),
            ("elbow", "wrist", 0.26),
            ("hip", "knee", 0.42),
            ("knee", "ankle", 0.42),
            ("shoulder", "hip", 0.52),
        )
    ),
    ("left_shoulder", "right_shoulder", 0.36),
    ("left_hip", "right_hip", 0.24),
    ("left_ear", "right_ear", 0.15),
)
_SCALES = (0.25, 1 / 3, 0.375, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 8 / 3, 3.0, 4.0)


def misread(people: Sequence[Sequence[Array | None]], names: Sequence[str], rig: CameraRig) -> str | None:
    """Find the misreading that explains why the views' key points contradict each other.

    rig: the calibrated cameras.
    people: per view and frame the people (P, K, 3), px of the calibrated, distorted cameras; None: no file.
    names: of the K points.
    Returns: a part of a sentence that names the error; None where nothing is wrong, or it cannot be known.
    """
    points = _one_person(people, len(names), len(rig))
    if points is None:
        return None
    plain = _residual(points, rig)
    found = _misread(points, plain, names, rig) if np.isfinite(plain) else None
    if found is None:
        return None
    left, wrong = found
    if _other_cameras(points, rig) < min(_FINE, _BETTER * plain, left):
        return None  # the calibration is wrong, which other checks report
    return wrong


def _misread(points: Array, plain: float, names: Sequence[str], rig: CameraRig) -> tuple[float, str] | None:
    """Find the misreading of one person's points (C, T, K, 3), whose views disagree by `plain`.

    Returns: the remaining disagreement, and a part of a sentence that names the error; None.
    """
    if plain > _DOUBTFUL:
        limit = min(_FINE, _BETTER * plain)
        found = min(((_residual(change(points), rig), what) for what, change in _readings(rig)), default=None)
        if found is not None and found[0] < limit:
            return found
        # one view alone?
        for c, name in enumerate(rig.names):
            others = np.delete(np.arange(len(rig)), c)
            if len(others) < 2 or not _residual(points[others], rig.select([rig.names[i] for i in others])) < _FINE:
                continue
            for what, change in _readings(rig):
                one = points.copy()
                one[c] = change(points)[c]
                left = _residual(one, rig)
                if left < limit:
                    return left, f"in view {name} {what}"
    world = _well_known(points, rig)
    if plain < 2 * _FINE and _disproportion(world, names) > _NO_BODY:
        return plain, "the bones between them have lengths that no body has, so the points must be in another order"
    mirrored = sides_exchanged(world, names)
    if mirrored and plain < 2 * _FINE:
        return plain, "the person is mirrored: y counts upwards, or left and right are exchanged in the names"
    return None


def _other_cameras(points: Array, rig: CameraRig) -> float:
    """Compute the least disagreement with two views exchanged, or with all camera poses inverted.

    points: (C, T, K, 3) px of the calibrated cameras and confidence; inf where nothing can be computed.
    """
    inverted = CameraRig(tuple(replace(c, camera_from_world=se3_inverse(c.camera_from_world)) for c in rig))
    found = [_residual(points, inverted)]
    for a, b in itertools.combinations(range(len(rig)), 2):
        order = np.arange(len(rig))
        order[[a, b]] = b, a
        found.append(_residual(points[order], rig))
    return min((f for f in found if np.isfinite(f)), default=float("inf"))


def _readings(rig: CameraRig) -> list[tuple[str, Callable[[Array], Array]]]:
    """List the misreadings that are tried: a part of a sentence, and a function that undoes the error in points (C, T,
    K, 3).

    rig: the calibrated cameras, whose picture sizes are used.
    """
    sizes = rig.sizes.astype(np.float64)[:, None, None]

    def moved(scale: tuple[float, float], offset: tuple[int, int]) -> Callable[[Array], Array]:
        def change(points: Array) -> Array:
            out = points.copy()
            out[..., :2] = (points[..., :2] + 0.5) * scale - 0.5 + np.array(offset) * (sizes - 1)
            out[..., :2] = np.where(points[..., 2:] > 0, out[..., :2], 0)
            return out

        return change

    found = [
        ("y counts upwards", moved((1, -1), (0, 1))),
        ("the pictures were mirrored", moved((-1, 1), (1, 0))),
        ("x and y are exchanged", lambda p: p[..., [1, 0, 2]]),
    ]
    for s in _SCALES:
        what = f"they are of pictures {1 / s:.3g} times the calibrated size"
        found.append((what, moved((s, s), (0, 0))))
    return found


def _one_person(people: Sequence[Sequence[Array | None]], count: int, views: int) -> Array | None:
    """Select frames (C, T, K, 3) in which two or more views see exactly one person; None when there are too few.

    people: per view and frame the people (P, K, 3), None where there are none; count: K; views: number of views.
    """
    frames = range(max((len(p) for p in people), default=0))
    single = [
        [None if p is None or p[t] is None or len(p[t]) != 1 else p[t][0] for p in people]  # type: ignore[index]
        for t in frames
    ]
    usable = [row for row in single if sum(p is not None and (p[:, 2] > _CONFIDENT).sum() >= 6 for p in row) >= 2]
    if len(usable) < 3:  # several people in all frames: the tallest, which is mostly the nearest, in all views
        usable = [[None if v is None or v[t] is None else _tallest(v[t]) for v in people] for t in frames]  # type: ignore[index, arg-type]
        usable = [row for row in usable if sum(p is not None for p in row) == views]
        if len(usable) < 3 or views < 3:
            return None
    chosen = [usable[i] for i in np.unique(np.linspace(0, len(usable) - 1, min(_FRAMES, len(usable))).astype(int))]
    return np.stack([np.stack([np.zeros((count, 3)) if p is None else p for p in row]) for row in chosen], 1)


def _tallest(people: Array) -> Array | None:
    """Select the points (K, 3) of the person (P, K, 3) who is tallest in the picture; None where nothing is seen."""
    seen = people[..., 2] > _CONFIDENT
    height = np.array([np.ptp(p[s, 1]) if s.sum() > 1 else 0.0 for p, s in zip(people, seen, strict=True)])
    return people[height.argmax()] if height.max(initial=0.0) > 0 else None


def _triangulated(points: Array, rig: CameraRig) -> tuple[Array, Array, Array]:
    """Triangulate points; return world points (T, K, 3), undistorted pixels (C, T * K, 2) and weights (C, T * K).

    points: (C, T, K, 3) px of the calibrated cameras and confidence; rig: the cameras.
    """
    uv = np.stack([c.undistort_points(p[..., :2].reshape(-1, 2)) for c, p in zip(rig, points, strict=True)])
    weights = np.where(points[..., 2] > _CONFIDENT, points[..., 2], 0.0).reshape(len(points), -1)
    weights = np.where(np.isfinite(uv).all(-1), weights, 0.0)
    x, _ = triangulate(rig.pinhole(), np.nan_to_num(uv), weights)
    return x.reshape(*points.shape[1:3], 3), uv, weights


def _well_known(points: Array, rig: CameraRig) -> Array:
    """Triangulate points (T, K, 3); NaN where all rays are nearly parallel, such as those of two cameras facing each
    other.

    points: (C, T, K, 3) px of the calibrated cameras and confidence; rig: the cameras.
    """
    x, uv, weights = _triangulated(points, rig)
    met = widest_angle(rig, uv, weights) > PARALLEL
    return np.where(met.reshape(x.shape[:2])[..., None], x, np.nan)


def _residual(points: Array, rig: CameraRig) -> float:
    """Compute the disagreement of the views with the common triangulation: the largest of the views' median distances.

    points: (C, T, K, 3) px of the calibrated cameras and confidence.
    Returns: the disagreement; NaN with one view, or where fewer than two views can be judged.
    It is in units of the person's size in the picture.
    """
    if len(rig) < 2:
        return float("nan")
    world, uv, weights = _triangulated(points, rig)
    used = (weights > 0) & ((weights > 0).sum(0) > 1)
    found = []
    for c, camera in enumerate(rig.pinhole()):
        seen = points[c][..., 2] > _CONFIDENT
        sizes = [float(np.ptp(p[s, :2], axis=0).max()) for p, s in zip(points[c], seen, strict=True) if s.sum() > 3]
        if not used[c].any() or not sizes or np.median(sizes) < 1:
            continue
        again = camera.project_pinhole(world.reshape(-1, 3)[used[c]])
        distance = np.nan_to_num(np.linalg.norm(again - uv[c][used[c]], axis=1), nan=1e6)
        found.append(float(np.median(distance)) / float(np.median(sizes)))
    return max(found) if len(found) > 1 else float("nan")


def _disproportion(world: Array, names: Sequence[str]) -> float:
    """Compute how far the bones are from an adult's proportions: mean deviation of the logarithms of their lengths.

    world: (T, K, 3) points; lengths are medians over the frames. 0 where too few are seen.
    """
    at = {n: i for i, n in enumerate(names)}
    found = []
    for a, b, length in _LENGTHS:
        if a in at and b in at:
            d = np.linalg.norm(world[:, at[a]] - world[:, at[b]], axis=-1)
            if np.isfinite(d).sum() >= 3:
                found.append(np.log(max(1e-6, float(np.nanmedian(d))) / length))
    if len(found) < 6:
        return 0.0
    return float(np.mean(np.abs(np.array(found) - np.median(found))))


def sides_exchanged(world: Array, names: Sequence[str]) -> bool:
    """Test whether nose and toes point backwards relative to left and right, in more than 85 % of the frames.

    world: (T, K, 3) m; NaN where missing.
    names: K names of the key points.
    Returns: False also where neither face nor feet are known in ten places and frames.
    """
    at = {n: i for i, n in enumerate(names)}

    def of(*wanted: str) -> Array | None:
        return np.mean([world[:, at[n]] for n in wanted], 0) if all(n in at for n in wanted) else None

    left, right = of("left_hip", "left_shoulder"), of("right_hip", "right_shoulder")
    upper, lower = of("left_shoulder", "right_shoulder"), of("left_hip", "right_hip")
    if left is None or right is None or upper is None or lower is None:
        return False
    forwards = np.cross(left - right, upper - lower)  # left x up
    signs = []
    for front, back in (
        (("nose",), ("left_ear", "right_ear")),
        (("left_big_toe",), ("left_heel",)),
        (("right_big_toe",), ("right_heel",)),
    ):
        a, b = of(*front), of(*back)
        if a is not None and b is not None:
            signs.append(((a - b) * forwards).sum(-1))
    if not signs:
        return False
    found = np.concatenate(signs)
    found = found[np.isfinite(found) & (np.abs(found) > 0)]
    return len(found) >= 10 and float((found < 0).mean()) > 0.85
