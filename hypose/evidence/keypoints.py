"""2D key points of any detector: sets of names, their order in other programs, triangulation, places on the body.

Names are lower case with the side first (left_shoulder); left is the person's own left.
"""

from __future__ import annotations

import re
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
    offsets, and 30 mm gave the best motion next to masks (seeds 7300 to 7307 and 7400 to 7407). 0 for other sets.
    """
    return 0.03 if tuple(names) == BLAZEPOSE_33 else 0.0


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


# Offsets of BlazePose's points from joints and landmarks, in shares of the body height, in the rest frame of a left
# limb. Medians over 16 rendered people (benchmark `detector`, seeds 5200 to 5215) of triangulated points.
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
    worst = _reprojection(rig, x, uv, w).max(0, initial=0.0)
    doubted = np.flatnonzero((worst > limit) & (n >= 3))
    if len(doubted):
        tried = [(x[doubted], w[:, doubted])]  # with all views, and without each one
        for c in range(len(rig)):
            less = w[:, doubted].copy()
            less[c] = 0.0
            tried.append((triangulate(rig, uv[:, doubted], less)[0], less))
        left = np.stack([_reprojection(rig, y, uv[:, doubted], less).max(0) for y, less in tried])
        left[1:] = np.where(left[1:] < 0.5 * left[0], left[1:], np.inf)
        best, each = left.argmin(0), np.arange(len(doubted))
        x[doubted], worst[doubted] = np.stack([y for y, _ in tried])[best, each], left[best, each]
        w[:, doubted] = np.stack([less for _, less in tried])[best, :, each].T
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


# ---- names and orders of other programs ----------------------------------------------------------------------------
# Find out to which set 2D key points belong: by names in the file, else by their number and the lengths of bones.


# other programs' words (MMPose, DeepLabCut, SLEAP, MediaPipe, OpenPose) -> ours, after side and separators are gone
_WORDS = {
    "footindex": "big_toe",
    "bigtoe": "big_toe",
    "smalltoe": "small_toe",
    "toe": "big_toe",
    "hallux": "big_toe",
    "head": "head_top",
    "headtop": "head_top",
    "topofhead": "head_top",
    "upperneck": "upper_neck",
    "pelvis": "mid_hip",
    "root": "mid_hip",
    "eyeinner": "eye_inner",
    "eyeouter": "eye_outer",
}
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
_MIDDLE = ("mid", "middle", "center", "centre")

# Longest that a bone of an upright adult appears, in shares of the whole person's extent in the picture.
_LONGEST: tuple[tuple[str, str, float], ...] = (
    *(
        (f"{side}_{a}", f"{side}_{b}", longest)
        for side in ("left", "right")
        for a, b, longest in (
            ("shoulder", "elbow", 0.20),
            ("elbow", "wrist", 0.18),
            ("hip", "knee", 0.27),
            ("knee", "ankle", 0.27),
            ("shoulder", "hip", 0.36),
            ("ankle", "heel", 0.10),
            ("ankle", "big_toe", 0.16),
            ("eye", "ear", 0.10),
        )
    ),
    ("left_shoulder", "right_shoulder", 0.25),
    ("left_hip", "right_hip", 0.22),
    ("left_eye", "right_eye", 0.06),
    ("nose", "left_eye", 0.07),
    ("nose", "right_eye", 0.07),
    ("nose", "neck", 0.20),
)
IMPLAUSIBLE = 0.25
"""Mean excess of bones over their longest usual length, in units of it, from which a set is impossible."""
_SCATTER = 1.3  # scatter of the ratios due to posture and perspective
_ENOUGH = 30  # seen bones that the judgement needs


def common_name(name: str) -> str:
    """Convert a key point's name (LBigToe, Left Foot Index, r_hip, hip_r, ...) to hypose's form (left_big_toe).

    Unknown names are returned in lower case with their own words.
    """
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=^[LR])(?=[A-Z][a-z])", "_", name.strip())
    words = [w for w in re.split(r"[^A-Za-z0-9]+", text.lower()) if w]
    if len(words) == 1 and (bare := re.fullmatch(r"(left|right)(\w+)|(\w+)(left|right)", words[0])):
        words = [bare[1] or bare[4], bare[2] or bare[3]]
    elif len(words) == 1 and words[0][:1] in "lr" and words[0][1:] in _SIDED:
        words = [words[0][0], words[0][1:]]
    side = next((_SIDES[w] for w in words if w in _SIDES), None)
    rest = [w for w in words if w not in _SIDES and w not in _MIDDLE]
    part = "".join(rest)
    part = _WORDS.get(part, part if part in _KNOWN_PARTS else "_".join(rest))
    if side is not None:
        return f"{side}_{part}"
    return "mid_hip" if part == "hip" else part


_SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "heel", "eye", "ear", "bigtoe", "smalltoe")
_KNOWN_PARTS = {n.removeprefix("left_").removeprefix("right_") for names in KEYPOINT_SETS.values() for n in names}


def arranged(names: Sequence[str], points: Array) -> tuple[str, Array, list[str]]:
    """Reorder key points with the names of another program to the key-point set that contains most of them (of equal
    sets the smaller one).

    points: (..., K, 3).
    Returns: name of the set; points (..., K', 3) in its order, confidence 0 where a point is missing; the given names
        that the set does not have.
    Raises: InputError where no set contains four of the names.
    """
    common = [common_name(n) for n in names]
    held = {s: sum(n in order for n in dict.fromkeys(common)) for s, order in KEYPOINT_SETS.items()}
    best = max(KEYPOINT_SETS, key=lambda s: (held[s], -len(KEYPOINT_SETS[s])))
    if held[best] < 4:
        shown = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
        raise InputError(
            f"the key points {shown} are not known; name shoulders, elbows, wrists, hips, knees and ankles with left "
            "and right (left_shoulder, LShoulder, shoulder_l)."
        )
    order = KEYPOINT_SETS[best]
    out = np.zeros((*points.shape[:-2], len(order), 3))
    for k, name in enumerate(order):
        if name in common:
            out[..., k, :] = points[..., common.index(name), :]
    return best, out, [n for n, c in zip(names, common, strict=True) if c not in order]


def bone_excess(points: ArrayLike, keypoint_set: str) -> float:
    """Compute by how much people's bones are too long if their points are read as points of a certain key-point set.

    points: (N, K, 3) px and confidence, of N people.
    Returns: mean over bones of the median excess over their longest usual length, in units of it; NaN where too little
        is seen. Right sets have about 0, others 1 and more.
    """
    p = np.asarray(points, dtype=np.float64)
    names = keypoint_names(keypoint_set)
    if p.ndim != 3 or p.shape[1] < len(names):
        return float("nan")
    seen = p[..., 2] > 0
    far = np.where(seen[..., None], p[..., :2], np.nan)
    with np.errstate(all="ignore"):
        enough = seen.sum(1) >= 6
        far, seen = far[enough], seen[enough]
        extent = np.nanmax(np.nanmax(far, 1) - np.nanmin(far, 1), 1) if len(far) else np.zeros(0)
    ratios, bones = [], 0
    for a, b, longest in _LONGEST:
        if a not in names or b not in names:
            continue
        i, j = names.index(a), names.index(b)
        both = seen[:, i] & seen[:, j] & (extent > 1e-6)
        if not both.any():
            continue
        share = np.linalg.norm(far[both, i] - far[both, j], axis=1) / extent[both]
        bones += int(both.sum())
        ratios.append(float(np.median(share)) / longest)
    if bones < _ENOUGH or len(ratios) < 5:
        return float("nan")
    # where only a part of the person is in the picture, all bones are too long by the same factor
    alike = max(1.0, float(np.median(ratios)))
    return float(np.mean(np.clip(np.array(ratios) / alike - _SCATTER, 0.0, 3.0)))


def set_of_points(views: Sequence[Array], stated: str | None, usual: Sequence[str]) -> tuple[str, str]:
    """Find out which key-point set the points of people belong to.

    views: per view the points (N, K, 3) of N people, px and confidence.

    stated: name of the set that the user or the file states; None: not stated.
    usual: sets that are preferred where several have this number of points.
    Returns: name of the set; how it is known: "stated", "by their number" or "by the lengths of bones".
    Raises: InputError, without the file's name, where the bones of the stated set are impossible and those of another
        are not, or where no set has this number of points or fits.
    """
    count = views[0].shape[1]
    fitting = [s for s in [*usual, *KEYPOINT_SETS] if s in KEYPOINT_SETS and len(KEYPOINT_SETS[s]) == count]
    fitting = list(dict.fromkeys(fitting))
    if stated is not None:
        names = keypoint_names(stated)
        stated = next(s for s, n in KEYPOINT_SETS.items() if n == names)
        if len(names) != count:
            hint = f"; {count} points are those of {' or '.join(fitting)}" if fitting else ""
            raise InputError(f"there are {count} points per person, {stated} has {len(names)}{hint}.")
        fitting = [stated, *(s for s in fitting if s != stated)]
    if not fitting:
        known = ", ".join(f"{s} ({len(n)})" for s, n in KEYPOINT_SETS.items())
        raise InputError(f"there are {count} points per person, which no set has; known are {known}.")
    excess = dict.fromkeys(fitting, float("nan"))
    for s in fitting:
        if known := [v for p in views if (v := bone_excess(p, s)) == v]:
            excess[s] = float(np.mean(known))
    first = excess[fitting[0]]
    better = min((s for s in fitting if excess[s] == excess[s]), key=lambda s: excess[s], default=fitting[0])
    if stated is not None:
        if first > IMPLAUSIBLE and excess[better] < 0.5 * IMPLAUSIBLE:
            raise InputError(f"the bones do not fit {stated} but {better}; correct keypoint_set.")
        return stated, "stated"
    if excess[better] > IMPLAUSIBLE:
        raise InputError(
            f"there are {count} points per person, but as {better} their bones have impossible lengths, so they are "
            "in another order; export one of the sets " + ", ".join(KEYPOINT_SETS) + "."
        )
    others = [excess[s] for s in fitting if s != better and excess[s] == excess[s]]
    if others and min(others) - excess[better] > 0.4 * IMPLAUSIBLE:
        return better, "by the lengths of bones"
    return fitting[0], "by their number"
