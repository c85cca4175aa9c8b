"""Calibration of cameras from one walking person and the person's height, without a board or measured points.

The start comes from `two_views`: time offsets from the epipolar geometry of pairs, a rig chained from essential
matrices, and trial focal lengths where they are unknown. Bundle adjustment of points then refines the rig, and its
derivatives correct the offsets.
Ambiguous recordings are refused. Steady walking in a circle looks the same from cameras that are rotated about its
centre and late by a stride. So the start is also made with the second best offsets, and these must be clearly worse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.default_body import human
from hypose.calibration.refine_points import (
    MARKS,
    CameraUnknowns,
    PointBundle,
    adjust,
    default_scale,
    scale_rig,
    transform_rig,
)
from hypose.calibration.sync_motion import Curves, point_sd, solve_offsets
from hypose.calibration.two_views import (
    FOCAL_FACTORS,
    LOOSE_PX,
    SEEN_CONFIDENCE,
    epipolar_curves,
    on_common_clock,
    rival_offsets,
    start_rig,
)
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.errors import CalibrationError, refuse
from hypose.evidence.keypoints import landmark_of
from hypose.geometry import Array, frame_of, se3, skew, unit
from hypose.tracking.subject import shape_from_keypoints

WALK = "film a person who walks about irregularly, turns both ways and raises an arm now and then, for 20 s"
_MOMENTS, _STEP = 120, 2.0  # number of frames that are used; number of frames over which a point's speed is computed
_WIDER = 6  # number of searches for offsets, each with twice the range of the one before
_CLEAR, _CLOSE, _DUEL = 0.65, 0.3, 0.1  # depth of a clear minimum; nearness and least excess of alternatives
_FEWEST_S, _SHORT_S, _SPREAD_M, _DOUBT = 1.0, 10.0, 0.25, 3.0  # approximate results; their sd are multiplied by _DOUBT
_ANGLE_DEG, _NARROW_DEG, _RESIDUAL, _FOCAL_SD, _PLACE_SD = (
    10.0,
    25.0,
    0.025,
    0.08,
    0.3,
)  # refused results; the residual in person's sizes
_UNSURE_FOCAL = 0.025  # sd of a focal length above which the result is approximate
_HEAD = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_FEET = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("heel", "big_toe", "small_toe", "ankle"))


@dataclass(frozen=True)
class PersonCalibration:
    """The result of a calibration from a person.

    rig: calibrated cameras, m, z up, floor at 0.
    late: (C,) delay of each view against the median view, frames.
    sds: standard deviations of cameras and offsets.
    median_px: median residual, px.
    approximate: sentences about results that are poorly determined.
    """

    rig: CameraRig
    late: Array
    sds: Uncertainty
    median_px: float
    approximate: tuple[str, ...]


def calibrate_from_person(
    points: Array,
    names: Sequence[str],
    lenses: CameraRig,
    height: float,
    frame_rate: float,
    *,
    lenses_known: bool,
    largest_s: float | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> PersonCalibration:
    """Calibrate cameras, time offsets, vertical direction and floor from the key points of one person.

    points: (C, T, K, 3) px of the stored pictures, and confidence.
    names: K names of the key points.
    lenses: cameras whose poses are ignored; their lenses are used as they are where lenses_known, else as a start.
    height: height of the person, m.
    frame_rate: frames/s.
    largest_s: largest offset that is searched, s; None for one second, and more where that is not enough.
    progress: called with stage, number done and total.
    Raises: CalibrationError with the reason and a remedy, where the cameras cannot be determined.
    """
    if len(points) < (2 if lenses_known else 3):
        raise CalibrationError(
            "Cameras are found from three views, or from two whose focal lengths are known: give these with "
            "--intrinsics FILE or --focal PIXELS, or film with a third camera."
        )
    search = _Search(points, tuple(names), lenses, height, frame_rate, lenses_known, progress)
    rig, late = search.start(largest_s)
    rig, world, median_px, sds = search.refine(rig, late)
    for k in range(3):
        progress("refine", k, 3)
        late = late + sds.later
        rig, world, median_px, sds = search.refine(rig, late)
    progress("refine", 3, 3)
    return search.judged(rig, late - np.median(late), world, median_px, sds)


class _Search:
    """A running calibration. Frames of the common clock are those of the median view."""

    def __init__(
        self,
        raw: Array,
        names: tuple[str, ...],
        lenses: CameraRig,
        height: float,
        frame_rate: float,
        known: bool,
        progress: Callable[[str, int, int], None],
    ) -> None:
        self.raw, self.names, self.lenses, self.height = raw, names, lenses, height
        self.frame_rate, self.known, self.progress = frame_rate, known, progress
        self.points = self.undistorted(lenses)
        self.sd = point_sd(raw[..., :2], raw[..., 2]) / 1.6  # 1 % of the person's size

    def undistorted(self, rig: CameraRig) -> Array:
        """Undistort the key points with the lenses of a rig."""
        pixels = [c.undistort_points(p[..., :2]) for c, p in zip(rig, self.raw, strict=True)]
        return np.concatenate([pixels, self.raw[..., 2:]], -1)

    def moments(self, late: Array) -> NDArray[np.int64]:
        """Choose evenly spread frames of the common clock that all views have; late (C,) delay, frames."""
        first, last = np.ceil(max(0, -late.min())), np.floor(self.raw.shape[1] - 1 - max(0, late.max()))
        if last - first < _FEWEST_S * self.frame_rate:
            raise CalibrationError(
                f"The views have {max(last - first, 0) / self.frame_rate:.1f} s in common, which is too little; {WALK}."
            )
        return np.unique(np.linspace(first, last, _MOMENTS).round().astype(np.int64))

    # ---- start

    def start(self, largest_s: float | None) -> tuple[CameraRig, Array]:
        """Find a start rig of arbitrary scale, and offsets; CalibrationError where other offsets fit equally well."""
        curves = self.curves(largest_s)
        late = solve_offsets(curves, len(self.raw)).frames
        best = self.rig(late)
        if not self.known:  # essential matrices determine offsets better than fundamental ones
            curves = epipolar_curves(self.points, [c.K for c in best[1]], self.sd, int(curves.lags[-1]))
            late = solve_offsets(curves, len(self.raw)).frames
        rival = rival_offsets(curves, late)
        if rival is None or rival[0] > _CLOSE:
            return best[1], late
        other = rival[1] - np.median(rival[1])
        costs = [self.rig(x, best[1])[0] for x in (late, other)]
        if max(costs) < (1 + _DUEL) * min(costs):
            away = float(np.ptp(other - late)) / self.frame_rate
            raise CalibrationError(
                f"The recording does not tell how late the cameras are: offsets that differ by {away:.1f} s, with "
                f"cameras at other places, explain it as well; {WALK}, or say with --largest 0.25 that the videos "
                "start within a quarter of a second."
            )
        late = late if costs[0] < costs[1] else other
        return self.rig(late)[1], late

    def curves(self, largest_s: float | None) -> Curves:
        """Compute epipolar curves over a range of offsets that grows until pairs with a clear minimum connect all
        views.
        """
        largest = max(4, round((largest_s or 1.0) * self.frame_rate))
        lenses = [c.K for c in self.lenses] if self.known else None
        tried: list[Curves] = []
        for k in range(1 if largest_s else _WIDER):
            self.progress("offsets", k, _WIDER)
            tried.append(epipolar_curves(self.points, lenses, self.sd, largest))
            group = np.arange(len(self.raw))
            for (a, b), cost in zip(tried[-1].pairs, tried[-1].cost, strict=True):
                inside = abs(tried[-1].lags[cost.argmin()]) < largest - 2  # at the end the minimum may be farther away
                if inside and cost.min() < _CLEAR * np.median(cost):
                    group[group == group[b]] = group[a]
            if (group == group[0]).all():
                return tried[-1]
            largest = min(2 * largest, self.raw.shape[1] // 2)
            if largest <= tried[-1].lags[-1]:
                break
        return tried[0]

    def rig(self, late: Array, lenses: CameraRig | None = None) -> tuple[float, CameraRig]:
        """Find the start rig with the lowest cost at given offsets, and its cost; lenses: source of the focal
        lengths.
        """
        points = on_common_clock(self.points, late, self.moments(late))
        factors = FOCAL_FACTORS if lenses is None and not self.known else (1.0,)
        found = []
        for k, factor in enumerate(factors):
            self.progress("start", k, len(factors))
            wider = np.array([[factor, factor, 1.0], [factor, factor, 1.0], [1.0, 1.0, 1.0]])
            rig = CameraRig(tuple(replace(c.pinhole(), K=c.K * wider) for c in lenses or self.lenses))
            found += start_rig(points, rig, self.sd)
        if not found:
            raise CalibrationError(f"The views have too little of the person in common to find the cameras; {WALK}.")
        return min(found, key=lambda f: f[0])

    # ---- refinement

    def scale(self, points: Array) -> float:
        """Compute the factor that scales points (N, 3) to a person of the given height."""
        shape = shape_from_keypoints(human(), points.reshape(-1, len(self.names), 3), self.names)
        return self.height / (shape.scale * human().stature)

    def refine(self, rig: CameraRig, late: Array) -> tuple[CameraRig, Array, float, Uncertainty]:
        """Refine the rig with all points at given offsets.

        Returns: the rig in metres, its points (F, K, 3), the median residual, the uncertainty.
        """
        frames, free = self.moments(late), not self.known
        shown = [on_common_clock(p, late, frames) for p in (self.undistorted(rig), self.raw if free else self.points)]
        (uv, _), (given, seen) = ((p.reshape(len(rig), -1, 3)[..., :2], p[..., 2].reshape(len(rig), -1)) for p in shown)
        seen = np.where(seen > SEEN_CONFIDENCE, 1.0, 0.0)
        rough = scale_rig(rig, self.scale(triangulate(rig, uv, seen)[0])).pinhole()
        found = adjust(rough, given, seen, focal=free, radial=free, hold=LOOSE_PX, iterations=60)
        factor = self.scale(found.points)
        new, points = scale_rig(found.rig, factor), found.points * factor
        keep = (seen > 0).sum(0) >= 2
        unknowns = CameraUnknowns(new, free, None, free, LOOSE_PX)
        bundle = PointBundle(given[:, keep], seen[:, keep], default_scale(given, seen), unknowns)
        near = (on_common_clock(self.points, late + d, frames).reshape(len(rig), -1, 3) for d in (-_STEP, _STEP))
        before, after = (p[:, keep] for p in near)
        both = ((before[..., 2] > SEEN_CONFIDENCE) & (after[..., 2] > SEEN_CONFIDENCE))[..., None]
        velocity = np.where(both, (after - before)[..., :2] / (2 * _STEP), 0.0)
        moment, kind = np.divmod(np.flatnonzero(keep), len(self.names))
        limbs = [next((k for k, words in enumerate(_PARTS) if any(w in n for w in words)), 3) for n in self.names]
        sds = uncertainty(bundle, points[keep], velocity, np.stack([moment, kind, np.array(limbs)[kind]], 1))
        known = zip(new, self.lenses, strict=True)
        new = new if free else CameraRig(tuple(replace(c, distortion=d.distortion) for c, d in known))
        return new, points.reshape(len(frames), -1, 3), found.median_px, sds

    # ---- checks of the result

    def judged(
        self, rig: CameraRig, late: Array, points: Array, median_px: float, sds: Uncertainty
    ) -> PersonCalibration:
        """Put the rig on its floor and assemble the result.

        rig: cameras in metres, in any world.
        late: (C,) delay against the median view, frames.
        points: (F, K, 3) m, the person.
        median_px: median residual, px.
        sds: uncertainty.
        Raises: CalibrationError where the uncertainty is too large.
        """
        middle = np.nanmedian(points.reshape(-1, 3), axis=0)
        rays = unit(middle - rig.positions)
        widest = float(np.degrees(np.arcsin(np.linalg.norm(np.cross(rays[:, None], rays), axis=-1).max())))
        share, (focal, place) = median_px / (100 * self.sd), (x.argmax() for x in (sds.focal, sds.place_m))
        faults = {
            f"All cameras look from nearly the same side (within {widest:.0f} degrees): put one of them elsewhere": (
                widest < _ANGLE_DEG
            ),
            f"The views do not agree on one person: the median residual is {100 * share:.1f} % of the person's size; "
            "see whether the key points are one person's in all views, and whether the cameras stood still": (
                share > _RESIDUAL
            ),
            f"{rig.names[focal]}: the focal length stays uncertain by {100 * sds.focal[focal]:.0f} %; give focal "
            f"lengths with --intrinsics FILE or --focal PIXELS, or {WALK}": sds.focal[focal] > _FOCAL_SD,
            f"{rig.names[place]}: its place stays uncertain by {sds.place_m[place]:.1f} m; {WALK}": (
                sds.place_m[place] > _PLACE_SD
            ),
        }
        refuse("", faults, CalibrationError)
        path = np.nanmedian(points, axis=1)
        path = float(np.sqrt(np.linalg.eigvalsh(np.cov(path[np.isfinite(path).all(1)].T))[-1]))
        seconds = self.raw.shape[1] / self.frame_rate
        up, floor, upright = self.upright(points, self.moments(late))
        doubts = [
            (
                len(rig) == 3 and not self.known,
                "three cameras hardly tell their focal lengths: give them with --intrinsics FILE or --focal PIXELS",
            ),
            (path < _SPREAD_M, f"the person stays within {path:.2f} m, which hardly tells places and offsets"),
            (widest < _NARROW_DEG, f"all cameras look from one side (within {widest:.0f} degrees)"),
            (seconds < _SHORT_S, f"{seconds:.1f} s are short: film 20 s"),
        ]
        more = _DOUBT if any(true for true, _ in doubts) else 1.0
        doubts += [
            (
                more * sds.focal[focal] > _UNSURE_FOCAL,
                f"{rig.names[focal]}: the focal length stays uncertain by {100 * more * sds.focal[focal]:.1f} %, and "
                f"places by up to {1e3 * more * sds.place_m[place]:.0f} mm: give --focal PIXELS, or {WALK}",
            ),
            (
                not upright,
                "the vertical is not measured, because the feet stay in one place: up is where the person's trunk "
                "points on average, which is wrong when the person leans",
            ),
        ]
        if upright:  # limbs and the head's height above the floor determine the scale equally well
            head = [k for k, n in enumerate(self.names) if n in _HEAD]
            tall = float(np.median(np.nanmedian(points[:, head] @ up - floor, axis=0) / self.rest()[head]))
            rig, middle, floor = scale_rig(rig, tall**-0.5), middle * tall**-0.5, floor * tall**-0.5
        turn = frame_of(up, rig[0].camera_from_world[0, :3]).T[[1, 2, 0]]  # x to the right of the first camera
        world = se3(turn, -np.array([*(turn @ middle)[:2], floor]))
        sds = replace(sds, **{key: more * getattr(sds, key) for key in ("turn_deg", "place_m", "focal", "late")})
        approximate = tuple(sentence for true, sentence in doubts if true)
        return PersonCalibration(transform_rig(rig, world), late, sds, median_px, approximate)

    def rest(self) -> Array:
        """Compute the height (K,) of key points above the floor for a standing person of the given height, m."""
        body = human()
        joint, offset, _ = landmark_of(self.names, body)
        sole = body.skin(np.zeros(len(body.skeleton.lower)))[:, 2].min()
        return self.height / body.stature * ((body.skeleton.rest_joints[joint] + offset)[:, 2] - sole)

    def upright(self, points: Array, frames: NDArray[np.int64]) -> tuple[Array, float, bool]:
        """Estimate the vertical and the floor.

        points: (F, K, 3) m, the person, NaN where missing.
        frames: (F,) frame of the common clock of each.
        Returns: up (3,), the floor's height along it, m, and whether feet on the floor define it, not the trunk.
        """
        ends = [[self.names.index(f"{side}_{part}") for side in ("left", "right")] for part in ("ankle", "shoulder")]
        up = unit(np.nanmean(points[:, ends[1]] - points[:, ends[0]], axis=(0, 1)))
        feet = [k for k, n in enumerate(self.names) if n in _FEET]
        places = points[:, feet]
        speed = np.linalg.norm(np.gradient(places, axis=0), axis=-1) * self.frame_rate / (frames[1] - frames[0])
        still = (speed < 0.6) & np.isfinite(places).all(-1)
        weight, places = still.astype(float), np.nan_to_num(places)
        normal, width = up, 0.0
        for _ in range(15 if still.sum() > 30 else 0):  # a plane per key point, all parallel
            total = np.maximum(weight.sum(0), 1e-9)
            centred = places - (weight[..., None] * places).sum(0) / total[:, None]
            values, vectors = np.linalg.eigh(np.einsum("fk,fki,fkj->ij", weight, centred, centred))
            normal = vectors[:, 0] * np.sign(vectors[:, 0] @ up)
            width = float(np.sqrt(values[1] / weight.sum()))
            weight = still / (1 + (centred @ normal / 0.03) ** 2)
        up = normal if width > _SPREAD_M else up
        above = np.where(still, places @ up - self.rest()[feet], np.nan)
        floor = float(np.nanmedian(above)) if still.any() else float(np.nanmin(points @ up))
        return up, floor, width > _SPREAD_M


# ---- uncertainty ----
# The uncertainty of cameras that were found from a moving person: a sandwich covariance.
# The errors of a detector are far from independent: a joint is set too high in one view all the time, and a whole arm
# is misplaced for some frames. Scores are therefore summed over clusters, (view, key point) and (view, limb, block of
# time), before they are squared; plain Hessians give several times too little. Source: Huber 1967; White 1980; Cameron,
# Gelbach & Miller 2011, "Robust inference with multiway clustering" (here the two clusterings are added, which is the
# cautious side).


_BLOCK = 12  # consecutive instants with correlated errors
# words in the names of key points by which they belong to the head, an arm or a leg; the others belong to the trunk
_PARTS = (
    ("nose", "eye", "ear", "head", "mouth"),
    ("elbow", "wrist", "pinky", "index", "thumb", "hand"),
    ("knee", "ankle", "toe", "heel", "foot"),
)


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviations of C cameras after the rig is aligned with the truth by a similarity.

    turn_deg: (C,) rotation, degrees.
    place_m: (C,) position, m.
    focal: (C,) share of the focal length; 0 where it is given.
    late: (C,) offset, frames.
    later: (C,) correction of the offsets that the residuals suggest, frames; the bundle adjustment takes the offsets as
        given.
    """

    turn_deg: Array
    place_m: Array
    focal: Array
    late: Array
    later: Array


def uncertainty(bundle: PointBundle, points: Array, velocity: Array, labels: Array) -> Uncertainty:
    """Compute the uncertainty of cameras and offsets at a solution of `adjust`, as a sandwich covariance with clusters.

    bundle: the least-squares problem, which starts at the solution.
    points: (N, 3) m.
    velocity: (C, N, 2) velocity of the detections, px per frame, because the offsets are unknown as well.
    labels: (N, 3) instant, key point and limb of each point.
    """
    cameras = bundle.unknowns.start
    count, n, size = len(cameras), len(points), bundle.count + 1
    jc, jp, r = np.zeros((n, count, 2, count, size)), np.zeros((n, count, 2, 3)), np.zeros((n, count, 2, 1))
    groups = se3(np.eye(3), points)
    for c, (camera, s) in enumerate(zip(cameras, bundle.slices, strict=True)):
        at = bundle.o.group[s]
        jc[at, c, :, c, :-1], jp[at, c], r[at, c, :, 0], root = bundle.derivatives(camera, groups, s)
        jc[at, c, :, c, -1] = -velocity[c, at] * root[:, None]
    jc, jp = jc.reshape(n, 2 * count, -1), jp.reshape(n, -1, 3)
    back = np.swapaxes(jp, 1, 2)
    rest = jc - jp @ np.linalg.solve(back @ jp + 1e-3 * np.eye(3), back @ jc)  # the points are eliminated
    score = (rest.reshape(n, count, 2, -1) * r).sum(2)
    held = np.tile(np.r_[bundle.unknowns.hold, 1e-3], count)
    hessian = np.einsum("nrs,nrt->st", jc, rest, optimize=True) + np.diag(held + 1e-6 * ((jc**2).sum((0, 1)) + held))
    moment, kind, limb = labels.T
    middle = np.zeros_like(hessian)
    for ids in (kind, limb + 4 * (moment // _BLOCK)):
        sums = np.zeros((int(ids.max()) + 1, count, count * size))
        np.add.at(sums, ids, score)
        rows = sums.reshape(-1, count * size)
        used = int(np.any(rows != 0, axis=1).sum())
        middle += rows.T @ rows * used / max(used - count * size, used / 4)
    inverse = np.linalg.inv(hessian)
    free = _without_gauge(list(cameras), points, size)
    sd = np.sqrt(np.maximum(np.diag(free @ inverse @ middle @ inverse @ free.T), 0)).reshape(count, size)
    focal = sd[:, 6] if bundle.unknowns.focal else np.zeros(count)
    turn, place = (np.linalg.norm(sd[:, k : k + 3], axis=1) for k in (0, 3))
    later = -(free @ inverse @ score.sum((0, 1))).reshape(count, size)[:, -1]
    return Uncertainty(np.degrees(turn), place, focal, np.hypot(sd[:, -1], later), later)


def _without_gauge(cameras: Sequence[Camera], points: Array, size: int) -> Array:
    """Compute the projection of the cameras' unknowns that removes what pictures do not determine: a motion and the
    scale of the whole world, and the start of the common clock.

    cameras: C cameras.
    points: (N, 3) m, points of the person.
    size: number of unknowns of a camera, the offset included.
    Returns: (S, S) with S = C size.
    """
    count = len(cameras)
    middle = np.median(points, axis=0)
    reach = float(np.median([np.linalg.norm(c.position - middle) for c in cameras]))
    # as `gauge` compares cameras
    j = np.concatenate([np.concatenate([-skew(reach * mark), np.eye(3)], 1) for mark in MARKS])
    free = np.zeros((count, size, 8))
    metric = np.zeros((count, size, count, size))
    for c, camera in enumerate(cameras):
        turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        free[c, :3, :3], free[c, 3:6, :3], free[c, 3:6, 3:6] = -turn, -skew(shift) @ turn, -turn
        free[c, 3:6, 6], free[c, -1, 7] = shift, 1.0
        metric[c, :6, c, :6], metric[c, -1, c, -1] = j.T @ j, 1.0
    free, metric = free.reshape(count * size, 8), metric.reshape(count * size, -1)
    return np.eye(count * size) - free @ np.linalg.solve(free.T @ metric @ free, free.T @ metric)
