"""Built-in motions: walk, jog, box, wave, cross_arms, punch, sit_down, serve, combo; no external data is needed.

Walking and running follow published joint-angle curves (Winter 2009, normal gait, rounded; a slow run likewise); the
others are key poses joined smoothly. Angles are anatomical, see performance.Angles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from hypose.errors import InputError
from hypose.geometry import Array
from hypose.synthetic.performance import Angles, Performance, Stance, centred, chain, perform
from hypose.synthetic.subjects import SyntheticSubject

# key poses: channel values in degrees; both_ = left_ and right_
_RELAXED = {
    "both_shoulder_flexion": 3,
    "both_shoulder_abduction": 9,
    "both_shoulder_internal": 12,
    "both_elbow_flexion": 18,
}
_GUARD = {
    "spine_lean": 10,
    "neck_lean": -4,
    "both_shoulder_flexion": 42,
    "both_shoulder_abduction": 12,
    "both_shoulder_internal": 22,
    "both_elbow_flexion": 112,
    "both_clavicle_forward": 6,
    "up": -0.06,
}


# An instant, s, and the channels of a key pose.
_Key = tuple[float, dict[str, float]]


def _pose(*parts: Mapping[str, float]) -> dict[str, float]:
    """Combine key poses, later parts override earlier ones; both_X sets left_X and right_X."""
    out: dict[str, float] = {}
    for part in parts:
        for k, v in part.items():
            for name in [k.replace("both_", f"{s}_") for s in ("left", "right")] if k.startswith("both_") else [k]:
                out[name] = float(v)
    return out


def _keyed(
    name: str,
    t: Array,
    keys: Sequence[_Key],
    take: Take,
    stance: Stance,
    smooth: float = 0.05,
) -> Angles:
    """Join key poses monotonically, smooth them, and add a little sway.

    name: name of the motion.
    t: (T,) s, times of the frames.
    keys: instants (s) and key poses, in their order; poses that follow at the same time are left out.
    take: random variation.
    stance: stance of the feet.
    smooth: sd of the smoothing, s.
    """
    keys = [k for i, k in enumerate(keys) if i == 0 or k[0] > keys[i - 1][0] + 1e-6]
    at = np.array([k for k, _ in keys])
    channels = sorted({c for _, pose in keys for c in pose})
    fine = np.arange(int((t[-1] + 1.0) * 200) + 1) / 200 - 0.5
    values = {}
    for c in channels:
        y = np.array([pose.get(c, 0.0) for _, pose in keys])
        course = PchipInterpolator(at, y)(np.clip(fine, at[0], at[-1])) if len(at) > 1 else np.full_like(fine, y[0])
        values[c] = np.interp(t, fine, gaussian_filter1d(course, smooth * 200, mode="nearest"))
    sway = {
        "spine_lean": 0.8,
        "spine_list": 0.8,
        "spine_turn": 1.5,
        "neck_turn": 3.0,
        "neck_lean": 1.5,
        "forward": 0.006,
        "left": 0.008,
        "pelvis_turn": 1.0,
        "left_shoulder_flexion": 1.5,
        "left_shoulder_abduction": 1.0,
        "left_elbow_flexion": 2.0,
        "right_shoulder_flexion": 1.5,
        "right_shoulder_abduction": 1.0,
        "right_elbow_flexion": 2.0,
    }
    for c, size in sway.items():
        values[c] = values.get(c, np.zeros_like(t)) + take.drift(t, size)
    return Angles(name, t, values, stance)


def _scaled(pose: Mapping[str, float], base: Mapping[str, float], amplitude: float) -> dict[str, float]:
    """Scale the difference of a pose from a base pose."""
    keys = set(pose) | set(base)
    return {k: base.get(k, 0.0) + amplitude * (pose.get(k, 0.0) - base.get(k, 0.0)) for k in keys}


def _course(
    name: str,
    rest: Mapping[str, float],
    poses: Sequence[Mapping[str, float]],
    course: Sequence[tuple[float, int]],
    whole: float,
    share: float,
    begin: float,
    stance: Stance,
    smooth: float = 0.05,
) -> Callable[[Array, Take, float, float], Angles]:
    """Make the function of a motion that repeats a course of key poses: of times (T,) s, a `Take`, amplitude and speed.

    name: name of the motion.
    rest: channels of the pose at rest.
    poses: channels of the key poses, which override _RELAXED.
    course: instants within the course, s at normal speed, each with the number of its pose (0: at rest).
    whole: duration of the course with the pause after it, s.
    share: relative sd of the duration of each repetition.
    begin: s, start of the first one.
    stance, smooth: as in `_keyed`.
    """

    def motion(t: Array, take: Take, amplitude: float, speed: float) -> Angles:
        scaled = [_pose(rest), *(_scaled(_pose(_RELAXED, x), _pose(rest), amplitude) for x in poses)]
        keys, now = [(0.0, scaled[0])], begin
        while now < t[-1] + 1:
            step = take.factor(share) / speed
            keys += [(now + at * step, scaled[k]) for at, k in course]
            now += whole * step
        return _keyed(name, t, keys, take, stance, smooth)

    return motion


def _jab(side: str, reach: float = 1.0) -> dict[str, float]:
    """Return the channels of a straight blow of a side ("left", "right"); reach scales how far the arm goes."""
    s = 1.0 if side == "right" else -1.0  # a blow of the right hand turns the trunk to the left
    return {
        f"{side}_shoulder_flexion": 86 * reach,
        f"{side}_shoulder_abduction": -8,
        f"{side}_shoulder_internal": 45,
        f"{side}_elbow_flexion": 12,
        f"{side}_clavicle_forward": 14,
        "spine_turn": s * 24,
        "pelvis_turn": s * 14,
        "neck_turn": -s * 22,
        "forward": 0.10,
        f"{side}_heel": 0.06,
    }


def _box(t: Array, take: Take, amplitude: float, speed: float) -> Angles:
    """Simulate shadow boxing from a guard, left foot forward: jabs and crosses about every 0.8 s, bobbing in place."""
    guard = _pose(_GUARD)
    keys, now, side = [(0.0, guard)], 0.35, "left"
    while now < t[-1] + 1:
        blow = _scaled(_pose(_GUARD, _jab(side, take.factor(0.08))), guard, amplitude)
        rise = 0.17 / speed * take.factor(0.1)
        back = guard | {
            "spine_list": take.offset(5),
            "up": -0.06 + take.offset(0.015),
            "neck_lean": -4 + take.offset(4),
        }
        keys += [(now, guard), (now + rise, blow), (now + 2.2 * rise, back)]
        now += 2.2 * rise + (0.35 + abs(take.offset(0.2))) / speed
        side = "right" if side == "left" else "left"
        if take.rng is not None and take.rng.random() < 0.25:
            side = "right" if side == "left" else "left"
    angles = _keyed("box", t, keys, take, Stance(0.24, -0.24, 0.15, 14.0))
    bob = 0.012 * amplitude * (np.sin(2 * np.pi * 1.6 * speed * t) - 1)
    return Angles("box", t, angles.values | {"up": angles.get("up") + bob}, angles.stance)


def _punch(t: Array, take: Take, amplitude: float, speed: float) -> Angles:
    """Simulate strong straight punches of the right hand from a relaxed stance, with wind-up, every 1.6 s."""
    rest = _pose(_RELAXED, {"up": -0.02})
    wind = {
        "right_shoulder_flexion": -22,
        "right_elbow_flexion": 115,
        "right_shoulder_internal": 15,
        "spine_turn": -22,
        "pelvis_turn": -12,
        "neck_turn": 24,
        "up": -0.06,
        "forward": -0.05,
        "left_elbow_flexion": 85,
        "left_shoulder_flexion": 45,
        "left_shoulder_internal": 35,
        "right_shoulder_abduction": 14,
    }
    keys, now = [(0.0, rest)], 0.3
    while now < t[-1] + 1:
        step = take.factor(0.1) / speed
        back = _scaled(_pose(_RELAXED, wind), rest, amplitude)
        blow = _scaled(_pose(_RELAXED, wind, _jab("right", take.factor(0.06)), {"spine_lean": 8}), rest, amplitude)
        keys += [(now, rest), (now + 0.45 * step, back), (now + 0.68 * step, blow), (now + 1.15 * step, rest)]
        now += (1.3 + abs(take.offset(0.25))) / speed
    return _keyed("punch", t, keys, take, Stance(0.20, -0.16, 0.16, 12.0))


def _wave(t: Array, take: Take, amplitude: float, speed: float) -> Angles:
    """Simulate waving: raise the right arm, wave the forearm from side to side, lower it; again after a pause."""
    rest = _pose(_RELAXED)
    up = {
        "right_shoulder_flexion": 30,
        "right_shoulder_abduction": 92,
        "right_shoulder_internal": -78,
        "right_clavicle_up": 8,
        "spine_list": -3,
        "neck_list": 3,
    }
    keys, now = [(0.0, rest)], 0.2
    while now < t[-1] + 1:
        keys.append((now, rest))
        now += 0.6 / speed
        for k in range(6):
            swing = _pose(
                _RELAXED,
                up,
                {"right_elbow_flexion": 78 + (24 if k % 2 else -24) * amplitude + take.offset(4)},
            )
            keys.append((now, swing))
            now += 0.3 / speed * take.factor(0.06)
        keys.append((now + 0.4 / speed, rest))
        now += 0.9 / speed
    return _keyed("wave", t, keys, take, Stance())


_cross_arms = _course(
    "cross_arms",
    _RELAXED,
    [
        {
            "both_shoulder_internal": 62,
            "both_elbow_flexion": 100,
            "both_clavicle_forward": 10,
            "spine_lean": -2,
            "left_shoulder_flexion": 40,
            "right_shoulder_flexion": 28,
            "both_shoulder_abduction": 10,
        }
    ],
    ((0.0, 0), (0.7, 1), (2.2, 1), (2.9, 0)),
    3.6,
    0.1,
    0.3,
    Stance(),
    0.09,
)
"""Fold the arms in front of the chest, hold, and let them hang again (an IXMAS action)."""

_sit = _course(
    "sit_down",
    _RELAXED | {"forward": 0.02},
    [
        {
            "up": -0.24,
            "forward": -0.24,
            "pelvis_lean": 24,
            "spine_lean": 22,
            "neck_lean": -18,
            "both_shoulder_flexion": 42,
            "both_elbow_flexion": 30,
        },
        {
            "up": -0.49,
            "forward": -0.47,
            "pelvis_lean": 4,
            "spine_lean": 6,
            "neck_lean": -4,
            "both_shoulder_flexion": 38,
            "both_elbow_flexion": 52,
            "both_shoulder_abduction": 6,
        },
    ],
    ((0.0, 0), (0.6, 1), (1.15, 2), (2.3, 2), (2.9, 1), (3.6, 0)),
    4.2,
    0.1,
    0.4,
    Stance(0.0, 0.0, 0.17, 12.0),
    0.1,
)

_serve = _course(
    "serve",
    {
        **_RELAXED,
        "both_shoulder_flexion": 32,
        "both_elbow_flexion": 55,
        "both_shoulder_internal": 35,
        "spine_turn": -12,
        "pelvis_turn": -10,
        "neck_turn": 15,
        "up": -0.03,
    },
    [
        {
            "left_shoulder_flexion": 18,
            "left_elbow_flexion": 14,
            "right_shoulder_flexion": -12,
            "right_elbow_flexion": 12,
            "right_shoulder_abduction": 22,
            "spine_turn": -20,
            "pelvis_turn": -18,
            "neck_turn": 26,
            "forward": -0.05,
        },
        {
            "left_shoulder_flexion": 148,
            "left_elbow_flexion": 8,
            "left_clavicle_up": 12,
            "left_shoulder_abduction": 8,
            "right_shoulder_flexion": 0,
            "right_shoulder_abduction": 88,
            "right_shoulder_internal": -75,
            "right_elbow_flexion": 88,
            "spine_turn": -28,
            "pelvis_turn": -24,
            "spine_lean": -14,
            "spine_list": -8,
            "neck_lean": -22,
            "neck_turn": 30,
            "up": -0.13,
            "forward": 0.05,
        },
        {
            "right_shoulder_flexion": 25,
            "right_shoulder_abduction": 148,
            "right_shoulder_internal": -20,
            "right_elbow_flexion": 8,
            "right_clavicle_up": 18,
            "left_shoulder_flexion": 38,
            "left_elbow_flexion": 80,
            "left_shoulder_internal": 45,
            "spine_turn": 14,
            "pelvis_turn": 6,
            "spine_list": -16,
            "spine_lean": 6,
            "neck_lean": -16,
            "neck_turn": -6,
            "forward": 0.16,
            "both_heel": 0.10,
            "up": 0.0,
        },
        {
            "right_shoulder_flexion": 58,
            "right_shoulder_abduction": -16,
            "right_shoulder_internal": 40,
            "right_elbow_flexion": 35,
            "left_shoulder_flexion": 10,
            "left_elbow_flexion": 70,
            "spine_turn": 32,
            "left_shoulder_internal": 40,
            "pelvis_turn": 20,
            "spine_lean": 28,
            "neck_lean": -16,
            "neck_turn": -24,
            "up": -0.07,
            "forward": 0.20,
            "right_heel": 0.16,
        },
    ],
    ((0.0, 0), (0.45, 1), (1.05, 2), (1.2, 2), (1.46, 3), (1.78, 4), (2.6, 0)),
    3.2,
    0.06,
    0.3,
    Stance(0.26, -0.22, 0.15, 22.0),
)
"""A right-handed tennis serve without racket: toss, trophy pose with bent knees, strike, follow-through; each 3.2 s."""


# ---- gait ------------------------------------------------------------------------------------------------------------
# Walking and running: joint-angle curves of published gait data, with the variation of real strides.


def sample_times(duration: float, frame_rate: float) -> Array:
    """Return the times (T,) s of the frames, at least two, from 0.

    Raises: InputError where duration or frame rate is not positive.
    """
    if not (duration > 0 and frame_rate > 0):
        raise InputError(f"A motion needs a positive duration and frame rate, got {duration} s and {frame_rate} Hz.")
    return np.arange(max(2, round(duration * frame_rate))) / frame_rate


class Take:
    """Random variation of one performance of a motion: factors near 1 and offsets near 0; exactly 1 and 0 without a
    random generator.
    """

    def __init__(self, rng: np.random.Generator | None) -> None:
        self.rng = rng

    def factor(self, share: float) -> float:
        """Draw a factor of relative sd `share`."""
        return 1.0 if self.rng is None else float(np.exp(np.clip(self.rng.normal(0, share), -2 * share, 2 * share)))

    def offset(self, size: float) -> float:
        """Draw an offset of sd `size`."""
        return 0.0 if self.rng is None else float(np.clip(self.rng.normal(0, size), -2 * size, 2 * size))

    def drift(self, t: Array, size: float, period: float = 2.5) -> Array:
        """Draw a smooth random curve over times t (T,) s, because people are never exactly periodic.

        size: sd of the curve.
        period: mean period of its waves, s.
        """
        if self.rng is None:
            return np.zeros_like(t)
        n = 4
        f = self.rng.uniform(0.5, 1.5, n) / period
        phase = self.rng.uniform(0, 2 * np.pi, n)
        return size * np.sqrt(2 / n) * np.sin(2 * np.pi * f[:, None] * t + phase[:, None]).sum(0)


# degrees over one stride, in % from heel strike
# fmt: off
_WALK = {
    "hip": ((0, 26), (10, 23), (20, 15), (30, 5), (40, -4), (50, -10), (57, -9), (65, 2), (75, 17), (85, 26),
            (93, 27)),
    "knee": ((0, 5), (8, 14), (15, 17), (25, 13), (38, 6), (48, 10), (57, 30), (66, 54), (73, 61), (82, 46), (92, 14),
             (97, 5)),
    "ankle": ((0, 0), (7, -5), (20, 4), (40, 10), (48, 9), (55, -3), (62, -17), (70, -9), (80, 0), (90, 2)),
}
_JOG = {
    "hip": ((0, 34), (12, 26), (25, 5), (36, -12), (44, -13), (57, 8), (72, 38), (84, 46), (94, 39)),
    "knee": ((0, 19), (14, 41), (25, 32), (36, 18), (45, 34), (58, 82), (67, 94), (79, 68), (91, 25), (96, 18)),
    "ankle": ((0, 6), (14, 21), (25, 12), (37, -18), (50, -9), (70, 4), (88, 7)),
}
# fmt: on


def _periodic(points: Sequence[tuple[float, float]], phase: Array) -> Array:
    """Evaluate a periodic curve.

    points: pairs of time (% of a stride) and value.
    phase: (T,) strides.
    Returns: (T,).
    """
    x, y = np.array(points, dtype=np.float64).T
    spline = CubicSpline(np.append(x, x[0] + 100) / 100, np.append(y, y[0]), bc_type="periodic")
    return spline(phase % 1.0)


def _gait(
    name: str,
    t: Array,
    take: Take,
    amplitude: float,
    speed: float,
    radius: float,
) -> Angles:
    """Make the angles of walking at about 1.2 m/s, or of slow running with short flights.

    name: "walk" or "jog".
    t: (T,) s.
    take: the variation between strides.
    amplitude, speed: factors of size and speed.
    radius: radius of the circle on which the person travels, m.
    """
    jog = name == "jog"
    curves = _JOG if jog else _WALK
    rate = (1.35 if jog else 0.9) * speed * take.factor(0.05)
    phase = rate * t + take.offset(0.2) + take.drift(t, 0.008)
    size = amplitude * take.factor(0.06) * (0.75 if jog else 1.0)  # the curves are those of a faster run
    swing, elbow, lean = (36.0, 82.0, 8.0) if jog else (21.0, 22.0, 2.0)
    swing *= amplitude * take.factor(0.15)
    elbow += take.offset(6)
    values: dict[str, Array] = {}
    hip_drop = -3.0 * np.sin(2 * np.pi * (phase + 0.02))  # the pelvis sinks on the side of the swinging leg
    for side, shift in (("left", 0.0), ("right", 0.5)):
        p = phase + shift
        arm = np.cos(2 * np.pi * (p - 0.03))  # the arm is back when the leg of its side is in front
        values[f"{side}_hip_flexion"] = size * _periodic(curves["hip"], p) + take.drift(t, 0.8) + (4 if jog else 0)
        values[f"{side}_knee_flexion"] = np.maximum(size * _periodic(curves["knee"], p), 2.0)
        values[f"{side}_ankle_dorsiflexion"] = size * _periodic(curves["ankle"], p)
        values[f"{side}_hip_internal"] = np.full_like(t, -6.0)
        # the legs stay upright under the listing pelvis
        sign = 1.0 if side == "left" else -1.0
        values[f"{side}_hip_abduction"] = (-1.0 if jog else 0.5) + sign * hip_drop
        values[f"{side}_shoulder_flexion"] = (-8.0 if jog else 3.0) - swing * arm + take.drift(t, 1.5)
        values[f"{side}_shoulder_abduction"] = np.full_like(t, (14.0 if jog else 9.0) + take.offset(2))
        values[f"{side}_shoulder_internal"] = (22.0 if jog else 8.0) - (12.0 if jog else 4.0) * arm
        values[f"{side}_elbow_flexion"] = elbow - (0.45 if jog else 0.4) * swing * arm + take.drift(t, 1.5)
        values[f"{side}_clavicle_forward"] = -0.12 * swing * arm
    stride = np.cos(2 * np.pi * phase)
    values["pelvis_turn"] = -(7.0 if jog else 5.0) * size * stride
    values["pelvis_list"] = hip_drop
    values["pelvis_lean"] = np.full_like(t, lean * 0.5 + take.offset(1))
    values["spine_turn"] = (16.0 if jog else 11.0) * size * stride
    values["spine_list"] = (4.0 if jog else 3.5) * np.sin(2 * np.pi * (phase + 0.02))
    values["spine_lean"] = lean + 1.0 * np.cos(4 * np.pi * phase) + take.drift(t, 0.7)
    values["neck_turn"] = -(9.0 if jog else 6.0) * size * stride + take.drift(t, 4.0, 4.0)
    values["neck_lean"] = -lean + take.drift(t, 2.5, 4.0)
    if jog:
        # flight: both feet off the ground after each toe-off at 37 %, until the other foot strikes at 50 %
        air = ((2 * phase) % 1.0 - 0.74) / 0.26
        values["up"] = 0.05 * size * np.where((air > 0) & (air < 1), np.sin(np.pi * np.clip(air, 0, 1)) ** 2, 0.0)
    return Angles(name, t, values, None, radius)


# radius of the circle on which the person goes round to the left, m
_RADII = {"walk": 0.8, "jog": 0.9}
_KEYED = {
    "box": _box,
    "wave": _wave,
    "cross_arms": _cross_arms,
    "punch": _punch,
    "sit_down": _sit,
    "serve": _serve,
}
_COMBO = {"walk": 0.34, "jog": 0.24, "box": 0.22, "wave": 0.20}
MOTIONS = (*_RADII, *_KEYED, "combo")
"""Names of the built-in motions."""


def act(
    name: str,
    subject: SyntheticSubject,
    duration: float,
    frame_rate: float,
    rng: np.random.Generator | None = None,
    amplitude: float = 1.0,
    speed: float = 1.0,
    radius: float | None = None,
) -> Performance:
    """Make a built-in motion by name.

    name: one of MOTIONS; "combo" is walk, jog, box and wave one after the other (as HumanEva's begins).
    subject: the person.
    duration, frame_rate: length, s, and frames per second, Hz.
    rng: for random variation of size, speed, posture and timing; None: none.
    amplitude, speed: factors of the size and speed of the movement.
    radius: radius of the circle on which a person walks or jogs, m (infinite: straight on; None: the usual one).
    Returns: the performance, about the origin.
    Raises: InputError for an unknown name, or a duration or frame rate that is not positive.
    """
    if name not in MOTIONS:
        raise InputError(f"There is no motion {name!r}; the motions are {', '.join(MOTIONS)}.")
    take, t = Take(rng), sample_times(duration, frame_rate)
    if name in _KEYED:
        p = perform(_KEYED[name](t, take, amplitude, speed), subject)
        return centred(p) if name == "sit_down" else p
    if name in _RADII:
        p = perform(_gait(name, t, take, amplitude, speed, _RADII[name] if radius is None else radius), subject)
        spread = np.ptp(p.root[:, :2], axis=0)  # a circle stays about its centre; less than half of one is centred
        return p if spread.min() > 0.6 * spread.max() else centred(p)
    blend, n = 0.5, round(duration * frame_rate)
    extra = blend * (len(_COMBO) - 1) / len(_COMBO) + 0.1
    shows = [
        act(f, subject, duration * share + extra, frame_rate, rng, amplitude, speed) for f, share in _COMBO.items()
    ]
    whole = chain("combo", shows, subject, blend)
    n = min(n, len(whole))
    return centred(Performance("combo", whole.times[:n], whole.rotations[:n], whole.root[:n], whole.joints[:n]))
