"""Find out to which set 2D key points belong: by names in the file, else by their number and the lengths of bones."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hypose.errors import InputError
from hypose.evidence.keypoints import KEYPOINT_SETS, keypoint_names
from hypose.geometry import Array

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
_BONES: tuple[tuple[str, str, float], ...] = (
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
    for a, b, longest in _BONES:
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
    excess = {s: _mean([bone_excess(p, s) for p in views]) for s in fitting}
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


def _mean(values: Sequence[float]) -> float:
    """Average the values that are not NaN; NaN where there is none."""
    known = [v for v in values if v == v]
    return float(np.mean(known)) if known else float("nan")
