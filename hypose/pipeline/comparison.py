"""Compare a motion with another motion of the same movement, joint by joint, after alignment in time and space.

The other motion is resampled at our times; its clock offset and its rigid placement are estimated (or given). The
remaining difference is split into a constant offset of each joint (two programs rarely mean the same point by a hip)
and an error. Offsets are constant in the segment that carries the joint, so they turn with the person.

Sources: rigid alignment of Umeyama (1991), iteratively reweighted; limits of agreement of Bland and Altman (1986): mean
    +- 1.96 standard deviations of the difference.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.joint_angles import is_length, joint_angles
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.keypoints import common_name
from hypose.fusion.register import robust_motion
from hypose.geometry import Array, transform
from hypose.io.files import text_lines
from hypose.io.motions.export import MOTION_FILES
from hypose.io.motions.marker_files import Markers
from hypose.io.motions.results import Archive
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_options import CompareOptions
from hypose.synthetic.metrics import CARRIERS, EVALUATED_JOINTS, coverage, joint_errors, population_offsets

# ---- compared files ------------------------------------------------------------------------------------------------
# Read motions of other programs: results of hypose, C3D, TRC, and MOT or STO of OpenSim, as points and angles with
# hypose's names.
#
# Points that are named like joints (RKnee, left_knee, LKJC) are those joints. Two markers on either side of a joint are
# its centre (r_knee_study and r_mknee_study of OpenCap's and Pose2Sim's augmenter; others by `joint=marker+marker`).


_SIDES = ("left", "right")
_PARTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True)
class OtherMotion:
    """Motion read from a file of any program, with which a motion of hypose is compared.

    times: (T,) s.
    points: (T, 3) m by joint name, NaN where not seen.
    angles: (T,) rad or m by OpenSim's name.
    notes: sentences on what was left out.
    """

    path: Path
    times: Array
    points: Mapping[str, Array] = field(default_factory=dict)
    angles: Mapping[str, Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_other(
    path: Path, joints: Mapping[str, Sequence[str]] | None = None, subject: str | None = None
) -> OtherMotion:
    """Read another motion to compare with: results of hypose, .c3d, .trc, .mot or .sto.

    joints: marker names by joint name, for markers whose names are not known; the mean of the markers is the joint.
    subject: person to read, where the file names points SUBJECT:POINT.
    Raises: InputError where no joint or angle is known, or where it is not clear which person is meant.
    """
    found = MOTION_FILES.read(path)
    if isinstance(found, Motion):
        points = {n: found.joints[:, i] for i, n in enumerate(found.skeleton.joint_names)}
        return OtherMotion(path, found.times, points, angles_of(found))
    if isinstance(found, tuple):
        if text_lines(path, "a motion")[0].strip().endswith("_sd"):
            raise InputError(f"{path} holds the standard deviations of angles; give the angles, motion.mot next to it.")
        times, names, values = found
        return OtherMotion(path, times, {}, {n: values[:, i] for i, n in enumerate(names)})
    markers: Markers = found
    names, kept = _of_subject(path, markers.names, subject)
    twice = {n for n in names if names.count(n) > 1}
    notes = (
        (f"{path.name} has several points of the name {', '.join(sorted(twice))}, which are left out.",)
        if twice
        else ()
    )
    single = [i for i, n in enumerate(names) if n not in twice]
    names, kept = tuple(names[i] for i in single), [kept[i] for i in single]
    points = _joints_of(path, names, markers.points[:, kept], joints or {})
    return OtherMotion(path, np.arange(len(markers.points)) / markers.frame_rate, points, notes=notes)


def angles_of(motion: Motion) -> dict[str, Array]:
    """Compute the joint angles (T,) rad (positions m) by OpenSim's name; empty where the motion has no poses."""
    if motion.poses is None:
        return {}
    names, values = joint_angles(motion.skeleton, motion.poses)
    return {n: values[:, i] for i, n in enumerate(names)}


def _of_subject(path: Path, names: tuple[str, ...], subject: str | None) -> tuple[tuple[str, ...], list[int]]:
    """Select the point names of one person, without the person's prefix, and their indices."""
    whose = {i: n.split(":")[0].strip() for i, n in enumerate(names) if ":" in n and not n.startswith("*")}
    people = list(dict.fromkeys(whose.values()))
    if subject is not None and subject not in people:
        known = f"of {', '.join(people)}" if people else "named without a subject"
        raise InputError(f"{path} has no points of {subject!r}, they are {known}; correct or leave out --subject.")
    if subject is None and len(people) > 1:
        raise InputError(f"{path} holds points of {', '.join(people)}; say who is meant: --subject {people[0]}.")
    kept = [i for i in range(len(names)) if subject is None or whose.get(i, subject) == subject]
    bare = [names[i].split(":")[-1].strip() if i in whose else names[i] for i in kept]
    return tuple(b if bare.count(b) == 1 else names[i] for b, i in zip(bare, kept, strict=True)), kept


def _joints_of(path: Path, names: tuple[str, ...], points: Array, given: Mapping[str, Sequence[str]]) -> dict:
    column = {n: i for i, n in enumerate(names)}
    lower = {n.lower().replace("r.", "r_").replace("l.", "l_"): n for n in names}
    # names of the augmenter: outer and inner side
    sides = {f"{s}_{p}": [f"{s[0]}_{p}_study", f"{s[0]}_m{p}_study"] for s in _SIDES for p in ("knee", "ankle")}
    pairs = {joint: [lower[m] for m in pair] for joint, pair in sides.items() if lower.keys() >= {*pair}}
    out: dict[str, Array] = {}
    for joint, markers in (pairs | dict(given)).items():
        markers = [m if m in column else m.split(":")[-1] for m in markers]
        missing = [m for m in markers if m not in column]
        if missing:
            shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
            raise InputError(f"{path} has no marker {missing[0]!r}; it has {shown}.")
        out[joint] = np.mean([points[:, column[m]] for m in markers], 0)
    for name, i in column.items():
        joint = _joint_name(name)
        if joint is not None and joint not in out:
            out[joint] = points[:, i]
    if not out:
        shown = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
        raise InputError(
            f"None of the points of {path} is called like a joint ({shown}); say which markers are one: --joint "
            "left_knee=LKNE+LKNM."
        )
    return out


def _joint_name(name: str) -> str | None:
    """Return the joint that a point is named after; None for other markers."""
    bare = name.split(":")[-1].strip()
    centre = re.fullmatch(r"([LR])([SEWHKA])JC(_study)?", bare, re.IGNORECASE)
    if centre:
        parts = {part[0]: part for part in _PARTS}
        return f"{'left' if centre[1].lower() == 'l' else 'right'}_{parts[centre[2].lower()]}"
    common = common_name(bare)
    if common in {f"{side}_{part}" for side in _SIDES for part in _PARTS}:
        return common
    return {"mid_hip": "pelvis", "neck": "neck", "head": "head"}.get(common if bare.lower() != "head" else "head")


_BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))


@dataclass(frozen=True)
class Agreement:
    """Agreement of one joint (mm) or one angle (degrees; mm for positions) between both motions.

    n: number of frames.
    median, p95, rmse: median, 95th percentile and root mean square of the distance; for angles of the absolute
        difference.
    offset: length of the constant part.
    median_left, p95_left, rmse_left: the same without the constant part.
    bias, low, high: mean difference (other - ours), and lower and upper limit of agreement (Bland-Altman) per axis
        (1 for angles, 3 for joints), after the rigid alignment, with the constant part.
    r: Pearson's correlation per axis.
    covered: share of frames in which the other lies in our confidence region, per level of SETTINGS.compare_levels,
        after the constant part; NaN where we have no region.
    """

    name: str
    unit: str
    n: int
    median: float
    p95: float
    rmse: float
    offset: float
    median_left: float
    p95_left: float
    rmse_left: float
    bias: Array
    low: Array
    high: Array
    r: Array
    covered: tuple[float, ...]


@dataclass(frozen=True)
class Comparison:
    """Result of the comparison of our motion with another one.

    times: (T,) our times, s.
    offset: seconds that were added to the other's times.
    ours_from_other: (4, 4) rigid transform.
    joints, angles: agreements.
    errors: (T, J) distances of the joints after the constant offset of each joint is removed, mm; NaN where not
        compared.
    notes: sentences for the user.
    """

    times: Array
    offset: float
    ours_from_other: Array
    joints: tuple[Agreement, ...]
    angles: tuple[Agreement, ...]
    errors: Array
    notes: tuple[str, ...]

    @property
    def left_mm(self) -> tuple[float, float, float]:
        """Median, 95th percentile and RMSE of all joints together without offsets, mm; NaN without joints."""
        found = self.errors[np.isfinite(self.errors)]
        return _spread(found) if len(found) else (float("nan"), float("nan"), float("nan"))


def compare_motions(ours: Motion, other: OtherMotion, options: CompareOptions | None = None) -> Comparison:
    """Compare our motion with the points and angles of another.

    Raises: InputError where both have no joint, angle or time in common.
    """
    o = options or CompareOptions()
    notes = list(other.notes)
    other = _in_metres(ours, _without_sentinels(other, notes), notes)
    our_angles = angles_of(ours)
    names = [n for n in ours.skeleton.joint_names if n in other.points]
    angle_names = [n for n in our_angles if n in other.angles]
    if not names and not angle_names:
        raise InputError(
            f"{other.path} and the result have no joint and no angle in common; say which markers are a joint: --joint "
            "left_knee=LKNE+LKNM."
        )
    used = np.ones(len(ours), dtype=bool) if o.all_frames else ~(ours.lost | ours.extrapolated).astype(bool)
    index = [ours.skeleton.joint(n) for n in names]
    mine = np.where(used[:, None, None], ours.joints[:, index], np.nan)
    theirs = _columns(other.points, names, (len(other.times), 3))
    my_angles = np.where(used[:, None, None], _columns(our_angles, angle_names, (len(ours), 1)), np.nan)
    their_angles = _columns(other.angles, angle_names, (len(other.times), 1))
    angles = [(my_angles, their_angles, 0.05)] if angle_names else []
    offset = o.offset
    if offset is None:
        offset, cost = _offset(ours.times, other.times, [*([(mine, theirs, 0.02)] if names else []), *angles], o.align)
        if o.align and names:
            mirrored = theirs * [1.0, -1.0, 1.0]
            turned, less = _offset(ours.times, other.times, [(mine, mirrored, 0.02), *angles], True)
            if less < 0.5 * cost:
                theirs, offset = mirrored, turned
                notes.append(f"The world of {other.path.name} is left-handed: it is mirrored before the comparison.")
    if abs(offset) > 0.5 * _frame(ours.times) and o.offset is None:
        late = "late" if offset < 0 else "early"
        notes.append(f"The other motion is {late} by {abs(offset):.3f} s, which is taken off.")
    at = ours.times - offset
    shown = resampled(other.times, theirs, at)
    motion = _rigid(shown, mine) if o.align else np.eye(4)
    moved = transform(motion, shown)
    if not np.isfinite(mine - moved).any() and names:
        raise InputError(
            f"{other.path} and the result have no time in common (offset {offset:.3f} s); give it with --offset."
        )
    notes += _unlike(mine, moved, o, other.path.name)
    joints, errors = _joints(ours, names, index, mine, moved)
    series = zip(np.moveaxis(my_angles, 1, 0), np.moveaxis(resampled(other.times, their_angles, at), 1, 0), strict=True)
    compared = [_angle(n, a, b) for n, (a, b) in zip(angle_names, series, strict=True)]
    left = sorted(set(other.points) - set(names))
    if left:
        notes.append(f"{len(left)} points of {other.path.name} are no joint of ours: {', '.join(left[:8])}.")
    return Comparison(
        ours.times, offset, motion, joints, tuple(a for a in compared if a is not None), errors, tuple(notes)
    )


def _columns(series: Mapping[str, Array], names: Sequence[str], shape: tuple[int, int]) -> Array:
    """Stack the series of some names: (T, N, D) for N names and a shape (T, D)."""
    return np.reshape([series[n] for n in names], (len(names), *shape)).swapaxes(0, 1)


def resampled(times: Array, points: Array, at: Array) -> Array:
    """Interpolate points (T, ..., D) linearly at other times (S, ..., D); NaN where the neighbours are not seen or too
    far apart in time.
    """
    p = np.asarray(points, dtype=np.float64)
    after = np.clip(np.searchsorted(times, at), 1, max(1, len(times) - 1))
    if len(times) < 2:
        return np.full((len(at), *p.shape[1:]), np.nan)
    t0, t1 = times[after - 1], times[after]
    share = (at - t0) / (t1 - t0)
    step = float(np.median(np.diff(times)))
    share = np.where(np.abs(share - np.round(share)) < 1e-6, np.round(share), share)
    near = (t1 - t0 <= max(SETTINGS.compare_longest_gap, 1.5 * step)) | (share == 0) | (share == 1)
    fine = (share >= 0) & (share <= 1) & near
    w = np.clip(share, 0, 1).reshape(-1, *[1] * (p.ndim - 1))
    # exactly on a frame its neighbour is not needed
    out = np.where(w <= 0, p[after - 1], np.where(w >= 1, p[after], (1 - w) * p[after - 1] + w * p[after]))
    return np.where(fine.reshape(w.shape), out, np.nan)


def _never_seen() -> warnings.catch_warnings:
    """Suppress numpy's warnings about medians and means of points that are never seen."""
    return warnings.catch_warnings(action="ignore", category=RuntimeWarning)


def _rigid(source: Array, target: Array) -> Array:
    """Estimate the rigid transform (4, 4) from source (T, J, 3) to target where both are seen, with robust weights."""
    both = np.asarray(np.isfinite(source).all(-1) & np.isfinite(target).all(-1))
    if both.sum() < 4:
        return np.eye(4)
    return robust_motion(source[both], target[both], np.ones(both.sum()), 8)[0]


def _unlike(mine: Array, moved: Array, o: CompareOptions, name: str) -> list[str]:
    """Return a sentence where both motions do not have the same joint movements; none where they do.

    mine, moved: (T, J, 3) joints of both, m.

    Only joints relative to each other are compared. Why: people who walk to the same places would seem to move alike.
    """
    seen = np.isfinite(mine).all(-1) & np.isfinite(moved).all(-1)
    seen &= (seen.sum(1) >= SETTINGS.compare_least_joints)[:, None]
    if seen.any(1).sum() < SETTINGS.compare_least_frames:
        return []

    def side_difference(points: Array) -> float:
        shown = np.where(seen[..., None], points, np.nan)
        with _never_seen():
            shown = shown - np.nanmean(shown, 1, keepdims=True)
            shown = shown - np.nanmedian(shown, 0)
        return float(np.sqrt((shown[seen] ** 2).sum(-1).mean()))

    left, moves = side_difference(moved - mine), side_difference(mine)
    if left <= SETTINGS.compare_apart_m or left**2 <= (1 - SETTINGS.compare_alike) * moves**2:
        return []
    tried = (
        f"At no offset within {SETTINGS.compare_most_lag:g} s" if o.offset is None else "At the offset that was given"
    )
    worlds = "" if o.align else ", or has another frame of reference (leave out --no-align)"
    return [
        f"{tried} do the joints of {name} move as ours do: relative to each other they move by {1000 * moves:.0f} mm, "
        f"and {1000 * left:.0f} mm are left. It is hardly the same movement, or exchanges left and right{worlds}; the "
        "figures say nothing of accuracy."
    ]


def _offset(
    times: Array, their_times: Array, series: Sequence[tuple[Array, Array, float]], align: bool
) -> tuple[float, float]:
    """Find the seconds to add to their times, at which joints and angles agree best apart from constant offsets.

    times, their_times: (T,) and (S,) s.
    series: joints (T, J, 3) of both, m, and angles (T, A, 1) of both, rad, each with the difference that costs 1.
    align: whether joints are aligned by a rigid motion.
    Returns: the seconds, and the cost there.
    """

    def cost(offset: float) -> float:
        found = []
        for mine, theirs, scale in series:
            shown = resampled(their_times, theirs, times - offset)
            if align and mine.shape[-1] == 3:
                shown = transform(_rigid(shown, mine), shown)
            d = shown - mine
            seen = np.asarray(np.isfinite(d).all(-1))
            if seen.sum() < max(8, 0.3 * np.isfinite(mine).all(-1).sum()):
                return np.inf
            d = d - np.nanmedian(np.where(seen[..., None], d, np.nan), 0)
            found.append(float(np.median(np.linalg.norm(d[seen], axis=-1))) / scale)
        return float(np.mean(found))

    with np.errstate(all="ignore"), _never_seen():
        step = _frame(times)
        same = times[0] - their_times[0]  # both began together
        lags = np.arange(-SETTINGS.compare_most_lag, SETTINGS.compare_most_lag + step, 2 * step)
        starts = np.unique(np.concatenate([lags, lags + same, [0.0, same]]))
        costs = np.array([cost(lag) for lag in starts])
        if not np.isfinite(costs).any():
            return 0.0, np.inf
        best = float(starts[np.argmin(costs)])
        near = best + step * np.linspace(-1.5, 1.5, 13)
        squares = np.array([cost(lag) for lag in near]) ** 2
        if np.isfinite(squares).all():
            # minimum of a parabola: interpolation between frames reduces noise, which would attract the minimum itself
            curve = np.polyfit(near - best, squares, 2)
            vertex = -curve[1] / (2 * curve[0]) if curve[0] > 0 else np.inf
            best += float(vertex) if abs(vertex) <= 1.5 * step else float(near[squares.argmin()] - best)
        plain = min((c for c in (cost(0.0), cost(same)) if np.isfinite(c)), default=np.inf)
    # a person who hardly moves does not determine the time
    if plain <= 1.1 * cost(best):
        best = 0.0 if cost(0.0) <= 1.1 * cost(best) else same
    return best, cost(best)


def _frame(times: Array) -> float:
    """Return the duration of a frame, s."""
    return max(float(np.median(np.diff(times))), 1 / 120) if len(times) > 1 else 0.02


def _without_sentinels(other: OtherMotion, notes: list[str]) -> OtherMotion:
    """Set positions to NaN that stand for "not seen": the same three numbers, to the last digit, in many frames."""
    points, dropped = dict(other.points), list[str]()
    for name, p in other.points.items():
        _, which, count = np.unique(p, axis=0, return_inverse=True, return_counts=True, equal_nan=True)
        fixed = (count > max(SETTINGS.compare_sentinel_frames, SETTINGS.compare_sentinel_share * len(p)))[
            which.ravel()
        ] & np.isfinite(p).all(1)
        if fixed.any():
            points[name] = np.where(fixed[:, None], np.nan, p)
            dropped.append(f"{name} in {fixed.sum()} frames")
    if dropped:
        listed = ", ".join(dropped[:4])
        notes.append(f"{other.path.name}: positions that repeat to the last digit count as not seen ({listed}).")
    return replace(other, points=points)


def _in_metres(ours: Motion, other: OtherMotion, notes: list[str]) -> OtherMotion:
    """Rescale the other's points where its bones show that they are in a wrong unit."""
    bones = [(f"{side}_{a}", f"{side}_{b}") for side in _SIDES for a, b in _BONES]
    ratios = []
    with _never_seen():
        for a, b in bones:
            if a in other.points and b in other.points and {a, b} <= set(ours.skeleton.joint_names):
                i, j = ours.skeleton.joint(a), ours.skeleton.joint(b)
                own = np.nanmedian(np.linalg.norm(ours.joints[:, i] - ours.joints[:, j], axis=-1))
                ratios.append(np.nanmedian(np.linalg.norm(other.points[a] - other.points[b], axis=-1)) / own)
    ratio = max(float(np.nanmedian(ratios)), 1e-9) if np.isfinite(ratios).any() else 1.0
    factor = min(SETTINGS.compare_wrong_units, key=lambda f: abs(np.log(ratio / f)))
    if factor != 1 and abs(np.log(ratio / factor)) < SETTINGS.compare_alike_lengths:
        notes.append(
            f"The bones of {other.path.name} are {ratio:.3g} times as long as ours: its unit is not what it states, "
            f"and its points are divided by {factor:g}."
        )
        return replace(other, points={n: p / factor for n, p in other.points.items()})
    if abs(np.log(ratio)) > SETTINGS.compare_alike_lengths:
        notes.append(f"The bones of {other.path.name} are {ratio:.3g} times as long as ours: another unit or person.")
    return other


def _joints(ours: Motion, names: list[str], index: list[int], mine: Array, moved: Array) -> tuple[tuple, Array]:
    """Compute the agreement of each joint, and the distances (T, J) mm without the constant offsets."""
    difference = moved - mine
    seen = np.asarray(np.isfinite(difference).all(-1))
    difference = np.where(seen[..., None], difference, np.nan)
    axes = _segment_axes(ours, index)  # (T, J, 3, 3) world from the segment that carries the joint
    local = np.einsum("tjba,tjb->tja", axes, difference)
    with _never_seen():
        offsets = np.nan_to_num(np.nanmedian(local, 0))
    constant = np.einsum("tjab,jb->tja", axes, offsets)
    covariance = np.array(ours.joint_covariance, dtype=np.float64)[:, index]
    covariance[~np.isfinite(covariance).all((-1, -2))] = np.nan
    inside = coverage(mine, covariance, moved - constant, SETTINGS.compare_levels)
    covered = np.stack([inside[level] for level in SETTINGS.compare_levels], 1)
    found = [
        _agreement(n, "mm", 1e3 * mine[:, j], 1e3 * moved[:, j], 1e3 * constant[:, j], tuple(covered[j].tolist()))
        for j, n in enumerate(names)
    ]
    return tuple(a for a in found if a is not None), 1000 * np.linalg.norm(difference - constant, axis=-1)


def _segment_axes(ours: Motion, index: list[int]) -> Array:
    """Compute the rotation (T, J, 3, 3) world_from_segment of the segment that carries each joint; identity where the
    motion has no poses.
    """
    skeleton = ours.skeleton
    if ours.poses is None or tuple(skeleton.joint_names) != tuple(JOINT_NAMES):
        return np.broadcast_to(np.eye(3), (len(ours), len(index), 3, 3))
    finite = np.asarray(np.isfinite(ours.poses).all(1))
    axes = np.full((len(ours), len(JOINT_NAMES), 3, 3), np.nan)
    axes[finite] = skeleton.forward(ours.poses[finite])[0]
    return axes[:, CARRIERS[index]]


def _angle(name: str, mine: Array, theirs: Array) -> Agreement | None:
    """Compute the agreement of one angle (T, 1) rad, or position (T, 1) m; None with fewer than three common frames."""
    scale, unit = (1000.0, "mm") if is_length(name) else (180 / np.pi, "deg")
    known = np.isfinite(theirs - mine)
    if not known.any():
        return None
    if unit == "deg":
        theirs = theirs - 2 * np.pi * np.round(np.median((theirs - mine)[known]) / (2 * np.pi))
    constant = np.full(mine.shape, np.median((theirs - mine)[known]))
    unknown = (float("nan"),) * len(SETTINGS.compare_levels)
    return _agreement(name, unit, scale * mine, scale * theirs, scale * constant, unknown)


def _agreement(
    name: str, unit: str, mine: Array, theirs: Array, constant: Array, covered: tuple[float, ...]
) -> Agreement | None:
    """Compute the agreement of one joint or angle; None with fewer than three frames in common.

    name, unit: name and unit of the joint or angle.
    mine, theirs: (T, D) in that unit, NaN where not known.
    constant: (T, D) constant part of theirs - mine.
    covered: share of frames in the confidence region, per level.
    """
    rows = np.isfinite(theirs - mine).all(1)
    if rows.sum() < 3:
        return None
    mine, theirs, constant = mine[rows], theirs[rows], constant[rows]
    d = theirs - mine
    bias, sd = d.mean(0), d.std(0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        a, b = mine - mine.mean(0), theirs - theirs.mean(0)
        r = (a * b).sum(0) / np.sqrt((a**2).sum(0) * (b**2).sum(0))
    whole, left = (_spread(np.linalg.norm(x, axis=1)) for x in (d, d - constant))
    offset, width = float(np.linalg.norm(constant[0])), 1.96 * sd
    return Agreement(name, unit, len(d), *whole, offset, *left, bias, bias - width, bias + width, r, covered)


def _spread(values: Array) -> tuple[float, float, float]:
    """Compute median, 95th percentile and root mean square."""
    return float(np.median(values)), float(np.percentile(values, 95)), float(np.sqrt((values**2).mean()))


# ---- truth ---------------------------------------------------------------------------------------------------------
# Comparison of a tracked motion with the truth.npz of a synthetic recording (`hypose synth`, `hypose demo`).


_MAX_BYTES = 1 << 30
"""Largest unpacked size of a truth.npz."""
_TRUTH_NOTE = (
    "The truth is another body (its shape does not come from the tracker's), so joint definitions are aligned once by "
    "fixed offsets, measured between the mean bodies and not on this recording."
)


@dataclass(frozen=True)
class Truth:
    """Comparison of a tracked motion with the true motion of a synthetic recording.

    names: (K) names of the compared joints.
    note: how the distances are measured.
    distances: (T, K) distances between true and tracked joints, m.
    joints: (T, J, 3) true joints of the human body, m, world; the first is the pelvis.
    """

    names, note = EVALUATED_JOINTS, _TRUTH_NOTE
    distances: Array
    joints: Array

    @property
    def mean_mm(self) -> float:
        """Mean distance over frames and joints, mm."""
        return float(np.nanmean(self.distances)) * 1000


def compare_with_truth(path: str | Path, motion: Motion, first: int = 0) -> Truth:
    """Compare a motion with the true motion of a synthetic recording.

    path: file truth.npz.
    first: frame of the recording that is row 0 of the motion.

    Raises: InputError where the file is no truth of hypose, or the motion has no poses.
    """
    kind = Archive("truth", "make the recording again", packed=_MAX_BYTES)
    joints, stature = kind.load(
        Path(path), lambda a: (a["joints"].astype(np.float64), float(a["stature"])), ("joints", "stature")
    )
    if motion.poses is None:
        raise InputError("The motion holds joint positions only and cannot be compared; track again.")
    joints = joints[first : first + len(motion)]
    found = motion.joints[: len(joints)]
    rotations, _ = motion.skeleton.forward(motion.poses[: len(joints)])
    errors = joint_errors(found, joints, population_offsets(human()) * stature, rotations)
    return Truth(errors, joints)
