"""Walking and running: joint-angle curves of published gait data, with the variation of real strides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from hypose.errors import InputError
from hypose.geometry import Array
from hypose.synthetic.performance import Angles, Performance, centred, perform
from hypose.synthetic.subjects import SyntheticSubject


def sample_times(duration: float, frame_rate: float) -> Array:
    """(T,) s: at least two times from 0 on."""
    if not (duration > 0 and frame_rate > 0):
        raise InputError(f"A motion needs a positive duration and frame rate, got {duration} s and {frame_rate} Hz.")
    return np.arange(max(2, round(duration * frame_rate))) / frame_rate


class Take:
    """Random variation of one take: factors near 1, offsets near 0; exactly 1 and 0 without an rng."""

    def __init__(self, rng: np.random.Generator | None) -> None:
        self.rng = rng

    def factor(self, share: float) -> float:
        """A factor of relative sd `share`."""
        return 1.0 if self.rng is None else float(np.exp(np.clip(self.rng.normal(0, share), -2 * share, 2 * share)))

    def offset(self, size: float) -> float:
        """An offset of sd `size`."""
        return 0.0 if self.rng is None else float(np.clip(self.rng.normal(0, size), -2 * size, 2 * size))

    def drift(self, t: Array, size: float, period: float = 2.5) -> Array:
        """A smooth random course of the given sd: people are never quite periodic."""
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
    x, y = np.array(points, dtype=np.float64).T
    spline = CubicSpline(np.append(x, x[0] + 100) / 100, np.append(y, y[0]), bc_type="periodic")
    return spline(phase % 1.0)


def _gait(
    name: str,
    t: Array,
    rng: np.random.Generator | None,
    amplitude: float,
    speed: float,
    radius: float,
    jog: bool,
) -> Angles:
    take = Take(rng)
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


def walk(
    subject: SyntheticSubject,
    duration: float,
    frame_rate: float,
    rng: np.random.Generator | None = None,
    amplitude: float = 1.0,
    speed: float = 1.0,
    radius: float = 0.8,
) -> Performance:
    """Walking on a circle of `radius` m to the left (infinite: straight on), about 1.2 m/s."""
    return _around(
        perform(_gait("walk", sample_times(duration, frame_rate), rng, amplitude, speed, radius, False), subject)
    )


def jog(
    subject: SyntheticSubject,
    duration: float,
    frame_rate: float,
    rng: np.random.Generator | None = None,
    amplitude: float = 1.0,
    speed: float = 1.0,
    radius: float = 0.9,
) -> Performance:
    """Slow running on a circle of `radius` m to the left (infinite: straight on), with short flights."""
    return _around(
        perform(_gait("jog", sample_times(duration, frame_rate), rng, amplitude, speed, radius, True), subject)
    )


def _around(p: Performance) -> Performance:
    """A circle stays about its centre; anything that covers less than half of one is centred."""
    spread = np.ptp(p.root[:, :2], axis=0)
    return p if spread.min() > 0.6 * spread.max() else centred(p)
