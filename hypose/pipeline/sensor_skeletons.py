"""Assess skeletons that were fused from the reports of several sensors, and fit the poses of a body to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.calibration.diagnose_person import UNIT_ERRORS
from hypose.calibration.findings import INVALID, REVIEW, Finding
from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.evidence.terms import PointTerm
from hypose.fitting import fit_clip
from hypose.fusion import joints as jt
from hypose.fusion.align import offset_by_movement
from hypose.fusion.fuse import common_positions
from hypose.fusion.register import Registration, common_joints, register
from hypose.geometry import Array
from hypose.pipeline.assessment import Assessment, assess
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.subject import subject_from_keypoints

_LEGS = ([jt.LEFT_HIP, jt.LEFT_KNEE, jt.LEFT_FOOT], [jt.RIGHT_HIP, jt.RIGHT_KNEE, jt.RIGHT_FOOT])
_CURE = "place the sensors so that one of them sees each side of the person, and nothing is in between"


def assess_fused(
    motion: Motion, clip: Sequence[SensorJoints], registration: Registration, names: Sequence[str]
) -> Assessment:
    """Assess one person's fused motion.

    clip: what the sensors reported of the person at the motion's times.
    registration: registration of the sensors.
    names: names of the sensors.
    """
    late = [Finding("clock", (), t) for t in _of_clocks(motion.times, clip, names)]
    found = [*(Finding("unit", (), text) for text in _of_size(motion)), *late]
    for name, apart in zip(names, registration.residual.tolist(), strict=True):
        if apart > SETTINGS.sensor_apart_m[0] and not late:
            text = (
                f"{name} and {names[0]} see the joints {1e3 * apart:.0f} mm apart (median), more "
                "than two sensors of one person do: look whether both are in metres, name left and right alike, are "
                "not mirrored, and saw the same movement"
            )
            severity = INVALID if apart > SETTINGS.sensor_apart_m[1] else REVIEW
            found.append(Finding("sensors disagree", (name,), text, size=apart, severity=severity))
    # frames without the person are no failure of the sensors
    if (away := float(motion.lost.mean())) > SETTINGS.verdict_lost_share:
        text = f"no sensor saw the person in {100 * away:.0f} % of the frames"
        found.append(Finding("away", (), text, size=away, severity=REVIEW))
    there = (
        motion
        if motion.low_confidence is None
        else replace(motion, low_confidence=motion.low_confidence & ~motion.lost)
    )
    return assess(there, found, _CURE, 1.0)


def _of_size(motion: Motion) -> Iterator[str]:
    joints = motion.joints[:, [motion.skeleton.joint(n) for n in jt.COMMON]]
    legs = [np.linalg.norm(np.diff(joints[:, leg], axis=1), axis=-1).sum(1) for leg in _LEGS]
    long = float(np.nanmedian(np.concatenate(legs)[np.tile(~motion.lost, 2)])) if (~motion.lost).any() else np.nan
    if np.isfinite(long) and not SETTINGS.sensor_legs_m[0] <= long <= SETTINGS.sensor_legs_m[1]:
        tall = long / SETTINGS.sensor_of_height
        units = [w for factor, w in UNIT_ERRORS for f in (factor, 1 / factor) if 1.3 <= tall / f <= 2.1]
        unit = f": {units[0]}" if units else ""
        yield (
            f"the person would be {tall:.3g} m tall, by their legs{unit}; correct the unit, since skeletons must be in "
            "metres"
        )


def _of_clocks(times: Array, clip: Sequence[SensorJoints], names: Sequence[str]) -> Iterator[str]:
    seen, rate = np.stack([common_joints(f).positions for f in clip]), 1 / float(np.median(np.diff(times)))
    for k, name in enumerate(names):
        if k == 0 or not np.isfinite(seen[:, k]).any() or not np.isfinite(seen[:, 0]).any():
            continue
        late, likeness = offset_by_movement(times, seen[:, 0], times, seen[:, k])
        if likeness < SETTINGS.sensor_like or abs(late) < SETTINGS.sensor_late_s:
            continue
        there, then = _apart(seen[:, [0, k]], 0), _apart(seen[:, [0, k]], round(late * rate))
        if then < min(SETTINGS.sensor_apart_m[0], SETTINGS.sensor_nearer * there):
            when = f"{abs(late):.2f} s {'early' if late > 0 else 'late'}"
            yield (
                f"{name} reports the movements of {names[0]} {when}, so their clocks differ: correct its "
                'times, or say "clock": "own" in a session.json'
            )


def _apart(pair: Array, frames: int) -> float:
    """Compute the median distance (m) between the joints (T, 2, 15, 3) of two registered sensors, with the second's
    shifted by `frames`.
    """
    first, second = (
        (pair[frames:, 0], pair[: len(pair) - frames, 1]) if frames >= 0 else (pair[:frames, 0], pair[-frames:, 1])
    )
    both = np.stack([first, second], 1)
    return float(np.nan_to_num(register(both, np.where(np.isfinite(both[..., 0]), 2, 0)).residual[1], nan=np.inf))


# the 15 common joints by the names of key points; the torso cannot be separated from the spine
SENSOR_JOINT_NAMES = (
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
    """Fit a body with the person's bone lengths, and poses (T, 36), to fused joints.

    fused: motion of points (fusion.fuse.Fused.motion) in a world with z up, m.
    body: the template; default: human().
    smoothness: strength of the penalty on acceleration.
    Returns: body and motion; frames in which the person is lost are interpolated and stay marked as lost.
    Raises: InputError where no frame has enough joints.
    """
    points = common_positions(fused)
    points[np.asarray(fused.lost)] = np.nan
    if np.isfinite(points).all(-1).sum(1).max(initial=0) < 8:
        raise InputError("No frame of the fused motion has 8 joints; poses cannot be found from so few.")
    subject = subject_from_keypoints(body or human(), points, SENSOR_JOINT_NAMES)
    model = subject.keypoints
    known = np.flatnonzero(model.known)
    solved = np.flatnonzero(np.isfinite(subject.poses).all(1))
    nearest = solved[np.abs(np.arange(len(points))[:, None] - solved).argmin(1)]
    terms = [[PointTerm(p[known], np.ones(len(known)), model.joint[known], model.offset[known], 0.03)] for p in points]
    prior = anatomical_prior(subject.body.skeleton)
    poses = fit_clip(subject.body, subject.poses[nearest], terms, acceleration=smoothness, priors=(prior,))
    skeleton = subject.body.skeleton
    joints = subject.body.joints(poses)
    names = [SENSOR_JOINT_NAMES[k] for k in known if SENSOR_JOINT_NAMES[k] in skeleton.joint_names]
    # the fused joints of a motion start at the torso; look each up by its name there
    own = [fused.skeleton.joint(n.replace("wrist", "hand").replace("ankle", "foot")) for n in names]
    there = [skeleton.joint(n) for n in names]
    known_of_joints = {
        "joint_covariance": np.nan,
        "systematic_covariance": np.nan,
        "error_probability": np.nan,
        "low_confidence_joints": False,
    }
    arrays = {}
    for name, unknown in known_of_joints.items():
        if (given := getattr(fused, name)) is not None:
            arrays[name] = np.full((*joints.shape[:2], *given.shape[2:]), unknown, given.dtype)
            arrays[name][:, there] = given[:, own]
    return subject.body, replace(fused, skeleton=skeleton, joints=joints, poses=poses, **arrays)
