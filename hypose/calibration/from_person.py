"""Cameras from one person who walks about, and the person's height: no board, no measured points.

The start is `two_views`: offsets from the epipolar geometry of pairs, a rig chained from essential matrices, focal
lengths tried where they are unknown. Synchronisation and bundle adjustment are those that refine a rig which is known.
What such a recording cannot tell is refused: steady walking in a circle looks the same from cameras that are turned
about its middle and late by a stride, so the start is made at the second best offsets as well and has to be clearly
worse there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.ready_bodies import human
from hypose.calibration.person_uncertainty import Uncertainty, limbs_of, uncertainty
from hypose.calibration.refine_points import (
    CameraUnknowns,
    PointBundle,
    adjust,
    default_scale,
    in_world,
    rescaled,
)
from hypose.calibration.sync_motion import Curves, keypoint_curves, solve_offsets
from hypose.calibration.synchronisation import point_sd
from hypose.calibration.two_views import (
    FACTORS,
    LOOSE,
    SEEN,
    Start,
    detection_sd,
    epipolar_curves,
    on_common_clock,
    rival_offsets,
    start_rig,
    with_focal,
)
from hypose.cameras.camera import CameraRig, triangulate
from hypose.errors import CalibrationError, EvidenceError
from hypose.evidence.keypoints import landmark_of
from hypose.geometry import Array, rotation_between, se3
from hypose.tracking.subject import shape_from_keypoints

ADVICE = (
    "film somebody who walks about irregularly, turns both ways and raises an arm now and then for 20 s, or say with "
    "--largest 0.25 that the videos start within a quarter of a second"
)
_MOMENTS = 120
_STEP = 2.0  # frames over which a point's speed is taken
_HEAD = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_FEET = ("heel", "big_toe", "small_toe", "ankle")


@dataclass(frozen=True)
class PersonSettings:
    """focal_known: focal lengths are right, and lens distortion is part of the cameras; focal_hold: sd (share) of focal
    lengths that are about right, None: unknown; largest: offset that is looked for, frames, None: one second, and more
    where that is not enough. Limits: clear: depth of an epipolar curve's minimum, as a share of its median, that tells
    an offset; duel: share by which rival offsets must be worse; seconds, short: fewest, and few; angle_deg, residual
    (share of the person's size), focal_sd, place_sd (m): worst that is not refused; spread_m: of the person and of the
    feet, below which much is not told; doubt: what standard deviations are multiplied by then; height_sd: of the scale,
    share."""

    focal_known: bool = False
    focal_hold: float | None = None
    largest: int | None = None
    clear: float = 0.65
    duel: float = 0.1
    close: float = 0.3
    seconds: float = 1.0
    short: float = 10.0
    angle_deg: float = 10.0
    residual: float = 0.025
    focal_sd: float = 0.08
    place_sd: float = 0.3
    spread_m: float = 0.25
    doubt: float = 3.0
    height_sd: float = 0.02


@dataclass(frozen=True)
class PersonCalibration:
    """rig: metres, z up, floor at 0; late (C,) frames by which each view is late, against the median view, and its sd;
    turn_sd_deg, place_sd_m (C,): when the rig is laid onto the truth; focal_sd (C,) share, 0 where given; scale_sd:
    share; up_known: the vertical is measured; median_px: of the residuals; approximate: sentences on what is hardly
    known; points (F, K, 3) m at the `frames` of the common clock."""

    rig: CameraRig
    late: Array
    late_sd: Array
    turn_sd_deg: Array
    place_sd_m: Array
    focal_sd: Array
    scale_sd: float
    up_known: bool
    median_px: float
    approximate: tuple[str, ...]
    points: Array
    frames: Array


def calibrate_from_person(
    points: Array,
    names: Sequence[str],
    lenses: CameraRig,
    height: float,
    frame_rate: float,
    settings: PersonSettings | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> PersonCalibration:
    """Find cameras, offsets, vertical and floor.

    points (C, T, K, 3): px of the stored pictures and confidence of one person; lenses: cameras with their lenses (a
    focal length of the picture's longer side where it is unknown), whose poses do not count; height m.
    A CalibrationError says why it cannot be done, and what would help."""
    settings = settings or PersonSettings()
    count, total = points.shape[:2]
    if count < 2:
        raise CalibrationError("Cameras are found from two or more views; the recording has only one.")
    unknown = not settings.focal_known
    if count == 2 and unknown:
        raise CalibrationError(
            "Two cameras do not tell their focal lengths: give these with --intrinsics FILE, or film with a third one."
        )
    if total < settings.seconds * frame_rate:
        raise CalibrationError(
            f"{total / frame_rate:.1f} s of the person are too little to find cameras from: film 20 s or more."
        )
    search = _Search(points, tuple(names), lenses, height, frame_rate, settings, progress)
    rig, late = search.start()
    for k in range(2):
        progress("refine", k, 3)
        late = search.offsets(rig, late)
        solution = search.refine(rig, late)
        rig = solution.rig
    progress("refine", 2, 3)
    late = late + solution.sds.later
    late -= np.median(late)
    solution = search.refine(rig, late)
    progress("refine", 3, 3)
    return search.judged(solution)


@dataclass(frozen=True)
class _Solution:
    rig: CameraRig
    late: Array
    points: Array
    median_px: float
    sds: Uncertainty


class _Search:
    """One calibration under way. raw: key points as they were detected; frames of the common clock are those of the
    median view."""

    def __init__(
        self,
        raw: Array,
        names: tuple[str, ...],
        lenses: CameraRig,
        height: float,
        frame_rate: float,
        settings: PersonSettings,
        progress: Callable[[str, int, int], None],
    ) -> None:
        self.raw, self.names, self.lenses, self.height = raw, names, lenses, height
        self.frame_rate, self.settings, self.progress = frame_rate, settings, progress
        self.known = settings.focal_known
        self.points = self._undistorted(lenses)
        self.sd = detection_sd(self.points)

    def _undistorted(self, rig: CameraRig) -> Array:
        out = self.raw.copy()
        for camera, view in zip(rig, out, strict=True):
            view[..., :2] = camera.undistort_points(view[..., :2])
        return out

    def moments(self, late: Array) -> Array:
        """Frames of the common clock that all views have, evenly chosen."""
        first, last = np.ceil(max(0, -late.min())), np.floor(len(self.raw[0]) - 1 - max(0, late.max()))
        if last - first < self.settings.seconds * self.frame_rate - 1:
            raise CalibrationError(
                f"The views have only {max(last - first, 0) / self.frame_rate:.1f} s in common; let all cameras run "
                "for 20 s or more while the person walks about."
            )
        return np.unique(np.linspace(first, last, _MOMENTS).round().astype(int))

    # ---- start

    def start(self) -> tuple[CameraRig, Array]:
        """A rig at an arbitrary scale, and offsets; a CalibrationError when other offsets explain as much."""
        curves = self._curves([c.K for c in self.lenses] if self.known else None)
        late = self._offsets(curves)
        rig = self._rig(late).rig
        if not self.known:  # essential matrices tell offsets better than fundamental ones
            curves = epipolar_curves(self.points, [c.K for c in rig], self.sd, int(curves.lags[-1]))
            late = self._offsets(curves)
        rival = rival_offsets(curves, late)
        if rival is None or rival[0] > self.settings.close:
            return rig, late
        best, other = self._rig(late, rig), self._rig(rival[1] - np.median(rival[1]), rig)
        gap = max(best.cost, other.cost) / min(best.cost, other.cost) - 1
        if gap < self.settings.duel:
            away = float(np.abs((rival[1] - rival[1][0]) - (late - late[0])).max()) / self.frame_rate
            raise CalibrationError(
                f"The recording does not tell how late the cameras are: offsets that differ by {away:.1f} s, with "
                f"cameras at other places, explain it as well; {ADVICE}."
            )
        if other.cost < best.cost:
            late = rival[1] - np.median(rival[1])
            return self._rig(late).rig, late
        return best.rig, late

    def _curves(self, lenses: Sequence[Array] | None) -> Curves:
        """Curves over as many offsets as are needed until every view has a clear one."""
        largest = self.settings.largest or round(self.frame_rate)
        longest = self.settings.largest or max(largest, len(self.raw[0]) // 2)
        first: Curves | None = None
        while True:
            curves = epipolar_curves(
                self.points, lenses, self.sd, largest, lambda done, total: self.progress("offsets", done, total)
            )
            first = first or curves
            if self._joined(curves):
                return curves
            if largest >= longest:
                return first
            largest = min(2 * largest, longest)

    def _joined(self, curves: Curves) -> bool:
        """Whether pairs with a clear minimum join all views."""
        group = np.arange(len(self.raw))
        for (a, b), cost in zip(curves.pairs, curves.cost, strict=True):
            if np.isfinite(cost).all() and cost.min() < self.settings.clear * np.median(cost):
                group[group == group[b]] = group[a]
        return bool((group == group[0]).all())

    def _offsets(self, curves: Curves) -> Array:
        try:
            found = solve_offsets(curves, len(self.raw))
        except EvidenceError:
            raise CalibrationError(f"No two views show the person at the same time; {ADVICE}.") from None
        lost = [c.name for c, sd in zip(self.lenses, found.sd, strict=True) if not np.isfinite(sd)]
        if lost:
            raise CalibrationError(f"{', '.join(lost)}: the person's motion does not tell how late it is; {ADVICE}.")
        return found.frames

    def _rig(self, late: Array, lenses: CameraRig | None = None) -> Start:
        """The cheapest start at offsets; lenses: whose focal lengths are tried alone."""
        points = on_common_clock(self.points, late, self.moments(late))
        searched = lenses is None and not self.known and self.settings.focal_hold is None
        found: list[Start] = []
        for k, factor in enumerate(FACTORS if searched else (1.0,)):
            self.progress("start", k, len(FACTORS))
            rig = CameraRig(tuple(with_focal(c.pinhole(), factor) for c in lenses or self.lenses))
            start = start_rig(points, rig, self.sd, 3 if searched else 4)
            found += [start] if start is not None else []
        if not found:
            raise CalibrationError(f"The views have too little of the person in common to find the cameras; {ADVICE}.")
        return min(found, key=lambda s: s.cost)

    # ---- refinement

    def _pinhole(self, rig: CameraRig) -> Array:
        return self.points if self.known else self._undistorted(rig)

    def _detections(self, points: Array, late: Array) -> tuple[Array, Array]:
        """(C, N, 2) px and (C, N) 0 or 1 of the moments' points."""
        there = on_common_clock(points, late, self.moments(late)).reshape(len(points), -1, 3)
        return there[..., :2], np.where(there[..., 2] > SEEN, 1.0, 0.0)

    def _scale(self, x: Array) -> float:
        """The factor that makes points (N, 3) those of a person of the given height."""
        shape = shape_from_keypoints(human(), x.reshape(-1, len(self.names), 3), self.names)
        return self.height / (shape.scale * human().stature)

    def offsets(self, rig: CameraRig, late: Array) -> Array:
        """Offsets near `late` by the epipolar geometry of a rig."""
        here = on_common_clock(self._pinhole(rig), late, np.arange(self.raw.shape[1]))
        sd = point_sd(here[..., :2], here[..., 2])
        more = solve_offsets(keypoint_curves(rig, here[..., :2], here[..., 2], 4.0, sd), len(rig)).frames
        return late + more - np.median(late + more)

    def refine(self, rig: CameraRig, late: Array) -> _Solution:
        """The rig by all points at these offsets, in metres."""
        uv, seen = self._detections(self._pinhole(rig), late)
        rig = rescaled(rig, self._scale(triangulate(rig, uv, seen)[0])).pinhole()
        free, hold = not self.known, (*LOOSE[:2], self.settings.focal_hold or LOOSE[2])
        uv, seen = self._detections(self.raw if free else self.points, late)
        found = adjust(rig, uv, seen, focal=free, radial=free, hold=hold, iterations=60)
        factor = self._scale(found.points)
        new, points = rescaled(found.rig, factor), found.points * factor
        keep = (seen > 0).sum(0) >= 2
        unknowns = CameraUnknowns(new, free, None, free, hold)
        bundle = PointBundle(uv[:, keep], seen[:, keep], default_scale(uv, seen), unknowns)
        sds = self._uncertainty(bundle, new, late, found.radial, points, keep)
        lenses = zip(new, self.lenses, found.radial, strict=True)
        bent = tuple(replace(c, distortion=np.r_[k, 0.0, 0, 0, 0] if free else d.distortion) for c, d, k in lenses)
        return _Solution(CameraRig(bent), late, points, found.after, sds)

    def _uncertainty(
        self, bundle: PointBundle, rig: CameraRig, late: Array, radial: Array, points: Array, keep: Array
    ) -> Uncertainty:
        near = (on_common_clock(self.points, late + d, self.moments(late)) for d in (-_STEP, _STEP))
        before, after = (p.reshape(len(rig), -1, 3)[:, keep] for p in near)
        both = (before[..., 2] > SEEN) & (after[..., 2] > SEEN)
        velocity = np.where(both[..., None], (after - before)[..., :2] / (2 * _STEP), 0.0)
        moment, kind = np.divmod(np.flatnonzero(keep), len(self.names))
        labels = np.stack([moment, kind, limbs_of(self.names)[kind]], 1)
        return uncertainty(bundle, list(rig), radial, points[keep], velocity, labels)

    # ---- what is known of it

    def judged(self, solution: _Solution) -> PersonCalibration:
        """The rig on its floor with its uncertainty; a CalibrationError when that is too large."""
        s, rig, late, sds = self.settings, solution.rig, solution.late, solution.sds
        frames = self.moments(late)
        points = solution.points.reshape(len(frames), -1, 3)
        spread = _spread(np.nanmedian(points, axis=1))
        path = float(np.sqrt(spread[0]))
        self._refuse(solution, points)
        doubts = []
        if len(rig) == 3 and not self.known:
            doubts.append("three cameras hardly tell their focal lengths: give them with --intrinsics FILE")
        if path < s.spread_m:
            doubts.append(f"the person stays in place (within {path:.1f} m), which tells places and offsets badly")
        if len(self.raw[0]) < s.short * self.frame_rate:
            doubts.append(f"{len(self.raw[0]) / self.frame_rate:.1f} s are short: film 20 s")
        up, floor, known = self._upright(points, frames)
        if known:  # limbs and the head's height above the floor tell the scale equally well
            factor = np.sqrt(self.height / self._stature(points @ up - floor))
            rig, points, floor = rescaled(rig, factor), points * factor, floor * factor
        more = s.doubt if doubts else 1.0
        if not known:
            doubts.append(
                "the vertical is not measured, because the feet stay in one place: up is where the person's trunk "
                "points on average, which is wrong when the person leans"
            )
        middle = np.nanmedian(points.reshape(-1, 3), axis=0)
        turn = rotation_between(up, [0, 0, 1.0])
        right = turn @ rig[0].camera_from_world[0, :3]
        angle = -np.arctan2(right[1], right[0])
        spin = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        turn = spin @ turn
        motion = se3(turn, -np.array([*(turn @ middle)[:2], floor]))
        return PersonCalibration(
            in_world(rig, motion), late, more * sds.late, more * sds.turn_deg, more * sds.place_m, more * sds.focal,
            s.height_sd, known, solution.median_px, tuple(doubts), points @ turn.T + motion[:3, 3], frames,
        )  # fmt: skip

    def _refuse(self, solution: _Solution, points: Array) -> None:
        s, rig = self.settings, solution.rig
        residual = solution.median_px / (100 * self.sd)
        place_sd, focal_sd = solution.sds.place_m, solution.sds.focal
        rays = np.nanmedian(points.reshape(-1, 3), axis=0) - rig.positions
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        widest = float(np.degrees(np.arcsin(np.linalg.norm(np.cross(rays[:, None], rays), axis=-1).max())))
        if widest < s.angle_deg:
            raise CalibrationError(
                f"All cameras look from nearly the same side (within {widest:.0f} degrees): put one of them elsewhere."
            )
        if residual > s.residual:
            raise CalibrationError(
                f"The views do not agree on one person: the median residual is {100 * residual:.1f} % of the person's "
                "size; see whether the key points are one person's in all views, and whether cameras stood still."
            )
        if focal_sd.max() > s.focal_sd:
            worst = rig.names[int(focal_sd.argmax())]
            raise CalibrationError(
                f"{worst}: the focal length stays uncertain by {100 * focal_sd.max():.0f} %; give focal lengths with "
                f"--intrinsics FILE, or {ADVICE.split(', or')[0]}."
            )
        if place_sd.max() > s.place_sd:
            worst = rig.names[int(place_sd.argmax())]
            raise CalibrationError(f"{worst}: its place stays uncertain by {place_sd.max():.1f} m; {ADVICE}.")

    def _rest(self) -> Array:
        """(K,) m by which key points are above the floor when a person of the given height stands."""
        body = human()
        carrier, offset, _ = landmark_of(self.names, body)
        sole = body.skin(np.zeros(len(body.skeleton.lower)))[:, 2].min()
        return self.height / body.stature * ((body.skeleton.rest_joints[carrier] + offset)[:, 2] - sole)

    def _stature(self, above: Array) -> float:
        """How tall the person is by the height of the head's points above the floor, of points above it by (F, K)."""
        head = [k for k, n in enumerate(self.names) if n in _HEAD]
        return self.height * float(np.median(np.nanmedian(above[:, head], axis=0) / self._rest()[head]))

    def _upright(self, points: Array, frames: Array) -> tuple[Array, float, bool]:
        """(3,) up, the floor's height along it, and whether feet on the floor tell up; else it is the trunk's."""
        column = {n: k for k, n in enumerate(self.names)}
        trunk = [
            points[:, column[f"{side}_shoulder"]] - points[:, column[f"{side}_ankle"]] for side in ("left", "right")
        ]
        up = np.nanmean(np.concatenate(trunk), axis=0)
        up /= np.linalg.norm(up)
        rows, kinds = [], []
        step = (frames[1] - frames[0]) / self.frame_rate
        for k, foot in enumerate(_FEET):
            for side in ("left", "right"):
                if f"{side}_{foot}" not in column:
                    continue
                p = points[:, column[f"{side}_{foot}"]]
                still = (np.linalg.norm(np.gradient(p, axis=0), axis=1) / step < 0.6) & np.isfinite(p).all(1)
                rows.append(p[still])
                kinds.append(np.full(int(still.sum()), k))
        feet, kind = np.concatenate(rows), np.concatenate(kinds)
        weight = np.ones(len(feet))
        known = False
        if len(feet) > 30:
            normal, width = up, 0.0
            for _ in range(15):
                centred = feet.copy()
                for k in np.unique(kind):
                    centred[kind == k] -= np.average(feet[kind == k], axis=0, weights=weight[kind == k] + 1e-9)
                values, vectors = np.linalg.eigh((centred * weight[:, None]).T @ centred)
                normal = vectors[:, 0] * np.sign(vectors[:, 0] @ up)
                weight = 1 / (1 + (centred @ normal / 0.03) ** 2)
                width = float(np.sqrt(values[1] / weight.sum()))
            known = width > self.settings.spread_m
            up = normal if known else up
        used = [k for k in np.unique(kind) if (kind == k).any()]
        rest = self._rest()
        heights = {k: rest[column[f"left_{_FEET[k]}"]] for k in used}
        floors = [np.median(feet[kind == k] @ up) - heights[k] for k in used]
        floor = float(np.mean(floors)) if floors else float(np.nanmin(points @ up))
        return up, floor, known


def _spread(path: Array) -> Array:
    """(3,) variances of places (F, 3) along their principal axes, the largest first."""
    fine = path[np.isfinite(path).all(1)]
    return np.linalg.eigvalsh(np.cov(fine.T))[::-1]
