"""Collect evidence of a recording to check its calibration (`hypose check`), and refine the calibration from the
person.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.calibration.diagnose_masks import tangency_by_view
from hypose.calibration.diagnose_points import FAR_DEG, FAR_M
from hypose.calibration.diagnostics import Cured, Observed, ViewFile
from hypose.calibration.refine_body import adjust_with_body
from hypose.calibration.refine_points import (
    CameraChange,
    adjust,
    changes,
    gauge,
    point_residual,
    scale_rig,
    transform_rig,
)
from hypose.calibration.sync_motion import mask_tracks
from hypose.calibration.synchronisation import Resampled, points_at
from hypose.cameras.camera import CameraRig
from hypose.errors import EvidenceError, InputError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.keypoint_check import triangulated, undistorted
from hypose.evidence.keypoints import triangulate_keypoints
from hypose.evidence.terms import contour_term
from hypose.geometry import Array, transform
from hypose.io.recordings.frames import FrameStream, RecordedPerson, load_keypoints, load_person, unreported
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.recording_views import ViewSettings, open_pictures
from hypose.pipeline.recorded_frames import frames_to_examine
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject import with_outlines
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.tracking.subject import shape_from_keypoints, subject_from_keypoints

_Progress = Callable[[str, int, int], None]
_METHODS = ("keypoints", "silhouettes")
LEFT_OUT, ALL_VIEWS, TANGENTS = "Key points, one camera left out", "Key points, all cameras", "Silhouettes"


@dataclass(frozen=True)
class Refinement:
    """Refined calibration of a recording.

    rig: cameras in the old world, with the old lenses.
    method: "keypoints" or "silhouettes".
    used: frames from which the refinement was computed.
    changes: how far each camera was moved and turned.
    residuals: median residuals before and after, px, on frames that were not used, the most telling first: of key
        points from the triangulation of the other views (LEFT_OUT) and of all views (ALL_VIEWS), and of the planes
        tangent to the silhouettes (TANGENTS); those without evidence are missing.
    notes: sentences for the user.
    """

    rig: CameraRig
    method: str
    used: tuple[int, ...]
    changes: tuple[CameraChange, ...]
    residuals: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...] = ()

    @property
    def far(self) -> tuple[str, ...]:
        """Cameras that were turned by more than 10 degrees or moved by more than 0.5 m. Then the evidence is more
        likely of another person than the calibration so wrong.
        """
        return tuple(c.name for c in self.changes if c.turn_deg > FAR_DEG or c.move_m > FAR_M)


def window(recording: Recording, most: int) -> Recording:
    """Limit a recording to `most` consecutive frames from the middle of its range."""
    frames = recording.frames
    if len(frames) <= most:
        return recording
    first = frames[0] + (len(frames) - most) // 2
    return replace(recording, frame_range=(first, first + most))


def observe_recording(recording: Recording, most: int = 100, progress: _Progress = unreported) -> Observed:
    """Collect the evidence for a check of the calibration from at most `most` consecutive frames: key points as
    stored, and masks that are made without using the key points.
    """
    few = window(recording, most)
    person = raw_person(few)
    silhouettes = list[Silhouettes | None]()
    depths: list[Depth] = []
    together = False
    blind = replace(few, views=tuple(v.without("keypoints") for v in few.views), keypoint_set=None)
    if all(v.has_pictures for v in few.views):
        stream, together = frames_to_examine(blind, progress)
        with stream:
            for i in range(len(stream)):
                progress("masks", i, len(stream))
                frame = stream.frame(i)
                silhouettes.append(frame.silhouettes)
                depths += frame.of(Depth)
            progress("masks", len(stream), len(stream))
        if person.keypoints and (together or person.one.several):
            silhouettes = [
                None if s is None else _near(s, k) for s, k in zip(silhouettes, person.keypoints, strict=False)
            ]
    clips = tuple(replace(_clip(v), accepted=v.accept_scaled) for v in recording.views)
    notes = *person.one.notes, *person.held
    if together and not person.keypoints:
        notes = ("several people stand in the masks, and are looked at together",)
    about = recording.frame_rate, recording.subject_height, notes
    return Observed(
        few.rig,
        person.raw,
        person.names,
        silhouettes,
        clips,
        *about,
        depths[:: max(1, len(depths) // SETTINGS.look_frames)],
    )


def _near(silhouettes: Silhouettes, keypoints: Keypoints) -> Silhouettes:
    """Remove other people from the masks: everything far outside the box around the person's key points."""
    masks, usable = silhouettes.masks.copy(), silhouettes.usable.copy()
    for c, small in enumerate(silhouettes.rig):
        w, h = small.size
        p = keypoints.points[c]
        p = (p[p[:, 2] > 0.2][:, :2] + 0.5) * (np.array(small.size) / keypoints.rig[c].size) - 0.5
        if len(p) < 4:
            masks[c], usable[c] = 0, False
            continue
        margin = SETTINGS.examine_around * float(np.ptp(p, axis=0).max())
        low = np.clip(np.floor(p.min(0) - margin), 0, (w, h)).astype(int)
        high = np.clip(np.ceil(p.max(0) + margin), 0, (w, h)).astype(int)
        inside = masks[c, low[1] : high[1], low[0] : high[0]].copy()
        masks[c] = 0
        masks[c, low[1] : high[1], low[0] : high[0]] = inside
        usable[c] &= bool(inside.any())
    return replace(silhouettes, masks=masks, usable=usable)


def _clip(view: ViewSettings) -> ViewFile:
    if not view.has_pictures:
        return ViewFile()
    with open_pictures(view) as reader:
        return ViewFile(reader.size, reader.frame_rate, reader.n_frames)


def raw_person(recording: Recording) -> RecordedPerson:
    """Load the person's key points of a recording whose calibration is in doubt, in full-size pictures."""
    return load_person(recording, recording.rig.pinhole(), keep_misfits=True)


def cured_recording(recording: Recording, cured: Cured) -> Recording:
    """Correct a recording by the lag (time offsets) and the image shift of views that the check measured.

    Returns: the corrected recording; the files are not changed.
    """
    views = [
        replace(v, image_shift=(v.image_shift[0] + float(s[0]), v.image_shift[1] + float(s[1])))
        for v, s in zip(recording.views, cured.shift, strict=True)
    ]
    return replace(recording, views=tuple(views), keypoint_lag=recording.keypoint_lag + cured.keypoint_lag)


def refine_recording(
    recording: Recording,
    method: str = "keypoints",
    *,
    late: Array | None = None,
    focal: bool = False,
    fixed: tuple[str, ...] = (),
    height: float | None = None,
    most: int = 150,
    progress: _Progress = unreported,
) -> Refinement:
    """Refine the poses of a recording's cameras (with `focal` the focal lengths) from the moving person.

    recording: with corrected lag and shift (`cured_recording`).
    method: keypoints (bundle adjustment) or silhouettes (contours of the tracked body, with key points only for the
        start).
    late: (C,) frames by which views are late.
    fixed: names of cameras that stay.
    height: height of the person, m, sets the scale; None: the length of the person's limbs is kept.
    most: most frames that are used.
    Raises: EvidenceError or InputError names the missing input.
    """
    if method not in _METHODS:
        raise InputError(f"There is no refinement from {method!r}; choose {', '.join(_METHODS)}.")
    if len(recording.rig) < 2:
        raise InputError(
            "A calibration of one camera cannot be refined from the person; at least two views are needed."
        )
    few = window(recording, most)
    late = np.zeros(len(few.rig)) if late is None else late
    person = raw_person(few)
    if not person.keypoints and method != "silhouettes":
        raise InputError(f"The recording {few.name} has no key points; refine from silhouettes.")
    points = np.stack([points_at(p, x) for p, x in zip(person.raw, late, strict=True)])
    n = len(few.frames)
    used = np.unique(np.linspace(0, n - 1, min(SETTINGS.examine_used, (n + 1) // 2) + 2).astype(np.int64))[1:-1]
    if len(used) < 3:
        raise InputError(f"{n} frames are too few to refine a calibration and to judge it; give at least 10.")
    rest = np.setdiff1d(np.arange(n, dtype=np.int64), used).astype(np.int64)
    if fixed:
        few.rig.select(fixed)  # its error lists the names that exist
    free = np.array([c.name not in fixed for c in few.rig])
    judged, notes = list[Silhouettes | None](), list[str]()
    if method == "keypoints":
        refined, there = _by_points(few.rig, points, used, focal, free)
    else:
        refined, there, judged, notes = _by_body(few, late, load_keypoints(few), used, rest, focal, free, progress)
    factor = _scale(few.rig, refined, points, used, person.names, height, notes)
    refined = scale_rig(refined, factor)
    old_from_new = gauge(refined, few.rig, there * factor)
    refined = transform_rig(refined, old_from_new)
    return Refinement(
        refined,
        method,
        tuple(int(few.frames[k]) for k in used),
        changes(few.rig, refined, transform(old_from_new, there * factor)),
        _residuals((few.rig, refined), points[:, rest] if points.size else points, judged),
        tuple(notes),
    )


def _residuals(
    rigs: tuple[CameraRig, CameraRig], points: Array, silhouettes: Sequence[Silhouettes | None]
) -> dict[str, tuple[float, float]]:
    """Compute the median residuals with the old and the new cameras on frames that were not used; see `Refinement`.

    points: (C, T, K, 3) distorted px, and confidence; T is 0 without key points.
    silhouettes: masks of some of the frames.
    """
    out: dict[str, tuple[float, float]] = {}
    if points.size:
        seen = [undistorted(rig, points) for rig in rigs]
        flat = [(uv.reshape(len(uv), -1, 2), confidence.reshape(len(uv), -1)) for uv, confidence in seen]
        for what in (LEFT_OUT, ALL_VIEWS):
            found = [point_residual(r, *of, left_out=what == LEFT_OUT) for r, of in zip(rigs, flat, strict=True)]
            before, after = (float(np.nanmedian(r)) if np.isfinite(r).any() else np.nan for r in found)
            out[what] = before, after
    known = [s for s in silhouettes if s is not None]
    if known:
        small, tracks = known[0].rig, mask_tracks(known)
        moved = [
            CameraRig(tuple(replace(a, camera_from_world=b.camera_from_world) for a, b in zip(small, rig, strict=True)))
            for rig in rigs
        ]
        px = rigs[0].sizes[:, 0] / small.sizes[:, 0]
        before, after = (float(np.nanmean(tangency_by_view(rig, tracks) * px)) for rig in moved)
        out[TANGENTS] = before, after
    return {what: pair for what, pair in out.items() if np.isfinite(pair).all()}


def _by_points(
    rig: CameraRig, points: Array, used: NDArray[np.int64], focal: bool, free: NDArray[np.bool_]
) -> tuple[CameraRig, Array]:
    uv, confidence = undistorted(rig, points[:, used])
    c = len(rig)
    found = adjust(rig.pinhole(), uv.reshape(c, -1, 2), confidence.reshape(c, -1), free, focal=focal)
    return _poses_into(rig, found.rig), found.points


def _poses_into(full: CameraRig, refined: CameraRig) -> CameraRig:
    """Return the cameras `full` with the poses and focal factors of refined cameras of any working size."""
    out = []
    for a, b in zip(full, refined, strict=True):
        k = a.K.copy()
        # both focal lengths scale with the size of the image
        k[0, 0] = b.K[0, 0] * a.size[0] / b.size[0]
        k[1, 1] = b.K[1, 1] * a.size[1] / b.size[1]
        out.append(replace(a, K=k, camera_from_world=b.camera_from_world))
    return CameraRig(tuple(out))


def _by_body(
    recording: Recording,
    late: Array,
    keypoints: Sequence[Keypoints],
    used: NDArray[np.int64],
    rest: NDArray[np.int64],
    focal: bool,
    free: NDArray[np.bool_],
    progress: _Progress,
) -> tuple[CameraRig, Array, list[Silhouettes | None], list[str]]:
    # masks that do not depend on the key points
    blind = replace(recording, views=tuple(v.without("keypoints") for v in recording.views), keypoint_set=None)
    with FrameStream(blind, progress=progress) as stream:
        source = Resampled(stream, late)
        frames = list[Frame]()
        for done, k in enumerate(used):
            progress("masks", done, len(used))
            frames.append(source.frame(int(k)))
        progress("masks", len(used), len(used))
        judged = [source.frame(int(k)).silhouettes for k in rest[:: max(1, len(rest) // 16)]]
        if keypoints:
            shown = np.stack([k.points for k in keypoints], 1)
            shown = np.stack([points_at(p, float(x)) for p, x in zip(shown, late, strict=True)], 1)
            body, poses, notes = _start_from_points(frames, [replace(keypoints[k], points=shown[k]) for k in used])
        else:
            body, poses, notes = _start_from_masks(source, recording, used, progress)
    seen_at = [(i, s) for i, f in enumerate(frames) if np.isfinite(poses[i]).all() for s in f.of(Silhouettes)]
    if not seen_at:
        raise EvidenceError("No frame has both silhouettes and a pose to refine the calibration with.")
    kept = [i for i, _ in seen_at]
    evidence = [[contour_term(silhouettes)] if silhouettes.usable.any() else [] for _, silhouettes in seen_at]
    small = stream.rig
    progress("refine", 0, 1)
    found = adjust_with_body(body, small, poses[kept], evidence, free, focal=focal)
    progress("refine", 1, 1)
    person = body.joints(found.poses).reshape(-1, 3)
    return _poses_into(recording.rig, found.rig), person, judged, notes


def _start_from_points(frames: Sequence[Frame], keypoints: Sequence[Keypoints]) -> tuple[Body, Array, list[str]]:
    points, _, _ = triangulate_keypoints(keypoints)
    fitted = subject_from_keypoints(human(), points, keypoints[0].names)
    shaped = with_outlines(fitted, frames)
    if shaped is None:
        raise EvidenceError("No frame has usable silhouettes; refine from key points.")
    return shaped[0], fitted.poses, ["lengths of the body and start poses from the key points"]


def _start_from_masks(
    source: Resampled, recording: Recording, used: NDArray[np.int64], progress: _Progress
) -> tuple[Body, Array, list[str]]:
    options = TrackOptions(height=recording.subject_height)
    result = track_source(source, recording.frame_rate, options, progress=progress)
    poses = result.motion.poses
    assert poses is not None
    return result.body, poses[used], ["body and start poses tracked from silhouettes alone", *result.notes]


def _scale(
    old: CameraRig,
    new: CameraRig,
    points: Array,
    used: NDArray[np.int64],
    names: tuple[str, ...],
    height: float | None,
    notes: list[str],
) -> float:
    """Compute the scale factor that keeps the length of the person's limbs, or makes the person as tall as given."""
    if not points.size:
        return 1.0  # the size of the body has fixed the scale
    try:
        worlds = [triangulated(rig, points[:, used]) for rig in (old, new)]
        before, after = (shape_from_keypoints(human(), world, names).scale for world in worlds)
    except EvidenceError:
        return 1.0
    if height is not None:
        notes.append(f"scale from the person's height of {height:.2f} m")
        return height / (after * human().stature)
    return float(np.clip(before / after, 0.5, 2.0))
