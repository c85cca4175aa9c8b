"""Diagnostics with silhouettes: compared with the silhouettes of other views.

The planes through two camera centres that are tangent to the person must be the same in
both views (frontier points, Sinha and Pollefeys 2010). They give less information than key points, two planes per pair
and frame: mirrored, turned and exchanged views, timing, wrong poses and units are found, lens coefficients are not.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hypose.calibration.bundle import apply_parameters
from hypose.calibration.diagnose_person import ViewReport, height_findings
from hypose.calibration.diagnose_points import (
    FAR_DEG,
    FAR_M,
    certain_delays,
    displaced,
    scatter,
    timing_findings,
    undo_faults,
)
from hypose.calibration.findings import INVALID, REVIEW, Finding, Limits
from hypose.calibration.refine_points import changes
from hypose.calibration.sync_motion import MaskTrack, mask_tracks, silhouette_curves, tangent_planes
from hypose.cameras.camera import Camera, CameraRig
from hypose.evidence.frame import Silhouettes
from hypose.evidence.keypoint_check import Trial, geometric_trials
from hypose.geometry import Array

# ---- silhouettes against each other --------------------------------------------------------------------------------


_SCATTER = 0.08
"""Share of the person's size by which tangent planes may disagree; it allows for tables and treadmills that hide part
of the person."""
_FEW, _JUDGED = 25, 40  # frames by which trials are compared, and on which poses are judged
_LOOK_AT_MASKS = (
    "look at the masks in check.png; if they outline the same person in every view, run hypose check --refine, else "
    "give a photo or clip of the empty room as background, masks of your own, or key points"
)


def tangency(rig: CameraRig, tracks: Sequence[MaskTrack]) -> dict[tuple[int, int], Array]:
    """Measure, for each pair of views, the disagreement of the planes that are tangent to the person.

    tracks: mask track of each view.
    Returns: by pair of view indices (T, 2) px of the working size, for the two tangent planes; NaN where a view has no
        whole mask. Positive: the plane of the second view is further along the pencil of planes.
    """
    out = {}
    for a, b in itertools.combinations(range(len(tracks)), 2):
        planes, px = tangent_planes(rig, tracks, a, b)
        out[a, b] = (planes[1] - planes[0]) * np.where(np.isnan(px).any(0), np.nan, px.mean(0))
    return out


def tangency_by_view(rig: CameraRig, tracks: Sequence[MaskTrack]) -> Array:
    """Summarise the disagreement of tangent planes per view.

    tracks: mask track of each view.
    Returns: (C,) median over a view's pairs of the median over frames and tangents, px; NaN without data.
    """
    medians = {k: np.nanmedian(np.abs(v)) for k, v in tangency(rig, tracks).items() if np.isfinite(v).any()}
    by_view = [[m for pair, m in medians.items() if c in pair] for c in range(len(tracks))]
    return np.array([np.median(mine) if mine else np.nan for mine in by_view])


@dataclass(frozen=True)
class MaskViews:
    """The masks of all views over T frames, as the checks see them.

    rig: cameras of the masks, at their size.
    tracks: mask track of each view.
    size: (C,) size of the person in each view, px; 0 in a view without a whole mask.
    """

    rig: CameraRig
    tracks: list[MaskTrack]
    size: Array

    @staticmethod
    def of(silhouettes: Sequence[Silhouettes | None]) -> MaskViews:
        """Collect the masks of consecutive frames; EvidenceError without any."""
        tracks = mask_tracks(silhouettes)
        rig = next(s.rig for s in silhouettes if s is not None)
        return MaskViews(rig, tracks, np.array([t.size for t in tracks]))

    def score(self) -> float:
        """Compute the mean disagreement of the views' tangent planes, in shares of the person's size; 10 where planes
        never agree.
        """
        seen = self.size > 0
        by_view = tangency_by_view(self.rig, self.tracks)[seen] / self.size[seen]
        return float(np.mean(np.nan_to_num(np.minimum(by_view, 10.0), nan=10.0))) if seen.sum() > 1 else 0.0

    @property
    def frames(self) -> int:
        """Number T of frames."""
        return len(self.tracks[0].area)

    def few(self, count: int = _JUDGED) -> MaskViews:
        """Keep `count` frames, evenly spread."""
        rows = np.unique(np.linspace(0, self.frames - 1, min(count, self.frames)).astype(int))
        return replace(self, tracks=[t.at(rows) for t in self.tracks])

    def on_clock(self, late: Array) -> MaskViews:
        """Shift the views in time, so that their frames t + late (C,) become frame t."""
        frames = np.arange(self.frames)
        return replace(self, tracks=[t.at(frames + round(x)) for t, x in zip(self.tracks, late, strict=True)])

    def of_some(self, cameras: CameraRig, kept: list[int]) -> float:
        """Compute the `score` of some views, whose cameras may have changed."""
        return MaskViews(cameras, [self.tracks[k] for k in kept], self.size[kept]).score()

    def looked_at(self) -> Array:
        """Compute the point (3,) that lies nearest to the middle of all pictures, m, in place of the person."""
        look = np.stack([c.camera_from_world[2, :3] for c in self.rig])
        across = np.eye(3) - look[:, :, None] * look[:, None, :]
        return np.linalg.lstsq(across.sum(0), (across @ self.rig.positions[..., None]).sum(0)[:, 0], rcond=None)[0]


def examine_silhouettes(
    rig: CameraRig, silhouettes: Sequence[Silhouettes | None], o: Limits
) -> tuple[list[Finding], tuple[ViewReport, ...], Array]:
    """Diagnose a calibration with silhouettes alone.

    rig: the calibrated cameras.
    silhouettes: silhouettes of consecutive frames.
    o: limits.
    Returns: findings, a report per view, and (C,) delay of each view, frames.
    Raises: EvidenceError where no frame has silhouettes.
    """
    seen, n = MaskViews.of(silhouettes), len(rig)
    if n < 2:
        return [], tuple(ViewReport(name) for name in rig.names), np.zeros(n)
    residual = tangency_by_view(seen.rig, seen.tracks) * rig.sizes[:, 0] / seen.rig.sizes[:, 0]
    reports = tuple(ViewReport(name, tangency_px=float(r)) for name, r in zip(rig.names, residual, strict=True))
    findings, seen = _gross_masks(seen, o)
    late, timed = _timing(seen, o)
    in_step = seen.on_clock(late)
    # for a person who walks straight, a late camera has the same effect as a displaced one, and a displaced one seems
    # late: it is displaced where moving it explains far more
    best = None if findings else _best_moved(rig, seen, o)
    if best is not None and best.after <= min(o.gross_cured * min(best.before, in_step.few().score()), o.tangency):
        findings.append(best.finding)
        seen = best.moved
        late, timed = _timing(seen, o)
        in_step = seen.on_clock(late)
    findings += timed
    if all(f.kind == "late" for f in findings):
        findings += focal_findings(in_step.rig, in_step.few().of_some)
    if all(f.kind == "late" for f in findings):
        best = best if best is not None and not late.any() else _best_moved(rig, in_step, o)
        poses = _poses(in_step, best, o)
        if any(f.kind == "scatter" for f in poses):  # masks that do not show one person give no lag
            return poses, reports, np.zeros(n)
        findings += [*poses, *_unit(in_step, o)]
    return findings, reports, late


def gross_silhouettes(seen: MaskViews, o: Limits) -> tuple[Finding, ...]:
    """Find gross faults from the masks of a few frames, which need not be consecutive.

    The faults are mirrored, rotated and exchanged views, tangent planes that never agree, and a wrong unit.

    o: limits.
    Returns: the findings; none where there is only one view or no silhouette.
    """
    if len(seen.rig) < 2 or not (seen.size > 0).any():
        return ()
    findings, seen = _gross_masks(seen, o)
    left = seen.score()
    if not findings and left > _SCATTER:
        findings.append(replace(_scattered(seen, left), cure="run hypose check, which looks for the cause"))
    return (*findings, *_unit(seen, o))


def _gross_masks(seen: MaskViews, o: Limits) -> tuple[list[Finding], MaskViews]:
    """Find and undo up to two gross faults by the tangent planes of the masks.

    Returns: the findings, and the masks after the faults were undone.
    """

    def trials(cameras: CameraRig, now: MaskViews) -> Iterator[Trial[MaskViews]]:
        def turned(c: int, factor: Array) -> MaskViews:
            middle, track = (np.array(cameras[c].size) - 1) / 2, now.tracks[c]
            outline = middle + factor * (track.outline - middle)
            changed = tuple(None if p is None else middle + factor * (p - middle) for p in track.changed)
            other = replace(track, outline=outline, changed=changed)
            return replace(now, tracks=[*now.tracks[:c], other, *now.tracks[c + 1 :]])

        return geometric_trials(cameras, now, turned, lambda order: replace(now, tracks=[now.tracks[k] for k in order]))

    most = 2 if seen.few(_FEW).score() >= o.gross else 0
    findings, rig, seen = undo_faults(
        seen.rig,
        seen,
        trials,
        lambda cameras, now, _: replace(now, rig=cameras).score(),
        lambda now: now.few(_FEW),
        o,
        most,
        _SCATTER,
    )
    return findings, replace(seen, rig=rig)


def _timing(seen: MaskViews, o: Limits) -> tuple[Array, list[Finding]]:
    """Estimate the delay of each view from its masks.

    Returns: (C,) frames, 0 where it is not certain, and for all views of fewer than 24 frames; and the findings.
    """
    n = len(seen.rig)
    if seen.frames < 24:
        return np.zeros(n), []
    late, sd = certain_delays(
        partial(silhouette_curves, seen.rig, seen.tracks), n, o, max(o.late, 0.6), 2 * o.late_gain
    )
    return late, list(timing_findings(seen.rig, late, sd))


def _poses(seen: MaskViews, best: _Moved | None, o: Limits) -> list[Finding]:
    """Check whether moving one camera makes the tangent planes agree.

    best: result of `_best_moved`.
    Returns: at most one finding; none where the planes agree already or there are two views.
    """
    if best is None:
        return []
    before, after = best.before, best.after
    disagree = f"All cameras: the silhouettes' tangent planes disagree by {100 * before:.1f} % of the person's size"
    if min(before, after) > _SCATTER or (best.far and after > o.tangency):
        if before <= _SCATTER and after <= _SCATTER:  # the views show one person; the fault is unknown
            return [Finding("extrinsics", (), disagree, "run hypose check --refine, and hypose sync", before)]
        found = _scattered(seen.few(), before)
        text = f"{found.text}, and no lag that these frames can tell and no other place of one camera cures that"
        return [replace(found, text=text)]
    if after > o.extrinsics * before:
        return [Finding("extrinsics", (), disagree, "run hypose check --refine", before)]
    return [best.finding]


def _scattered(seen: MaskViews, before: float) -> Finding:
    """Make the finding that masks do not show one person; it names a view without which the others agree.

    before: disagreement of the tangent planes, share of the person's size.
    """
    said = f"the silhouettes' tangent planes disagree by {100 * before:.0f} % of the person's size"
    limit = min(0.5 * _SCATTER, 0.25 * before) if (seen.size > 0).sum() > 3 else 0.0
    return scatter(seen.rig, seen.of_some, limit, said, (_LOOK_AT_MASKS, _LOOK_AT_MASKS), before)


@dataclass(frozen=True)
class _Moved:
    """The camera whose movement lessens the disagreement of tangent planes most.

    before, after: disagreement before and after it is moved, shares of the person's size.
    moved: the masks with the moved camera.
    far: whether it is moved farther than a calibration is usually wrong.
    finding: the finding that it is displaced.
    """

    before: float
    after: float
    moved: MaskViews
    far: bool
    finding: Finding


def _best_moved(rig: CameraRig, seen: MaskViews, o: Limits) -> _Moved | None:
    """Find the camera that helps most when it alone is moved to where its tangent planes agree best with the others'.

    rig: the calibrated cameras.
    Returns: None where the planes agree already, or there are two views.
    """
    few = seen.few()
    before = few.score()
    if before < o.tangency or len(rig) < 3:
        return None
    tried = [replace(few, rig=_moved_alone(few, c)) for c in range(len(rig))]
    left = [moved.score() for moved in tried]
    c = int(np.argmin(left))
    change = changes(seen.rig, tried[c].rig, seen.looked_at()[None])[c]
    px = change.image_px * rig.sizes[c, 0] / seen.rig.sizes[c, 0]
    evidence = (
        f"the silhouettes' tangent planes disagree by {100 * before:.1f} % of the person's size, after moving this "
        f"camera by {100 * left[c]:.1f} %"
    )
    far = change.turn_deg > FAR_DEG or change.move_m > FAR_M
    return _Moved(before, left[c], replace(seen, rig=tried[c].rig), far, displaced(change, px, evidence))


def _moved_alone(seen: MaskViews, c: int) -> CameraRig:
    """Move camera c to where its tangent planes agree best with those of the others, and return all cameras."""
    from scipy.optimize import least_squares  # takes long to import

    rig, scale = seen.rig, 0.01 * max(float(seen.size[c]), 1.0)

    def camera(x: Array) -> Camera:
        return apply_parameters(rig[c], x * np.array([0.02] * 3 + [0.1] * 3))

    def rows(x: Array) -> Array:
        moved, others = camera(x), [k for k in range(len(rig)) if k != c]
        pairs = [tangency(CameraRig((moved, rig[k])), [seen.tracks[c], seen.tracks[k]])[0, 1] for k in others]
        return np.r_[(np.clip(np.nan_to_num(np.concatenate(pairs, None)), -50 * scale, 50 * scale) / scale), 0.3 * x]

    found = least_squares(rows, np.zeros(6), loss="soft_l1", max_nfev=12, diff_step=1e-3).x
    return CameraRig((*rig.cameras[:c], camera(found), *rig.cameras[c + 1 :]))


def _unit(seen: MaskViews, o: Limits) -> Iterator[Finding]:
    """Check the person's height from its size in the images and the distance of the cameras; accurate to a third."""
    distance = np.linalg.norm(seen.rig.positions - seen.looked_at(), axis=1)
    heights = (seen.size * distance / np.array([c.K[1, 1] for c in seen.rig]))[seen.size > 0]
    if len(heights):
        yield from height_findings(
            float(np.median(heights)), None, replace(o, heights=(0.6, 3.5), usual_heights=(0.6, 3.5))
        )


# ---- common focal length -------------------------------------------------------------------------------------------
# Cameras whose focal lengths are all too long by the same factor show a smaller world: a person who stays where all
# of them look only becomes shorter, and no view contradicts another. Off that middle the rays miss each other, so the
# factor is the one with which the views disagree least. Its uncertainty is estimated by leaving out each view, since
# an error of one of them is the same in all frames.


_FAULT_LOG_FACTOR, CERTAIN, LIKELY, KNOWN = 0.06, 3.5, 2.7, 0.08
"""Limits for a common focal factor. It is a fault when its logarithm exceeds both _FAULT_LOG_FACTOR and CERTAIN
standard deviations, with a standard deviation of at most KNOWN; it is worth a check beyond LIKELY standard deviations.
"""
_REACHES = (0.15, 0.1)
"""Largest logarithms of the factors that are tried around the best one so far."""


def focal_findings(rig: CameraRig, disagree: Callable[[CameraRig, list[int]], float]) -> Iterator[Finding]:
    """Yield the finding of a factor by which all focal lengths are wrong, where it is significant.

    disagree: function of some of the cameras, changed, and their indices, that gives their disagreement.
    """
    views = list(range(len(rig)))
    if len(views) < 3:  # with two views, a wrong pose looks the same
        return

    def best(kept: list[int], x: float) -> float:
        """Compute the logarithm of the factor with which some views disagree least, from a parabola through trials; NaN
        where the parabola has no least value.
        """
        for reach in _REACHES:
            steps = reach * np.linspace(-1, 1, 5)
            trials = [[apply_parameters(rig[c], np.r_[np.zeros(6), x + step]) for c in kept] for step in steps]
            squares = np.array([disagree(CameraRig(tuple(cameras)), kept) ** 2 for cameras in trials])
            bend, slope, _ = np.polyfit(steps, squares, 2) if np.isfinite(squares).all() else np.zeros(3)
            if bend <= 0:
                return np.nan
            x += float(np.clip(-0.5 * slope / bend, -1.5 * reach, 1.5 * reach))
        return x

    x = best(views, 0.0)
    if np.isnan(x):
        return
    moves = np.array([best([v for v in views if v != c], x) - x for c in views])
    off, sd = abs(x), float(np.sqrt((1 - 1 / len(views)) * (moves**2).sum()))
    if off > max(_FAULT_LOG_FACTOR, LIKELY * sd) and sd < KNOWN:
        factor = np.exp(x)
        yield Finding(
            "focal",
            (),
            f"All cameras: the views agree best if every focal length were {factor:.2f} times as long (sd "
            f"{factor * sd:.2f}); as they are, the person comes out {factor:.2f} times as large",
            "calibrate the lenses again as the videos were filmed (zoom, picture size), or correct all focal lengths",
            off,
            INVALID if off > CERTAIN * sd else REVIEW,
        )
