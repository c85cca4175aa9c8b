"""Check some frames for gross faults of the calibration and of the key points' names before tracking.

These are checks of `hypose check` for gross faults, on a dozen frames. Findings are printed before and after the run;
nothing is changed, since the correction is the user's choice.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hypose.calibration.diagnose_masks import MaskViews, focal_findings, gross_silhouettes
from hypose.calibration.diagnose_person import height_findings, person_findings, up_by_cameras
from hypose.calibration.diagnose_points import late_views, timing_findings, undo_point_faults
from hypose.calibration.findings import INVALID, REVIEW, Finding, Limits, depth_findings
from hypose.cameras.camera import PARALLEL, widest_angle
from hypose.errors import HyposeError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, Keypoints, Silhouettes, pieces_of
from hypose.evidence.keypoint_check import disagreement
from hypose.pipeline.assessment import other_people_note
from hypose.pipeline.moved_sensors import moved_sensors
from hypose.pipeline.passes import ClipState, Pass, find_people, solve_keypoints, track_clip
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import ChangedFrames, FrameList, FrameSource, RecordedFrames, placed_source
from hypose.pipeline.subject import measured_height


def check_inputs(
    source: FrameSource, evidence: str, height: float | None = None, frame_rate: float = 25.0, several: bool = False
) -> tuple[Finding, ...]:
    """Check the calibration and the key points of a source for gross faults; nothing is checked with one camera.

    evidence: evidence that will be tracked from.
    height: height of the person, m, where known.
    frame_rate: Hz.
    several: there are several people: only depth maps are checked, since the other checks are of one person.
    """
    if several and not pieces_of(_some(source, 1), Depth):  # frames spread over videos take long to read
        return ()
    frames, limits = _some(source), Limits()
    by_depth = depth_findings(pieces_of(frames, Depth))
    if several:
        return by_depth
    points, held = pieces_of(frames, Keypoints), list[Keypoints | None]()
    if isinstance(source, RecordedFrames):  # also those that were left out because they did not fit
        held = [*source.unchosen]
        points = [source.unchosen[i] for i in _rows(len(source)) if held]
    elif isinstance(source, FrameList):
        held = source.keypoints
    shown = pieces_of(frames, Silhouettes) if evidence != "keypoints" else []
    masks = [s for s in shown if s.ignored is None]  # parts of a person do not show where cameras stand
    found: list[Finding] = []
    if evidence != "silhouettes" and points and len(points[0].rig) > 1:
        found += _by_points(points, height, limits)
        if held and not any(f.fault for f in found):
            found += _in_step(held, frame_rate, limits)
    elif masks and len(masks[0].rig) > 1 and not any(f.kind == "holes" for f in by_depth):  # masks have the same holes
        found += up_by_cameras(masks[0].rig)
        seen = MaskViews.of(masks)
        found += gross_silhouettes(seen, replace(limits, gross=0.04)) or focal_findings(seen.rig, seen.of_some)
    return (*found, *by_depth)


def _some(source: FrameSource, most: int = SETTINGS.look_frames) -> list[Frame]:
    """Read some frames spread over a source."""
    frames = list[Frame]()
    for i in _rows(len(source), most):
        with contextlib.suppress(HyposeError):  # an unreadable frame is reported when it is tracked
            frames.append(source.frame(i))
    return frames


def _rows(total: int, most: int = SETTINGS.look_frames) -> list[int]:
    return np.unique(np.linspace(0, total - 1, min(total, most)).round().astype(int)).tolist()


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
        yield from focal_findings(rig, lambda cameras, kept: disagreement(cameras, pixels[kept]))
    yield from person


# ---- passes ----------------------------------------------------------------------------------------------------------


def check_evidence(clip: ClipState) -> ClipState:
    """Check masks, key points and cameras against each other before tracking, and add the findings."""
    options, several = clip.options, clip.finder is not None
    clip.progress("look", 0, 1)
    found = check_inputs(clip.source, options.looks_at, options.height, clip.frame_rate, several)
    # wrong cameras can make one person look like two
    more = clip.source.others if isinstance(clip.source, RecordedFrames) and not several else 0
    note = () if places_refuted(found) else other_people_note(more, "key points", "--people all")
    clip.progress("look", 1, 1)
    return clip.with_findings(*found, *note)


def place_sensors(clip: ClipState) -> ClipState:
    """Correct the places of depth cameras that stand elsewhere than the source says, and track all frames again."""
    done = clip.estimates
    if not clip.complete or clip.finder is not None:
        return clip
    poses, costs = np.stack([e.pose for e in done]), np.array([e.cost for e in done])
    places, moved = moved_sensors(clip.source, clip.who.body, poses, 1 - costs, clip.frame_rate)
    if not places:
        return clip
    clip = replace(clip, source=placed_source(clip.source, places), places=places, findings=(*clip.findings, *moved))
    subject = clip.who
    if places[0].since == 0 and not clip.given:  # the body was fitted with wrong camera places
        subject = clip.find(clip)
        clip = replace(clip, notes=subject.notes)
    clip = replace(clip, people=(clip.at_start(subject),))
    return track_clip(clip, checkpoint=False)


def leave_out_masks(clip: ClipState) -> ClipState:
    """Leave out the masks of a camera that contradict those of all others, and find and track the person again.

    Why: a network that sees the person from the ceiling gives masks of a wrong shape in every frame, which distort the
    body and its poses. The camera is the one whose masks the tracked body misses by far the most; three others remain.
    """
    if not clip.complete or clip.finder is not None or clip.source.frame(0).of(Depth):
        return clip
    found = np.stack([e.seen[:, 0] for e in clip.estimates])  # overlap of the body with each mask
    seen = np.flatnonzero(np.isfinite(found).mean(0) > 0.5)
    missed = 1 - np.nanmedian(found[:, seen], axis=0)
    if len(seen) < 4 or missed.max() < SETTINGS.masks_apart * np.median(missed):
        return clip
    worst, names = int(seen[missed.argmax()]), clip.source.frame(0).the(Silhouettes).rig.names
    text = (
        f"{names[worst]}: its masks overlap with the body by {1 - missed.max():.2f}, those of the others by "
        f"{1 - np.median(missed):.2f}; they contradict all other cameras and are left out"
    )
    clip = clip.with_findings(Finding("masks", (names[worst],), text, "look at its masks", severity=REVIEW))
    clip = replace(clip, source=ChangedFrames(clip.source, partial(_unmasked, worst), range(len(clip.source))))
    subject = clip.who if clip.given else clip.find(clip)
    return track_clip(replace(clip, people=(clip.at_start(subject),), notes=subject.notes), checkpoint=False)


def _unmasked(view: int, _: int, frame: Frame) -> Frame:
    """Return the frame without the mask of a view."""
    for given in frame.of(Silhouettes):
        kept = np.arange(len(given.rig)) != view
        reasons = tuple(r if k else "it contradicts all others" for k, r in zip(kept, given.reasons, strict=True))
        masks = np.where(kept[:, None, None], given.masks, np.uint8(0))
        return replace(frame, silhouettes=replace(given, masks=masks, usable=given.usable & kept, reasons=reasons))
    return frame


def check_height(clip: ClipState) -> ClipState:
    """Check whether the body's height is plausible, and compare a given height or body with the height that masks or
    depth show; add the findings.
    """
    o, estimates = clip.options, clip.estimates
    if clip.given or clip.who.keypoints is not None or clip.finder is not None:
        return clip
    body = clip.who.body
    if o.height is None and clip.body is None:
        clip = clip.with_findings(*height_findings(body.stature, None, Limits()))
    asked = o.height if clip.body is None else clip.body.stature
    if asked is None or clip.method is not None or not clip.complete or o.looks_at == "keypoints":
        return clip
    poses, iou = np.stack([e.pose for e in estimates]), 1 - np.array([e.cost for e in estimates])
    reported = measured_height(clip.source.frame, body, poses, iou)
    off = 0.0 if reported is None else abs(reported / asked - 1)
    if reported is None or off <= SETTINGS.subject_height_off[0]:
        return clip
    severity = INVALID if off > SETTINGS.subject_height_off[1] else REVIEW
    text = (
        f"the person is {reported:.2f} m tall by what the cameras see, not {asked:.2f} m as given: leave the height "
        "out or correct it, give the person's own body, or check the scale of the calibration (the board's square size)"
    )
    return clip.with_findings(Finding("height", (), text, size=off, severity=severity))


CHECKED: tuple[Pass, ...] = (check_evidence, find_people, track_clip, place_sensors, leave_out_masks, check_height)
"""Passes of one or more people together, with the checks of a recording's cameras."""
CHECKED_KEYPOINTS: tuple[Pass, ...] = (check_evidence, find_people, solve_keypoints)
"""The same where the key points of all frames are solved together; then the passes `SOLVED_TOGETHER` run."""
