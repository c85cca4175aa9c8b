"""What is found out about a fused motion: the verdict on it, and the poses of a body along its joints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.body.ready_bodies import human
from hypose.calibration.diagnose_person import UNITS
from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.fitting import PointTerm, fit_clip
from hypose.fusion import joints as jt
from hypose.fusion.clocks import offset_by_movement
from hypose.fusion.point_motion import common_positions
from hypose.fusion.register import Registration, common_joints, register
from hypose.geometry import Array
from hypose.pipeline.verdict import LOST_SHARE, Verdict, verdict_of
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.subject import subject_from_keypoints

APART_LOOK_M, APART_M = 0.085, 0.15
"""m by which the joints of two sensors lie apart (median) from which on it is worth a look, and not to be trusted: 14
to 67 mm on 39 recordings of two real sensors; where one of them is 15 % too large 113, a second late 122, with left and
right exchanged in every frame 240"""
LATE_S, LIKE = 0.2, 0.85
"""s by which a sensor's clock may be off, and the correlation of both movements from which on they tell: 0.12 s at most
on the recordings above, where they tell"""
_NEARER = 0.8
"""what is left at most of the distance between two sensors' joints when a clock is put right: who walks moves alike
half a step later, with arms or sides exchanged"""
_LEGS_M = 0.39, 0.99
"""m of thigh and shank together, of people 0.9 to 2.3 m tall: sensors say 0.64 to 0.86 of adults"""
_LEGS = ((jt.LEFT_HIP, jt.LEFT_KNEE, jt.LEFT_FOOT), (jt.RIGHT_HIP, jt.RIGHT_KNEE, jt.RIGHT_FOOT))
_CURE = "place the sensors so that one of them sees each side of the person, and nothing is in between"
_OF_HEIGHT = 0.43
"""thigh and shank as sensors see them, as a share of the height"""


def fused_verdict(
    motion: Motion, clip: Sequence[SensorJoints], registration: Registration, names: Sequence[str]
) -> Verdict:
    """Of one person's fused motion; clip: what the sensors, with these names, reported of them at its times."""
    because, looks = list(_of_size(motion)), list[str]()
    late = list(_of_clocks(motion.times, clip, registration.reference, names))
    because += late
    for name, apart in zip(names, registration.residual.tolist(), strict=True):
        if apart > APART_LOOK_M and not late:
            text = (
                f"{name} and {names[registration.reference]} see the joints {1e3 * apart:.0f} mm apart (median), more "
                "than two sensors of one person do: look whether both are in metres, name left and right alike, are "
                "not mirrored, and saw the same movement"
            )
            (because if apart > APART_M else looks).append(text)
    # a sensor reports whom it sees: who is away is not there to be found
    if (away := float(motion.lost.mean())) > LOST_SHARE:
        looks.append(f"no sensor saw the person in {100 * away:.0f} % of the frames")
    there = motion if motion.doubtful is None else replace(motion, doubtful=motion.doubtful & ~motion.lost)
    return verdict_of(there, because, looks, _CURE, 1.0)


def _of_size(motion: Motion) -> Iterator[str]:
    joints = motion.joints[:, [motion.skeleton.joint(n) for n in jt.COMMON]]
    legs = [_length(joints, a, b) + _length(joints, b, c) for a, b, c in _LEGS]
    long = float(np.nanmedian(np.concatenate(legs)[np.tile(~motion.lost, 2)])) if (~motion.lost).any() else np.nan
    if np.isfinite(long) and not _LEGS_M[0] <= long <= _LEGS_M[1]:
        tall = long / _OF_HEIGHT
        units = [w for factor, w in UNITS for f in (factor, 1 / factor) if 1.3 <= tall / f <= 2.1]
        unit = f": {units[0]}" if units else ""
        yield (
            f"the person would be {tall:.3g} m tall, by their legs{unit}; correct the unit, since skeletons must be in "
            "metres"
        )


def _length(joints: Array, a: int, b: int) -> Array:
    return np.linalg.norm(joints[:, a] - joints[:, b], axis=-1)


def _of_clocks(times: Array, clip: Sequence[SensorJoints], reference: int, names: Sequence[str]) -> Iterator[str]:
    seen, rate = np.stack([common_joints(f).positions for f in clip]), 1 / float(np.median(np.diff(times)))
    for k, name in enumerate(names):
        if k == reference or not np.isfinite(seen[:, k]).any() or not np.isfinite(seen[:, reference]).any():
            continue
        late, likeness = offset_by_movement(times, seen[:, reference], times, seen[:, k])
        if likeness < LIKE or abs(late) < LATE_S:
            continue
        there, then = _apart(seen[:, [reference, k]], 0), _apart(seen[:, [reference, k]], round(late * rate))
        if then < min(APART_LOOK_M, _NEARER * there):
            when = f"{abs(late):.2f} s {'early' if late > 0 else 'late'}"
            yield (
                f"{name} reports the movements of {names[reference]} {when}, so their clocks differ: correct its "
                'times, or say "clock": "own" in a session.json'
            )


def _apart(pair: Array, frames: int) -> float:
    """m (median) between the joints (T, 2, 15, 3) of two sensors once registered, the second's put so many frames
    later."""
    first, second = (
        (pair[frames:, 0], pair[: len(pair) - frames, 1]) if frames >= 0 else (pair[:frames, 0], pair[-frames:, 1])
    )
    both = np.stack([first, second], 1)
    return float(np.nan_to_num(register(both, np.where(np.isfinite(both[..., 0]), 2, 0)).residual[1], nan=np.inf))


# the 15 common joints by the names of key points; the torso is no point of the body that could be told from the spine
NAMES = (
    "head",
    "neck",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "torso",
    "left_hip",
    "left_knee",
    "left_ankle",
    "right_hip",
    "right_knee",
    "right_ankle",
)


def pose_fused(fused: Motion, body: Body | None = None, smoothness: float = 1.0) -> tuple[Body, Motion]:
    """The body with the person's bone lengths, and its motion (T, 36) along fused joints.

    fused: a motion of points (fusion.fuse.Fused.motion) in a world with z up, m. smoothness: strength of the penalty on
    acceleration. Frames in which the person is lost are bridged and stay marked as lost. An InputError when too little
    was seen to find a pose."""
    points = common_positions(fused)
    points[np.asarray(fused.lost)] = np.nan
    if np.isfinite(points).all(-1).sum(1).max(initial=0) < 8:
        raise InputError("No frame of the fused motion has 8 joints; poses cannot be found from so few.")
    subject = subject_from_keypoints(body or human(), points, NAMES)
    model = subject.keypoints
    known = np.flatnonzero(model.known)
    solved = np.flatnonzero(np.isfinite(subject.poses).all(1))
    nearest = solved[np.abs(np.arange(len(points))[:, None] - solved).argmin(1)]
    terms = [
        PointTerm(p[known], np.ones(len(known)), model.joint[known], model.offset[known], 0.03)
        if np.isfinite(p).any()
        else None
        for p in points
    ]
    prior = anatomical_prior(subject.body.skeleton)
    poses = fit_clip(subject.body, subject.poses[nearest], points=terms, acceleration=smoothness, priors=(prior,))
    skeleton = subject.body.skeleton
    joints = subject.body.joints(poses)
    names = [NAMES[k] for k in known if NAMES[k] in skeleton.joint_names]
    # the fused joints of a motion start at the torso; look each up by its name there
    own = [fused.skeleton.joint(n.replace("wrist", "hand").replace("ankle", "foot")) for n in names]
    there = [skeleton.joint(n) for n in names]
    known_of_joints = {
        "joint_covariance": np.nan,
        "systematic_covariance": np.nan,
        "p_wrong": np.nan,
        "doubtful_joints": False,
    }
    arrays = {}
    for name, unknown in known_of_joints.items():
        if (given := getattr(fused, name)) is not None:
            arrays[name] = np.full((*joints.shape[:2], *given.shape[2:]), unknown, given.dtype)
            arrays[name][:, there] = given[:, own]
    return subject.body, replace(fused, skeleton=skeleton, joints=joints, poses=poses, **arrays)
