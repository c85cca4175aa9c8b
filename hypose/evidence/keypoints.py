"""2D key points of any detector: sets of names, OpenPose-style JSON, triangulation, places on the body.

Names are lower case with the side first (left_shoulder); left is the person's own left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import InputError
from hypose.evidence.frame import Keypoints
from hypose.geometry import Array
from hypose.json_text import parse_json

_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_LIMBS = tuple(
    f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")
)


def _sided(parts: Sequence[str]) -> tuple[str, ...]:
    """Write out sides: "Lelbow" becomes "left_elbow"; names that begin with neither L nor R stay."""
    long = {"L": "left_", "R": "right_"}
    return tuple(long[p[0]] + p[1:] if p[0] in long else p for p in parts)


COCO_17 = _FACE + _LIMBS
BODY_25 = _sided(
    "nose neck Rshoulder Relbow Rwrist Lshoulder Lelbow Lwrist mid_hip Rhip Rknee Rankle Lhip Lknee Lankle Reye "
    "Leye Rear "
    "Lear Lbig_toe Lsmall_toe Lheel Rbig_toe Rsmall_toe Rheel".split()
)
BODY_25B = COCO_17 + _sided("upper_neck head_top Lbig_toe Lsmall_toe Lheel Rbig_toe Rsmall_toe Rheel".split())
HALPE_26 = COCO_17 + _sided("head_top neck mid_hip Lbig_toe Rbig_toe Lsmall_toe Rsmall_toe Lheel Rheel".split())
BODY_135 = BODY_25B + tuple(
    [f"{side}_hand_{i}" for side in ("left", "right") for i in range(20)] + [f"face_{i}" for i in range(70)]
)
COCO_133 = (
    COCO_17
    + _sided("Lbig_toe Lsmall_toe Lheel Rbig_toe Rsmall_toe Rheel".split())
    + tuple([f"face_{i}" for i in range(68)] + [f"{side}_hand_{i}" for side in ("left", "right") for i in range(21)])
)
COCO_18 = BODY_25[:8] + BODY_25[9:19]
BLAZEPOSE_33 = _sided(
    "nose Leye_inner Leye Leye_outer Reye_inner Reye Reye_outer Lear Rear Lmouth Rmouth Lshoulder Rshoulder "
    "Lelbow Relbow "
    "Lwrist Rwrist Lpinky Rpinky Lindex Rindex Lthumb Rthumb Lhip Rhip Lknee Rknee Lankle Rankle Lheel Rheel Lbig_toe "
    "Rbig_toe".split()
)
KEYPOINT_SETS: Mapping[str, tuple[str, ...]] = {
    "BODY_25": BODY_25,
    "BODY_25B": BODY_25B,
    "COCO_17": COCO_17,
    "COCO_18": COCO_18,
    "HALPE_26": HALPE_26,
    "BLAZEPOSE_33": BLAZEPOSE_33,
    "COCO_133": COCO_133,
    "BODY_135": BODY_135,
}
"""The named sets. BODY_25 and BODY_25B have the same length: a recording must say which one it has."""

_BONES = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
        ("hip", "knee"),
        ("knee", "ankle"),
        ("ankle", "big_toe"),
        ("ankle", "heel"),
        ("shoulder", "hip"),
    )
) + (
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    ("upper_neck", "head_top"),
    ("neck", "head_top"),
    ("neck", "nose"),
)


def lasting_m(names: Sequence[str]) -> float:
    """Return the constant error of a set's key points, m per axis: the part that is the same in all views and
    frames, so that no scatter shows it.

    It is known for BlazePose only: on rendered people (seeds 5200 to 5215) its points lay 10 to 20 mm from their mean
    offsets. 0 for other sets.
    """
    return 0.02 if tuple(names) == BLAZEPOSE_33 else 0.0


def keypoint_names(keypoint_set: str) -> tuple[str, ...]:
    """Return the names of the points of a key-point set.

    keypoint_set: name of the set.
    Raises: InputError, which lists the sets, where the name is unknown.
    """
    found = {k.upper(): v for k, v in KEYPOINT_SETS.items()}.get(keypoint_set.strip().upper().replace("-", "_"))
    if found is None:
        raise InputError(f"There is no key-point set {keypoint_set!r}; the sets are {', '.join(KEYPOINT_SETS)}.")
    return found


def other_sides(names: Sequence[str]) -> NDArray[np.int64]:
    """Return the column (K,) of each point's counterpart on the other side; its own column where there is none."""
    other = {"left": "right", "right": "left"}
    column = {n: i for i, n in enumerate(names)}
    parts = [n.partition("_") for n in names]
    return np.array([column.get(f"{other.get(side, side)}_{part}", i) for i, (side, _, part) in enumerate(parts)])


def names_of_length(count: int) -> tuple[str, ...]:
    """Return the names of the key-point set with this number of points (25: OpenPose's BODY_25).

    Raises: InputError, which lists the sets, where no set has this number.
    """
    for names in KEYPOINT_SETS.values():
        if len(names) == count:
            return names
    known = ", ".join(f"{k} ({len(v)})" for k, v in KEYPOINT_SETS.items())
    raise InputError(f"No key-point set has {count} points; the sets are {known}.")


def parse_openpose(
    document: str | bytes | Mapping[str, Any],
    names: Sequence[str] | None = None,
    source: str = "The key-point file",
    raw: bool = False,
) -> Array:
    """Read the people of one OpenPose-style JSON document.

    names: the expected set (default: the set of that length).
    source: name of the file in error messages.
    raw: accept any number of points, and keep the scores unchanged.
    Returns: (P, K, 3) u px, v px, confidence 0..1. A point at (0, 0), or without finite position and confidence, is
        missing: confidence 0.
    Raises: InputError where it is no such document.
    """
    if isinstance(document, (str, bytes)):
        try:
            document = parse_json(document)
        except (ValueError, RecursionError) as problem:
            raise InputError(f"{source} is not JSON ({problem}); export it from the detector again.") from None
    found = document.get("people") if isinstance(document, Mapping) else None
    found = [] if found == {} else found  # some writers write an empty list so
    if not isinstance(found, list):
        raise InputError(
            f'{source} is not an OpenPose-style file: it needs a list "people"; export key points in the '
            f"OpenPose format."
        )
    people = []
    for number, person in enumerate(found):
        if person == {}:
            continue
        keys = ("pose_keypoints_2d", "pose_keypoints")  # the latter: OpenPose 1.0
        flat = next((person[k] for k in keys if k in person), None) if isinstance(person, Mapping) else None
        if flat is None:
            raise InputError(f'{source}, person {number}: "pose_keypoints_2d" is missing; export body key points.')
        try:
            values = np.array(flat, dtype=np.float64).ravel()
        except (TypeError, ValueError):
            raise InputError(f'{source}, person {number}: "pose_keypoints_2d" must hold numbers only.') from None
        if values.size == 0:
            continue
        if values.size % 3 or (names is not None and values.size != 3 * len(names)):
            wanted = "a multiple of 3" if names is None else f"3 x {len(names)} = {3 * len(names)}"
            raise InputError(
                f"{source}, person {number}: {values.size} numbers, but {wanted} are needed; name the "
                f"detector's set with "
                f"`keypoint_set` (one of {', '.join(KEYPOINT_SETS)})."
            )
        points = values.reshape(-1, 3)
        if names is None and not raw:
            names_of_length(len(points))
        finite = np.isfinite(points[:, :2]).all(1)
        confident = np.nan_to_num(points[:, 2], nan=0.0) > 0
        if (bad := ~finite & confident).any() or np.isinf(points).any():
            k = int(np.argmax(bad | np.isinf(points).any(1)))
            raise InputError(f"{source}, person {number}: key point {k} is not a finite position; export it again.")
        missing = ~finite | ~confident | (points[:, :2] == 0).all(1)
        people.append(np.where(missing[:, None], 0.0, points if raw else np.clip(points, None, [np.inf, np.inf, 1.0])))
    k = len(names) if names is not None else (len(people[0]) if people else 0)
    if any(len(p) != k for p in people):
        raise InputError(f"{source}: the people have different numbers of key points.")
    return np.stack(people) if people else np.zeros((0, k, 3))


def openpose_document(people: ArrayLike) -> dict[str, Any]:
    """Convert people (P, K, 3), px and confidence, to OpenPose's JSON document; people without a confident point are
    left out.
    """
    seen = [p for p in np.asarray(people, dtype=np.float64) if (p[:, 2] > 0).any()]
    return {
        "version": 1.3,
        "program": "hypose",
        "people": [{"person_id": [-1], "pose_keypoints_2d": np.round(p, 3).ravel().tolist()} for p in seen],
    }


def to_keypoints(points: Sequence[ArrayLike], names: Sequence[str], rig: CameraRig, pinhole: CameraRig) -> Keypoints:
    """Convert one person's detected points to Keypoints in undistorted pixels of the working-size cameras.

    points: per view (K, 3) in pixels of the calibrated (distorted) cameras of `rig`.
    pinhole: the working-size cameras.
    Raises: InputError where a view has another number of points.
    """
    out = np.zeros((len(rig), len(names), 3))
    for c, p in enumerate(points):
        a = np.asarray(p, dtype=np.float64)
        if a.shape != (len(names), 3):
            raise InputError(f"Camera {rig.names[c]}: key points of shape {a.shape}, {(len(names), 3)} is needed.")
        scale = np.array(pinhole[c].size) / np.array(rig[c].size)
        out[c, :, :2] = (rig[c].undistort_points(a[:, :2]) + 0.5) * scale - 0.5
        out[c, :, 2] = np.where(np.isfinite(out[c, :, :2]).all(1), a[:, 2], 0.0)
    return Keypoints(np.nan_to_num(out), tuple(names), pinhole)


_OF_BLAZEPOSE: Mapping[str, tuple[float, float, float]] = {
    "nose": (0.0, 0.023, 0.001),
    "eye": (0.0, 0.021, -0.003),
    "ear": (-0.008, 0.0, -0.003),
    "shoulder": (0.003, 0.004, 0.016),
    "elbow": (0.0, -0.003, 0.0),
    "wrist": (0.0, -0.009, -0.006),
    "hip": (-0.002, -0.010, -0.009),
    "knee": (-0.001, 0.005, 0.005),
    "ankle": (-0.001, -0.006, 0.012),
    "heel": (-0.006, -0.008, -0.005),
    "big_toe": (0.007, 0.013, -0.002),
}
"""Offsets of BlazePose's points from joints and landmarks, in shares of the body height, in the rest frame of a left
limb. Medians over 16 rendered people (benchmark `detector`, seeds 5200 to 5215) of triangulated points."""


def landmark_of(names: Sequence[str], body: Body) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Look up where key points sit on a body.

    Elbows, wrists, knees and ankles are joint centres. Shoulders are fixed to the clavicles and hips to the pelvis (the
    same places, but an offset learnt there does not turn with the limb). OpenPose's neck is the middle between the
    shoulders, mid_hip the middle between the hips. Face, heels and toes are landmarks. BlazePose's points have their
    network's offsets.
    Returns: joint (K,); offset (K, 3) in the joint's rest frame, m; known (K,), False for unknown names.
    """
    s, rest = body.skeleton, body.skeleton.rest_joints
    at: dict[str, tuple[str, Array]] = {}
    for side in ("left", "right"):
        for part in ("elbow", "wrist", "knee", "ankle"):
            at[f"{side}_{part}"] = (f"{side}_{part}", rest[s.joint(f"{side}_{part}")])
        at[f"{side}_shoulder"] = (f"{side}_clavicle", rest[s.joint(f"{side}_shoulder")])
        at[f"{side}_hip"] = ("pelvis", rest[s.joint(f"{side}_hip")])
    for name, carrier, part in (("neck", "chest", "shoulder"), ("mid_hip", "pelvis", "hip")):
        at[name] = (carrier, 0.5 * (rest[s.joint(f"left_{part}")] + rest[s.joint(f"right_{part}")]))
    at["upper_neck"] = ("neck", rest[s.joint("neck")])
    joint, offset = np.zeros(len(names), dtype=np.int64), np.zeros((len(names), 3))
    known = np.zeros(len(names), dtype=np.bool_)
    for k, name in enumerate(names):
        if name in at:
            joint[k] = s.joint(at[name][0])
            offset[k] = at[name][1] - rest[joint[k]]
        elif name in body.landmarks.names:
            i = body.landmarks.index(name)
            joint[k], offset[k] = body.landmarks.joint[i], body.landmarks.offset[i]
        else:
            continue
        known[k] = True
        side, _, part = name.partition("_")
        moved = _OF_BLAZEPOSE.get(part, _OF_BLAZEPOSE.get(name)) if tuple(names) == BLAZEPOSE_33 else None
        if moved is not None:
            offset[k] += body.stature * np.array(moved) * (-1 if side == "right" else 1, 1, 1)
    return joint, offset, known


def triangulate_keypoints(
    frames: Sequence[Keypoints],
    max_residual: float | None = None,
    min_confidence: float = 0.2,
    worse: ArrayLike = 1.0,
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Triangulate the key points of T frames robustly.

    It is a linear triangulation weighted by confidence. Where the largest reprojection distance exceeds max_residual
    and three or more views see the point, every view is left out in turn; the best result is used where it is at least
    twice as good.
    max_residual: px of the working size (default: 1 % of the longest image side).
    worse: (C,) noise factor of each view; a view with more than 1 is left out of points that two others see.
    Returns: points (T, K, 3) in the world, m; residual (T, K), root mean square over the views used, px; number of
        views (T, K). Points with fewer than two views, or with more than twice max_residual, are NaN.
    """
    if not frames:
        raise InputError("There are no key points to triangulate; give at least one frame.")
    rig = frames[0].rig
    points = np.stack([f.points for f in frames], 1)  # (C, T, K, 3)
    uv, w = points[..., :2], np.where(points[..., 2] > min_confidence, points[..., 2], 0.0)
    limit = 0.01 * float(rig.sizes.max()) if max_residual is None else max_residual
    shape = uv.shape[1:3]
    uv, w = uv.reshape(len(rig), -1, 2), w.reshape(len(rig), -1)
    good = np.broadcast_to(np.asarray(worse, dtype=np.float64) <= 1, len(rig))
    w[np.ix_(~good, (w[good] > 0).sum(0) >= 2)] = 0.0
    x, n = triangulate(rig, uv, w)
    distance = _reprojection(rig, x, uv, w)
    worst = distance.max(0, initial=0.0, where=w > 0)
    low_confidence = np.flatnonzero((worst > limit) & (n >= 3))
    if len(low_confidence):
        best_worst = worst[low_confidence].copy()
        best_x, best_w = x[low_confidence].copy(), w[:, low_confidence].copy()
        for c in range(len(rig)):
            less = w[:, low_confidence].copy()
            had = less[c] > 0
            less[c] = 0.0
            y, _ = triangulate(rig, uv[:, low_confidence], less)
            left = _reprojection(rig, y, uv[:, low_confidence], less).max(0, initial=0.0, where=less > 0)
            better = had & (left < 0.5 * worst[low_confidence]) & (left < best_worst)
            best_worst[better], best_x[better] = left[better], y[better]
            best_w[:, better] = less[:, better]
        x[low_confidence], w[:, low_confidence], worst[low_confidence] = best_x, best_w, best_worst
    used = w > 0
    n = used.sum(0)
    distance = np.where(used, _reprojection(rig, x, uv, w), 0.0)
    residual = np.sqrt((distance**2).sum(0) / np.maximum(n, 1))
    bad = (n < 2) | (worst > 2 * limit) | ~np.isfinite(x).all(1)
    x = np.where(bad[:, None], np.nan, x)
    return (
        x.reshape(*shape, 3),
        np.where(bad, np.nan, residual).reshape(shape),
        np.where(bad, 0, n).reshape(shape),
    )


def _reprojection(rig: CameraRig, x: Array, uv: Array, w: Array) -> Array:
    """Compute the distances (C, N), px, between projections of x (N, 3) and uv (C, N, 2); very large behind a camera.

    x: (N, 3) m.
    uv: (C, N, 2) px.
    w: (C, N) weights, 0 where a point is not seen.
    """
    d = np.stack([np.linalg.norm(camera.project_pinhole(x) - uv[c], axis=-1) for c, camera in enumerate(rig)])
    return np.where(w > 0, np.nan_to_num(d, nan=1e6), 0.0)


def person_size(points: ArrayLike, min_confidence: float = 0.3, least: int = 3) -> float:
    """Compute the longer side of the box around the confident points (K, 3), px; 0 where there are fewer than `least`.

    min_confidence: points with a larger confidence count.
    """
    p = np.asarray(points, dtype=np.float64)
    p = p[p[:, 2] > min_confidence]
    return float(np.ptp(p[:, :2], axis=0).max()) if len(p) >= least else 0.0


def thick_skeleton(
    points: ArrayLike,
    names: Sequence[str],
    shape: tuple[int, int],
    radius: float,
    min_confidence: float = 0.3,
) -> NDArray[np.uint8]:
    """Draw a person as a mask: limbs `radius` px thick to either side, a filled torso, head and hands.

    points: (K, 3) px of that image; bones with an end below min_confidence are left out.
    shape: (h, w) shape of the mask.
    """
    p = np.asarray(points, dtype=np.float64)
    mask = np.zeros(shape, np.uint8)
    far = 4 * max(shape)
    at = {
        n: (int(np.clip(round(u), -far, far)), int(np.clip(round(v), -far, far)))
        for n, (u, v, c) in zip(names, p, strict=True)
        if c > min_confidence
    }
    thickness = max(1, round(2 * radius + 1))
    for a, b in _BONES:
        if a in at and b in at:
            cv2.line(mask, at[a], at[b], 1, thickness)
    torso = [at[n] for n in ("left_shoulder", "right_shoulder", "right_hip", "left_hip") if n in at]
    if len(torso) == 4:
        cv2.fillConvexPoly(mask, cv2.convexHull(np.array(torso, dtype=np.int32)), 1)
    thighs = [n for side in ("left", "right") for n in (f"{side}_hip", f"{side}_knee")]
    if all(n in at for n in thighs):  # between the thighs: shorts, and the part that hip points set too high leave out
        hips = np.array([at[n] for n in thighs], dtype=np.float64).reshape(2, 2, 2)
        middle = 0.6 * hips[:, 0] + 0.4 * hips[:, 1]
        cv2.fillConvexPoly(mask, cv2.convexHull(np.rint([*hips[:, 0], *middle]).astype(np.int32)), 1)
    for n in ("left_wrist", "right_wrist", "left_ankle", "right_ankle"):
        if n in at:
            cv2.circle(mask, at[n], max(1, round(1.3 * radius)), 1, -1)
    head = np.array([at[n] for n in _FACE if n in at])
    if len(head):
        u, v = np.rint(head.mean(0)).astype(int)
        cv2.circle(mask, (int(u), int(v)), max(1, round(1.6 * radius)), 1, -1)
        if "left_shoulder" in at and "right_shoulder" in at:
            a, b = at["left_shoulder"], at["right_shoulder"]
            cv2.line(mask, (int(u), int(v)), ((a[0] + b[0]) // 2, (a[1] + b[1]) // 2), 1, thickness)
    return mask
