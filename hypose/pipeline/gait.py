"""Compute the gait of a tracked motion: foot strikes and lifts, steps, cadence and speed, each with an uncertainty.

A foot strikes where its heel is farthest in front of the pelvis, and leaves the ground where its toe is farthest behind
it, along the direction that the person faces. Uncertainties come from the covariances of ankles and pelvis without
their constant part: for a length along its own direction; for an event's time from how sharply the foot turns around,
with errors correlated over SETTINGS.gait_correlation. The difference between this definition and real ground contact is
not included.

Source: Zeni, Richards & Higginson 2008, Two simple methods for determining gait events during treadmill and overground
    walking using kinematic data. Deviation: the toe is the front of the sole, and times are refined between frames by a
    parabola.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from hypose.body.body import Body
from hypose.body.joint_angles import ANGLE_NAMES, is_length, joint_angles
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.smoothing import soles_of


@dataclass(frozen=True)
class GaitEvent:
    """Strike or lift of a foot.

    time: in the motion's times, s.
    sd: standard deviation of the time, s.
    side: "left" or "right".
    kind: "strike" or "off".
    place: (3,) position of heel (strike) or toe (off), m.
    """

    time: float
    sd: float
    side: str
    kind: str
    place: Array


@dataclass(frozen=True)
class GaitStep:
    """Step from the other foot's strike to this foot's strike.

    side: side of the foot that strikes.
    time: time of the strike, s.
    duration: s.
    length, width: between the heels along and across the facing direction, m.
    duration_sd, length_sd, width_sd: standard deviations.
    double_support: time of the step with both feet on the ground, s; NaN where not known.
    """

    side: str
    time: float
    duration: float
    duration_sd: float
    length: float
    length_sd: float
    width: float
    width_sd: float
    double_support: float


@dataclass(frozen=True)
class GaitFigure:
    """Mean of a gait parameter over all steps.

    mean: mean of n values.
    sd: standard deviation between the values.
    low, high: 90 % interval of the mean.
    """

    name: str
    unit: str
    mean: float
    sd: float
    low: float
    high: float
    n: int


@dataclass(frozen=True)
class Gait:
    """Gait of a motion.

    events: strikes and lifts of the feet, in the order of time.
    steps: steps, in the order of time.
    figures: mean of each gait parameter over all steps.
    """

    events: tuple[GaitEvent, ...]
    steps: tuple[GaitStep, ...]
    figures: tuple[GaitFigure, ...]


def gait_of(motion: Motion, body: Body) -> Gait:
    """Compute the gait of a motion; empty where the person does not walk.

    Lost or predicted frames, and frames next to them, give no events.
    Raises: InputError where the motion has no poses.
    """
    if motion.poses is None:
        raise InputError("The motion holds joint positions only, and gait needs poses; track again.")
    known = np.asarray(np.isfinite(motion.poses).all(1) & ~(motion.lost | motion.extrapolated).astype(bool))
    if known.sum() < 10 or len(motion) < 10:
        return Gait((), (), ())
    rate = motion.frame_rate
    feet = soles_of(body).positions(body, np.where(known[:, None], motion.poses, np.nan))
    skeleton = body.skeleton
    pelvis = motion.joints[:, skeleton.joint("pelvis")]
    facing = facing_of(skeleton.forward(motion.poses)[0][:, skeleton.joint("pelvis")], rate)
    covariance = {n: _moving(motion, skeleton.joint(n)) for n in ("pelvis", "left_ankle", "right_ankle")}
    events: list[GaitEvent] = []
    for side, heel, ball in (("left", 0, 1), ("right", 2, 3)):
        spread = covariance[f"{side}_ankle"] + covariance["pelvis"]
        along_sd = np.sqrt(np.einsum("ta,tab,tb->t", facing, spread, facing))
        for kind, point, sign in (("strike", heel, 1.0), ("off", ball, -1.0)):
            series = sign * np.einsum("ta,ta->t", feet[:, point] - pelvis, facing)
            for time, sd, index in turns(series, motion.times, along_sd, rate, known):
                events.append(GaitEvent(time, sd, side, kind, feet[index, point]))
    events.sort(key=lambda e: e.time)
    steps = _steps(events, motion, feet, facing, covariance)
    return Gait(tuple(events), tuple(steps), tuple(_figures(events, steps, motion, pelvis, known)))


def _moving(motion: Motion, joint: int) -> Array:
    """Return the covariance (T, 3, 3) of a joint without the part that is constant over the clip; at least 1 % of that
    part stays.
    """
    whole = np.array(motion.joint_covariance[:, joint], dtype=np.float64)
    if motion.systematic_covariance is None:
        return whole
    return whole - 0.99 * motion.systematic_covariance[:, joint].astype(np.float64)


def facing_of(rotations: Array, rate: float) -> Array:
    """Compute the smoothed horizontal direction (T, 3) that the pelvis faces; the model looks along -y.

    rotations: (T, 3, 3) world_from_pelvis.
    rate: Hz.
    """
    forward = -rotations[:, :, 1] * [1, 1, 0]
    smooth = uniform_filter1d(
        np.nan_to_num(forward), max(1, round(SETTINGS.gait_facing * rate)), axis=0, mode="nearest"
    )
    return smooth / np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-9)


def turns(
    series: Array, times: Array, sd: Array, rate: float, known: NDArray[np.bool_]
) -> list[tuple[float, float, int]]:
    """Find the maxima of a series of values over time; the time of each is refined by a parabola.

    series: (T,) m.
    times: (T,) s.
    sd: (T,) standard deviation of the series, m.
    rate: Hz.
    known: (T,) frames next to unknown ones give no maximum.
    Returns: time s, its standard deviation s, and frame of each maximum.
    """
    filled = np.where(np.isfinite(series), series, np.nanmin(series) if np.isfinite(series).any() else 0.0)
    from scipy.signal import find_peaks  # takes long to import

    peaks, _ = find_peaks(filled, distance=max(1, round(SETTINGS.gait_least_step * rate)))
    out = []
    reach = max(1, round(0.04 * rate))
    for k in peaks[_swings(filled, peaks)].tolist():
        a, b = k - reach, k + reach + 1
        if a < 0 or b > len(series) or not known[a:b].all():
            continue
        curve = np.polyfit(times[a:b] - times[k], filled[a:b], 2)
        if curve[0] >= 0:
            continue
        shift = float(np.clip(-curve[1] / (2 * curve[0]), -1 / rate, 1 / rate))
        speed_sd = np.sqrt(2) * sd[k] / SETTINGS.gait_correlation
        out.append(
            (
                float(times[k]) + shift,
                float(np.hypot(speed_sd / (2 * -curve[0]), SETTINGS.gait_between_frames / rate)),
                k,
            )
        )
    return out


def _swings(series: Array, peaks: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Select the peaks that stand out by a foot's swing on both sides, as far as the clip shows them."""
    from scipy.signal import peak_prominences

    _, *bases = peak_prominences(series, peaks)
    left, right = (series[b] for b in bases)
    tops = series[peaks]
    first = np.maximum.accumulate(series)[peaks] <= tops  # nothing before is higher
    last = np.maximum.accumulate(series[::-1])[::-1][peaks] <= tops
    needed = [np.where(edge, SETTINGS.gait_least_seen, SETTINGS.gait_least_swing) for edge in (first, last)]
    swing = np.maximum(tops - left, tops - right) >= SETTINGS.gait_least_swing
    return np.asarray(swing & (tops - left >= needed[0]) & (tops - right >= needed[1]))


def _steps(
    events: list[GaitEvent], motion: Motion, feet: Array, facing: Array, covariance: Mapping[str, Array]
) -> list[GaitStep]:
    strikes = [e for e in events if e.kind == "strike"]
    offs = {s: np.array([e.time for e in events if e.kind == "off" and e.side == s]) for s in ("left", "right")}
    heel = {"left": 0, "right": 2}
    out = []
    for before, now in zip(strikes, strikes[1:], strict=False):
        if before.side == now.side or now.time - before.time > 2.0:
            continue
        t = int(np.argmin(np.abs(motion.times - now.time)))
        across = np.array([-facing[t, 1], facing[t, 0], 0.0])
        apart = feet[t, heel[now.side]] - feet[t, heel[before.side]]
        both = covariance["left_ankle"][t] + covariance["right_ankle"][t] + 2 * SETTINGS.gait_heel_sd**2 * np.eye(3)
        left = offs[before.side]
        after = int(np.searchsorted(left, now.time, "right"))
        off = left[after] if after < len(left) else np.nan
        out.append(
            GaitStep(
                side=now.side,
                time=now.time,
                duration=now.time - before.time,
                duration_sd=float(np.hypot(before.sd, now.sd)),
                length=float(apart @ facing[t]),
                length_sd=float(np.sqrt(facing[t] @ both @ facing[t])),
                width=float(abs(apart @ across)),
                width_sd=float(np.sqrt(across @ both @ across)),
                double_support=float(off - now.time) if off - now.time < 0.6 else float("nan"),
            )
        )
    return out


def _figures(
    events: list[GaitEvent], steps: list[GaitStep], motion: Motion, pelvis: Array, known: NDArray[np.bool_]
) -> list[GaitFigure]:
    if len(steps) < 2:
        return []
    out = []

    def add(name: str, unit: str, values: list[float], sds: list[float]) -> None:
        v, s = np.array(values), np.array(sds)
        keep = np.isfinite(v)
        v, s = v[keep], s[keep]
        if not len(v):
            return
        # each value's own uncertainty, which neighbours share, and the spread between the steps
        spread = float(v.std(ddof=1)) if len(v) > 1 else 0.0
        error = 1.645 * float(np.hypot(spread / np.sqrt(len(v)), np.sqrt((s**2).mean()) / np.sqrt(max(1, len(v) / 2))))
        mean = float(v.mean())
        out.append(GaitFigure(name, unit, mean, spread, mean - error, mean + error, len(v)))

    for side in ("left", "right"):
        chosen = [s for s in steps if s.side == side]
        add(f"step_length_{side}", "m", [s.length for s in chosen], [s.length_sd for s in chosen])
    add("step_width", "m", [s.width for s in steps], [s.width_sd for s in steps])
    add("cadence", "steps/min", [60 / s.duration for s in steps],
        [60 * s.duration_sd / s.duration**2 for s in steps])  # fmt: skip
    add("double_support", "s", [s.double_support for s in steps], [s.duration_sd for s in steps])
    first, last = steps[0].time - steps[0].duration, steps[-1].time
    rows = (motion.times >= first) & (motion.times <= last) & known
    if rows.sum() > 2:
        way = np.linalg.norm(np.diff(pelvis[rows][:, :2], axis=0), axis=1).sum()
        add("speed", "m/s", [float(way / (last - first))], [steps[0].length_sd / (last - first)])
    return out


PERCENT = np.linspace(0.0, 100.0, 101)


@dataclass(frozen=True)
class AngleCycle:
    """Mean of one joint angle over the gait cycle.

    mean: (101,) rad, mean of n strides at 0 to 100 % of the cycle.
    sd: (101,) standard deviation between strides; NaN for one stride.
    uncertainty: (101,) standard deviation of the mean from tracking alone; NaN where not known.
    """

    name: str
    mean: Array
    sd: Array
    uncertainty: Array
    n: int


def strides(events: Sequence[GaitEvent], motion: Motion, side: str) -> list[tuple[float, float]]:
    """List the strides of one side, from strike to strike (s), in which all frames are known."""
    strikes = [e.time for e in events if e.side == side and e.kind == "strike"]
    known = ~(motion.lost | motion.extrapolated).astype(bool)
    if motion.poses is not None:
        known &= np.isfinite(motion.poses).all(1)
    out = []
    for a, b in zip(strikes, strikes[1:], strict=False):
        first, stop = np.searchsorted(motion.times, a), np.searchsorted(motion.times, b, "right")
        if SETTINGS.gait_stride_s[0] <= b - a <= SETTINGS.gait_stride_s[1] and first < stop and known[first:stop].all():
            out.append((a, b))
    return out


def angle_cycles(events: Sequence[GaitEvent], motion: Motion) -> list[AngleCycle]:
    """Compute the mean gait cycle of every joint angle; empty without a whole stride or without poses."""
    if motion.poses is None:
        return []
    _, values = joint_angles(motion.skeleton, motion.poses)
    given = motion.angle_sd if motion.angle_sd is not None else np.full(values.shape, np.nan)
    whole = {side: strides(events, motion, side) for side in ("left", "right")}
    out = []
    for k, name in enumerate(ANGLE_NAMES):
        spans = whole["left" if name.endswith("_l") else "right"]
        if is_length(name) or name == "pelvis_rotation" or not spans:  # the path of a person who walks has no cycle
            continue
        begin, end = np.array(spans).T[..., None]
        at = begin + PERCENT / 100 * (end - begin)
        curves, sds = (np.interp(at, motion.times, a[:, k]) for a in (values, given))
        # strides are longer than errors are correlated, so each counts as nearly independent
        apart = min(1.0, SETTINGS.gait_correlation / np.mean([b - a for a, b in spans]))
        count = max(1.0, len(spans) * (1 - apart) + apart)
        sd = curves.std(axis=0, ddof=1) if len(spans) > 1 else np.full(len(PERCENT), np.nan)
        uncertainty = np.sqrt((sds**2).mean(0) / count)
        out.append(AngleCycle(name, curves.mean(0), sd, uncertainty, len(spans)))
    return out
