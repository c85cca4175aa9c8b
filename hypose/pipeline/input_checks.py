"""Check some frames for gross faults of the calibration and of the key points' names before tracking.

These are checks of `hypose check` for gross faults, on a dozen frames. Findings are printed before and after the run;
nothing is changed, since the correction is the user's choice.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hypose.calibration.diagnose_masks import focal_by_masks, focal_by_points, focal_findings
from hypose.calibration.diagnose_person import height_findings, person_findings, up_by_cameras
from hypose.calibration.diagnose_points import late_views, timing_findings, undo_point_faults
from hypose.calibration.diagnostics import gross_silhouettes
from hypose.calibration.findings import Finding, Limits, depth_findings
from hypose.calibration.sync_motion import mask_tracks
from hypose.cameras.camera import PARALLEL, widest_angle
from hypose.errors import HyposeError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, Keypoints, Silhouettes, pieces_of
from hypose.evidence.keypoint_check import disagreement
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import FrameList, FrameSource


def check_inputs(
    source: FrameSource, evidence: str, height: float | None = None, frame_rate: float = 25.0
) -> tuple[Finding, ...]:
    """Check the calibration and the key points of a source for gross faults; nothing is checked with one camera.

    evidence: evidence that will be tracked from.
    height: height of the person, m, where known.
    frame_rate: Hz.
    """
    rows, frames = _rows(len(source)), _some(source)
    doubted: Sequence[Keypoints] | None = getattr(
        source, "doubted", None
    )  # key points that were left out because they did not fit
    points = pieces_of(frames, Keypoints)
    if doubted is not None:
        points = [doubted[i] for i in rows.tolist() if i < len(doubted)]
    shown = pieces_of(frames, Silhouettes) if evidence != "keypoints" else []
    masks = [s for s in shown if s.ignored is None]  # parts of a person do not show where cameras stand
    limits = Limits()
    by_depth = depth_findings(pieces_of(frames, Depth))
    found: list[Finding] = []
    if evidence != "silhouettes" and points and len(points[0].rig) > 1:
        found += _by_points(points, height, limits)
        held = [f.keypoints for f in source.frames] if isinstance(source, FrameList) else doubted
        if held is not None and not any(f.fault for f in found):
            found += _in_step(held, frame_rate, limits)
    elif masks and len(masks[0].rig) > 1 and not any(f.kind == "holes" for f in by_depth):  # masks have the same holes
        found += _by_masks(masks, frames, limits)
    return (*found, *by_depth)


def check_depth_inputs(source: FrameSource) -> tuple[Finding, ...]:
    """Check the depth maps alone, also of frames with several people."""
    with contextlib.suppress(HyposeError):
        if not source.frame(0).of(Depth):  # frames spread over videos take long to read
            return ()
    return depth_findings(pieces_of(_some(source), Depth))


def _some(source: FrameSource) -> list[Frame]:
    """Read SETTINGS.look_frames frames spread over a source."""
    frames = list[Frame]()
    for i in _rows(len(source)).tolist():
        with contextlib.suppress(HyposeError):  # an unreadable frame is reported when it is tracked
            frames.append(source.frame(i))
    return frames


def _rows(total: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, total - 1, min(total, SETTINGS.look_frames)).round().astype(np.int64))


def of_measured(stature: float) -> tuple[Finding, ...]:
    """Check whether a height (m) that was measured from masks or depth is plausible for a person.

    Returns: one finding where it is not; empty otherwise.
    """
    return tuple(height_findings(stature, None, Limits()))


def places_refuted(found: Sequence[Finding]) -> bool:
    """Return whether a finding refutes the places of the cameras; then people cannot be separated."""
    return any(f.fault and f.kind in ("places", "swapped", "mirrored") for f in found)


def _in_step(keypoints: Sequence[Keypoints | None], frame_rate: float, o: Limits) -> Iterator[Finding]:
    """Find views that are late or early, from the key points of consecutive frames."""
    begin = max(0, (len(keypoints) - SETTINGS.look_in_step) // 2)
    some = keypoints[begin : begin + SETTINGS.look_in_step]
    first = next((k for k in some if k is not None), None)
    if first is None:
        return
    none = np.zeros((len(first.rig), len(first.names), 3))
    pixels = np.stack([none if k is None else np.nan_to_num(k.points) for k in some], 1)
    late, sd = late_views(first.rig, pixels, o)
    fault = np.ptp(late) > SETTINGS.look_late_s * frame_rate and (late == 0).sum() < SETTINGS.look_outvote
    yield from timing_findings(first.rig, late, sd, fault=bool(fault))


def _by_points(keypoints: Sequence[Keypoints], height: float | None, o: Limits) -> Iterator[Finding]:
    """Check the key points of some frames."""
    rig, names = keypoints[0].rig, keypoints[0].names
    pixels = np.stack([np.nan_to_num(k.points) for k in keypoints], 1)
    if (pixels[..., 2] > 0.3).any((1, 2)).sum() < 2:
        return
    apart, agreed = disagreement(rig, pixels), True
    if apart > SETTINGS.look_scatter:
        # the rest is checked with points that agree
        undone, rig, pixels = undo_point_faults(rig, pixels, names, [None] * len(rig), o, most=1)
        yield from undone
        agreed = bool(undone)
        if not agreed:
            text = f"All cameras: the views' key points disagree by {100 * apart:.0f} % of the person's size"
            yield Finding("scatter", (), text, "run hypose check, which looks for the cause camera by camera", apart)
    flat = pixels.reshape(len(rig), -1, 3)
    seen = np.where(flat[..., 2] > 0.3, flat[..., 2], 0.0)
    parallel = (widest_angle(rig, flat[..., :2], seen) < PARALLEL)[(seen > 0).sum(0) > 1]
    if len(parallel) and parallel.mean() > SETTINGS.look_most_parallel:
        text = (
            "All cameras: they stand side by side, or face each other: how far away "
            f"{100 * parallel.mean():.0f} % of the key points are cannot be told, since the rays to them are parallel"
        )
        yield Finding("parallel", (), text, "add a camera that looks from the side", 1.0)
        return
    person = list(person_findings(rig, pixels, names, height, o))
    if not agreed:  # of contradicting points, only the set of key points can be known
        person = [f for f in person if f.kind == "keypoint_set" and "keypoint_set = " in f.cure]
    elif rig is keypoints[0].rig and not any(f.kind == "keypoint_set" for f in person):  # nothing else was wrong
        yield from focal_findings(focal_by_points(rig, pixels))
    yield from person


def _by_masks(silhouettes: Sequence[Silhouettes], frames: Sequence[Frame], o: Limits) -> Iterator[Finding]:
    """Check the masks of some frames."""
    yield from up_by_cameras(silhouettes[0].rig)
    rig = silhouettes[0].rig
    gross = gross_silhouettes(rig, silhouettes, replace(o, gross=0.04))
    yield from gross or focal_findings(focal_by_masks(rig, mask_tracks(silhouettes)))
