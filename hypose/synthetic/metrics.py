"""Measures of an estimate against the truth, and the one-time alignment of joint definitions.

Lengths are in metres (reports print millimetres). Arrays of joints are (T, J, 3), world.

An error is the Euclidean distance between an estimated and a true joint centre. Two bodies rarely define a joint at the
same anatomical place, so that definitions are aligned once, by a fixed offset per joint in the frame of a segment,
never per frame: `population_offsets`, from two neutral rest bodies, once for all subjects and sequences, so that no
information about the subject or the sequence enters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES, PARENTS
from hypose.body.motion import region_reach
from hypose.errors import InputError
from hypose.geometry import Array, rotation_between, so3_log
from hypose.synthetic.subjects import load_subjects

EVALUATED_JOINTS: tuple[str, ...] = (
    *("pelvis", "neck", "head"),
    *("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist"),
    *("left_hip", "left_knee", "left_ankle", "right_hip", "right_knee", "right_ankle"),
)
"""The 15 joints of the mean error (HumanEva also averages over 15 virtual markers)."""
EVALUATED: NDArray[np.int64] = np.array([JOINT_NAMES.index(n) for n in EVALUATED_JOINTS])
"""Indices of the evaluated joints among the 19 joints."""
# The segment whose frame carries a joint's offset: the one that ends in the joint (an elbow is fixed to
# the upper arm), the joint's own for the root. The head joint is carried by the head.
CARRIERS = np.array([j if JOINT_NAMES[j] in ("pelvis", "head") else int(PARENTS[j]) for j in range(len(JOINT_NAMES))])
"""(19,) the joint whose frame carries the definition offset of each joint."""


def population_offsets(body: Body) -> Array:
    """Compute where the truth defines each joint relative to an estimated body, per metre of stature.

    body: the tracker's template as shipped, not fitted to a person: it is compared with the subject "neutral" once, the
        same for every subject and sequence.
    Returns: (19, 3) offsets in the rest frame. Multiply by the subject's stature and give to `joint_errors`; no other
        information about a subject or a sequence is used.

    Both bodies are scaled to stature 1 and placed so that all joints agree in the mean. A limb segment that rests more
    than 10 degrees apart in the two bodies is turned to the same direction first, because that is posture, not
    definition.
    """
    neutral = load_subjects()["neutral"]
    a = body.skeleton.rest_joints / body.stature
    b = _posed_like(neutral.joints / neutral.stature, a)
    a, b = a - a[EVALUATED].mean(0), b - b[EVALUATED].mean(0)
    return b - a


def _posed_like(joints: Array, other: Array) -> Array:
    """Turn the limb segments of joints (19, 3) that differ in direction by more than 10 degrees from those of other
    joints (19, 3) to their direction; lengths stay.
    """
    out = joints.copy()
    for first in (6, 10, 13, 16):
        for a in (first, first + 1):
            bone, wanted = joints[a + 1] - joints[a], other[a + 1] - other[a]
            turn = rotation_between(bone, wanted)
            if np.linalg.norm(so3_log(turn)) < np.radians(10):
                turn = np.eye(3)
            out[a + 1] = out[a] + turn @ bone
    return out


def with_offsets(estimated: ArrayLike, rotations: ArrayLike, offsets: ArrayLike) -> Array:
    """Move estimated joints by definition offsets that are fixed in their carrying segments.

    estimated: (T, 19, 3) m.
    rotations: (T, 19, 3, 3) world_from_joint of the estimate (`Skeleton.forward`).
    offsets: (19, 3) m.
    Returns: (T, 19, 3) m.
    """
    e, r, o = (np.asarray(x, dtype=np.float64) for x in (estimated, rotations, offsets))
    return e + np.einsum("tjab,jb->tja", r[:, CARRIERS], o)


def joint_errors(
    estimated: ArrayLike, truth: ArrayLike, offsets: ArrayLike | None = None, rotations: ArrayLike | None = None
) -> Array:
    """Compute the distances between estimated and true joints in world coordinates, without aligning any frame.

    estimated, truth: (T, 19, 3) m.
    offsets: (19, 3) m, definition offsets added to the estimate in its carrying segments, or None.
    rotations: (T, 19, 3, 3) world_from_joint of the estimate, needed with offsets.
    Returns: (T, 15) m, distances of the joints EVALUATED_JOINTS; NaN where the truth or the estimate is NaN.
    Raises: InputError where shapes differ.
    """
    e, t = np.asarray(estimated, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if e.shape != t.shape or e.ndim != 3 or e.shape[1:] != (len(JOINT_NAMES), 3):
        raise InputError(
            f"Estimate and truth must both be (frames, {len(JOINT_NAMES)}, 3), got {e.shape} and {t.shape}; "
            "compare the same frames of both."
        )
    if offsets is not None and rotations is not None:
        e = with_offsets(e, rotations, offsets)
    return np.linalg.norm(e[:, EVALUATED] - t[:, EVALUATED], axis=-1)


def coverage(
    estimated: ArrayLike, joint_sd: ArrayLike, truth: ArrayLike, levels: tuple[float, ...] = (0.5, 0.9, 0.95)
) -> dict[float, Array]:
    """Compute how often the true joint lies in the reported confidence region.

    estimated, truth: (T, J, 3) m.
    joint_sd: (T, J) m per axis, or covariances (T, J, 3, 3) m^2.
    levels: probabilities of the regions; the region of a level is the sphere (ellipsoid) of `body.motion.region_reach`.
    Returns: by level, the share of the frames (J,); NaN where no sd is known. A well calibrated method has coverage =
        level.
    """
    d = np.asarray(truth, dtype=np.float64) - np.asarray(estimated, dtype=np.float64)
    s = np.asarray(joint_sd, dtype=np.float64)
    if s.ndim == 4:
        known = np.asarray(np.isfinite(s).all((-1, -2)))
        safe = np.where(known[..., None, None], s, np.eye(3))
        squared = np.einsum("tja,tja->tj", d, np.linalg.solve(safe, d[..., None])[..., 0])
    else:
        known = np.asarray(np.isfinite(s) & (s > 0))
        squared = (d**2).sum(-1) / np.where(known, s, 1.0) ** 2
    known &= np.isfinite(squared)
    out = {}
    for level in levels:
        inside = (squared <= region_reach(level) ** 2) & known
        with np.errstate(invalid="ignore", divide="ignore"):
            out[level] = inside.sum(0) / known.sum(0)
    return out
