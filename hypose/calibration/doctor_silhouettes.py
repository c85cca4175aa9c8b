"""The doctor's checks on silhouettes alone: tangent planes of pairs of views in place of key points.

They know less than key points: two planes per pair and frame. Mirrored, turned and exchanged views, timing, wrong poses
and units can be told; lens coefficients cannot.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.calibration.common_focal import focal_by_masks, focal_findings
from hypose.calibration.doctor_extrinsics import FAR_DEG, FAR_M
from hypose.calibration.doctor_findings import Finding, Limits
from hypose.calibration.doctor_masks import tangency, tangency_by_view
from hypose.calibration.doctor_report import ViewReport, height_findings
from hypose.calibration.doctor_timing import timing_findings
from hypose.calibration.refine_camera import changed, changes
from hypose.calibration.sync_motion import MaskTrack, farther, mask_tracks, silhouette_curves, solve_widely
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.frame import Silhouettes
from hypose.evidence.hull import visual_hull
from hypose.geometry import Array, se3_inverse

SCATTER = 0.08
"""Share of the person's size by which tangent planes may disagree: tables and treadmills cut masks, too."""
_JUDGED = 40  # frames on which poses are judged
_LOOK_AT_MASKS = (
    "look at the masks in check.png; if they outline the same person in every view, run hypose check --refine, else "
    "give a photo or clip of the empty room as background, masks of your own, or key points"
)


@dataclass(frozen=True)
class _Trial:
    kind: str
    views: tuple[int, ...]
    words: str
    cure: str
    rig: CameraRig
    tracks: list[MaskTrack]


def examine_silhouettes(
    rig: CameraRig, silhouettes: Sequence[Silhouettes | None], o: Limits
) -> tuple[list[Finding], tuple[ViewReport, ...], Array]:
    """Findings, one report per view, and (C,) frames by which each view is late. rig: as calibrated."""
    small = next((s.rig for s in silhouettes if s is not None), None)
    n = len(rig)
    if small is None:
        raise EvidenceError("No frame has silhouettes; give masks, a background, or key points.")
    tracks = mask_tracks(silhouettes)
    size = _sizes(tracks)
    ratio = rig.sizes[:, 0] / small.sizes[:, 0]
    findings: list[Finding] = []
    late = np.zeros(n)
    if n < 2:
        return findings, _reports(rig, np.full(n, np.nan), size * ratio), late
    residual = tangency_by_view(tangency(small, tracks), n) * ratio
    reports = _reports(rig, residual, size * ratio)
    small, tracks = _gross(small, tracks, size, findings, o)
    timed = list(findings)
    late = _timing(rig, small, tracks, size, timed, o)
    in_step = [_delayed(t, round(x)) for t, x in zip(tracks, late, strict=True)]
    # somebody who walks straight on looks through a late camera as through one that stands elsewhere
    left = _score(small, _few(in_step, _JUDGED), size)
    placed = _displaced(rig, small, tracks, size, silhouettes, left, o) if not findings else None
    if placed is None:
        findings, tracks = timed, in_step
    else:  # a camera that stands elsewhere sees the person move at other times: told in its own place
        findings.append(placed[0])
        small = placed[1]
        late = _timing(rig, small, tracks, size, findings, o)
        tracks = [_delayed(t, round(x)) for t, x in zip(tracks, late, strict=True)]
    if not findings or all(f.kind == "late" for f in findings):
        findings += focal_findings(focal_by_masks(small, _few(tracks, _JUDGED)))
    if not findings or all(f.kind == "late" for f in findings):
        poses = _poses(rig, small, tracks, size, silhouettes, o)
        if any(f.kind == "scatter" for f in poses):  # no lag is told by masks that do not show one person
            return poses, reports, np.zeros(n)
        findings += poses
        findings += _unit(small, size, o)
    return findings, reports, late


def gross_silhouettes(rig: CameraRig, silhouettes: Sequence[Silhouettes | None], o: Limits) -> tuple[Finding, ...]:
    """What a few frames (not in a row) tell: mirrored, turned and exchanged views, planes that never meet, and the
    unit. rig: that of the silhouettes."""
    tracks = mask_tracks(silhouettes)
    size = _sizes(tracks)
    findings: list[Finding] = []
    if len(rig) < 2 or not (size > 0).any():
        return ()
    cured, tracks = _gross(rig, tracks, size, findings, o)
    left = _score(cured, tracks, size)
    if not findings and left > SCATTER:
        found = _scattered(cured, tracks, size, left)
        findings.append(replace(found, cure="run hypose check, which looks for the cause"))
    findings += _unit(cured, size, o)
    return tuple(findings)


def _reports(rig: CameraRig, residual: Array, size: Array) -> tuple[ViewReport, ...]:
    nan = float("nan")
    return tuple(
        ViewReport(name, nan, nan, float(r), float(s), None, None)
        for name, r, s in zip(rig.names, residual, size, strict=True)
    )


def _sizes(tracks: Sequence[MaskTrack]) -> Array:
    out = []
    for t in tracks:
        extents = [float(np.ptp(h, axis=0).max()) for h in t.outline if h is not None]
        out.append(float(np.median(extents)) if extents else 0.0)
    return np.array(out)


def _score(rig: CameraRig, tracks: Sequence[MaskTrack], size: Array) -> float:
    """Mean over the views of their disagreement in shares of the person's size; 10 when planes never meet. Views
    without a whole mask (size 0) say nothing."""
    seen = size > 0
    by_view = tangency_by_view(tangency(rig, tracks), len(rig))[seen] / size[seen]
    return float(np.mean(np.nan_to_num(np.minimum(by_view, 10.0), nan=10.0))) if seen.sum() > 1 else 0.0


def _few(tracks: Sequence[MaskTrack], count: int) -> list[MaskTrack]:
    total = len(tracks[0].area)
    rows = np.unique(np.linspace(0, total - 1, min(count, total)).astype(int))
    return [
        MaskTrack(tuple(t.outline[k] for k in rows), tuple(None for _ in rows), t.area[rows], t.cut[rows])
        for t in tracks
    ]


def _gross(
    rig: CameraRig, tracks: list[MaskTrack], size: Array, findings: list[Finding], o: Limits
) -> tuple[CameraRig, list[MaskTrack]]:
    for _ in range(2):
        few = _few(tracks, 25)
        before = _score(rig, few, size)
        if before < o.gross:
            break
        scored = [(_score(t.rig, t.tracks, size), k) for k, t in enumerate(_trials(rig, few))]
        after, k = min(scored)
        if after > min(o.gross_cured * before, SCATTER):
            break
        trial = next(itertools.islice(_trials(rig, tracks), k, None))
        names = tuple(rig.names[v] for v in trial.views)
        text = (
            f"{' and '.join(names) if names else 'All cameras'}: {trial.words}; with that undone the silhouettes agree "
            f"to {100 * after:.1f} % of the person's size instead of {100 * before:.1f} %"
        )
        findings.append(Finding(trial.kind, names, text, trial.cure, before - after))
        rig, tracks = trial.rig, trial.tracks
    return rig, tracks


def _trials(rig: CameraRig, tracks: list[MaskTrack]) -> Iterator[_Trial]:
    for c, camera in enumerate(rig):
        w, h = camera.size
        for kind, words, factor, cure in (
            ("mirrored", "its images are mirrored", (-1, 1), "mirror the video back (ffmpeg -i IN -vf hflip OUT)"),
            ("turned", "its images are upside down", (-1, -1), "turn the video back (ffmpeg -vf hflip,vflip)"),
            ("mirrored", "its images are flipped top to bottom", (1, -1), "flip the video back (ffmpeg -vf vflip)"),
        ):
            new = list(tracks)
            new[c] = _mapped(tracks[c], np.array(factor, dtype=np.float64), (w, h))
            yield _Trial(kind, (c,), words, cure, rig, new)
    for a, b in itertools.combinations(range(len(rig)), 2):
        new = list(tracks)
        new[a], new[b] = tracks[b], tracks[a]
        cure = f'exchange camera = "{rig.names[a]}" and camera = "{rig.names[b]}" in recording.toml'
        words = f"its video is that of camera {rig.names[b]} and the other way round"
        yield _Trial("swapped", (a, b), words, cure, rig, new)
    inverse = CameraRig(tuple(replace(k, camera_from_world=se3_inverse(k.camera_from_world)) for k in rig))
    words = "the poses are those of the cameras in the world, not of the world in the cameras"
    yield _Trial("inverted", (), words, "invert every camera's rotation and translation", inverse, tracks)


def _mapped(track: MaskTrack, factor: Array, size: tuple[int, int]) -> MaskTrack:
    """The track of an image mirrored where factor is -1."""
    offset = np.where(factor < 0, np.array(size) - 1.0, 0.0)
    return MaskTrack(
        tuple(None if p is None else p * factor + offset for p in track.outline),
        tuple(None if p is None else p * factor + offset for p in track.changed),
        track.area,
        track.cut,
    )


def _delayed(track: MaskTrack, late: int) -> MaskTrack:
    """The track as it is when frame t + late is shown at t."""
    if late == 0:
        return track
    n = len(track.area)
    at = np.arange(n) + late
    inside = (at >= 0) & (at < n)
    at = np.clip(at, 0, n - 1)
    return MaskTrack(
        tuple(track.outline[k] if ok else None for k, ok in zip(at, inside, strict=True)),
        tuple(track.changed[k] if ok else None for k, ok in zip(at, inside, strict=True)),
        np.where(inside, track.area[at], 0.0),
        track.cut[at] | ~inside,
    )


def _timing(
    rig: CameraRig, small: CameraRig, tracks: list[MaskTrack], size: Array, findings: list[Finding], o: Limits
) -> Array:
    n, late = len(rig), np.zeros(len(rig))
    if len(tracks[0].area) < 24:
        return late
    try:
        scale = max(float(np.median(size)) / 130, 0.5)
        offsets, reach = solve_widely(lambda x: silhouette_curves(small, tracks, x, scale), n, o.largest_lag)
    except EvidenceError:
        return late
    if offsets.gain < 2 * o.late_gain:
        return late
    frames = offsets.frames - (offsets.frames[0] if n == 2 else 0.0)
    certain = (np.abs(frames) >= max(o.late, 0.6)) & (np.abs(frames) >= o.late_sd * offsets.sd)
    late = np.where(certain, frames, 0.0)
    findings += timing_findings(rig, late, np.where(farther(offsets, frames, reach), np.inf, offsets.sd))
    return late


def _displaced(
    rig: CameraRig,
    small: CameraRig,
    tracks: list[MaskTrack],
    size: Array,
    silhouettes: Sequence[Silhouettes | None],
    in_step: float,
    o: Limits,
) -> tuple[Finding, CameraRig] | None:
    """A camera whose other place alone cures the disagreement of the tangent planes, far better than what is left of it
    when the views are brought in step, and the rig with it there."""
    few = _few(tracks, _JUDGED)
    before = _score(small, few, size)
    if before < o.tangency or len(rig) < 3:
        return None
    value, c, moved = _best_moved(small, few, size)
    if value > o.gross_cured * min(before, in_step) or value > o.tangency:
        return None
    return _elsewhere(rig, small, moved, c, before, value, silhouettes), moved


def _poses(
    rig: CameraRig,
    small: CameraRig,
    tracks: list[MaskTrack],
    size: Array,
    silhouettes: Sequence[Silhouettes | None],
    o: Limits,
) -> list[Finding]:
    """Whether one camera alone, moved, makes the tangent planes agree."""
    few = _few(tracks, _JUDGED)
    before = _score(small, few, size)
    if before < o.tangency or len(rig) < 3:
        return []
    value, c, moved = _best_moved(small, few, size)
    disagree = f"All cameras: the silhouettes' tangent planes disagree by {100 * before:.1f} % of the person's size"
    change = changes(small, moved, _person(silhouettes))[c]
    far = change.turn_deg > FAR_DEG or change.move_m > FAR_M
    if min(before, value) > SCATTER or (far and value > o.tangency):
        if before <= SCATTER and value <= SCATTER:  # the views show one person, and it is not told what is wrong
            return [Finding("extrinsics", (), disagree, "run hypose check --refine, and hypose sync", before)]
        found = _scattered(small, few, size, before)
        text = f"{found.text}, and no lag that these frames can tell and no other place of one camera cures that"
        return [replace(found, text=text)]
    if value > o.extrinsics * before:
        return [Finding("extrinsics", (), disagree, "run hypose check --refine", before)]
    return [_elsewhere(rig, small, moved, c, before, value, silhouettes)]


def _scattered(small: CameraRig, tracks: Sequence[MaskTrack], size: Array, before: float) -> Finding:
    """Masks that do not show one person: those of one view, where the others agree without it."""
    disagree = f"the silhouettes' tangent planes disagree by {100 * before:.0f} % of the person's size"
    seen = np.flatnonzero(size > 0)
    for c in seen if len(seen) > 3 else ():
        rest = [int(k) for k in seen if k != c]
        left = _score(small.select([small.names[k] for k in rest]), [tracks[k] for k in rest], size[rest])
        if left < min(0.5 * SCATTER, 0.25 * before):
            text = f"{small.names[c]}: {disagree}, by {100 * left:.0f} % without this view"
            return Finding("scatter", (small.names[c],), text, _LOOK_AT_MASKS, before)
    return Finding("scatter", (), f"All cameras: {disagree}", _LOOK_AT_MASKS, before)


def _best_moved(small: CameraRig, few: list[MaskTrack], size: Array) -> tuple[float, int, CameraRig]:
    """What disagreement is left when the camera that helps most is moved, which that is, and the rig with it there."""
    tried = [_moved_alone(small, few, size, c) for c in range(len(small))]
    left = [_score(moved, few, size) for moved in tried]
    c = int(np.argmin(left))
    return left[c], c, tried[c]


def _elsewhere(
    rig: CameraRig,
    small: CameraRig,
    moved: CameraRig,
    c: int,
    before: float,
    after: float,
    silhouettes: Sequence[Silhouettes | None],
) -> Finding:
    change = changes(small, moved, _person(silhouettes))[c]
    ratio = rig.sizes[c, 0] / small.sizes[c, 0]
    text = (
        f"{rig.names[c]}: {change.turn_deg:.1f} degrees and {1000 * change.move_m:.0f} mm off, which moves the person "
        f"{change.image_px * ratio:.0f} px in its image; the silhouettes' tangent planes disagree by "
        f"{100 * before:.1f} % of the person's size, after moving this camera by {100 * after:.1f} %"
    )
    cure = "run hypose check --refine and use the calibration that it writes"
    return Finding("extrinsics", (rig.names[c],), text, cure, change.image_px * ratio)


def _moved_alone(rig: CameraRig, tracks: list[MaskTrack], size: Array, c: int) -> CameraRig:
    """The rig with camera c where its tangent planes agree best with the others'."""
    from scipy.optimize import least_squares  # takes long to import

    mine = [k for k in range(len(rig)) if k != c]
    scale = 0.01 * max(float(size[c]), 1.0)

    def at(x: Array) -> CameraRig:
        cameras = list(rig)
        cameras[c] = changed(rig[c], x * np.array([0.02] * 3 + [0.1] * 3))
        return CameraRig(tuple(cameras))

    def rows(x: Array) -> Array:
        moved = at(x)
        out = []
        for k in mine:
            pair = CameraRig((moved[c], moved[k]))
            out.append(tangency(pair, [tracks[c], tracks[k]])[0, 1].ravel())
        r = np.clip(np.nan_to_num(np.concatenate(out)), -50 * scale, 50 * scale) / scale
        return np.r_[r, 0.3 * x]

    found = least_squares(rows, np.zeros(6), loss="soft_l1", max_nfev=12, diff_step=1e-3).x
    return at(found)


def _person(silhouettes: Sequence[Silhouettes | None]) -> Array:
    """Some points (N, 3) of the person, m, from a visual hull; the origin when there is none."""
    for s in silhouettes[:: max(1, len(silhouettes) // 5)]:
        if s is not None and s.usable.sum() > 1:
            try:
                return visual_hull(s).points
            except EvidenceError:
                continue
    return np.zeros((1, 3))


def _unit(rig: CameraRig, size: Array, o: Limits) -> Iterator[Finding]:
    """The person's height from its size in the images and the distance to where the cameras look: good to a third."""
    look = np.stack([c.camera_from_world[2, :3] for c in rig])
    across = np.eye(3) - look[:, :, None] * look[:, None, :]
    middle = np.linalg.lstsq(across.sum(0), (across @ rig.positions[..., None]).sum(0)[:, 0], rcond=None)[0]
    distance = np.linalg.norm(rig.positions - middle, axis=1)
    seen = size > 0
    if seen.any():
        heights = size[seen] * distance[seen] / np.array([c.K[1, 1] for c in rig])[seen]
        yield from height_findings(
            float(np.median(heights)), None, replace(o, heights=(0.6, 3.5), usual_heights=(0.6, 3.5))
        )
