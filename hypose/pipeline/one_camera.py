"""Prepare tracking with one camera: frames with pictures, the start, and how much of the picture contradicts a result.

A track starts from joints clicked in its first picture (a JSON file), or from key points of a detector.

The file of clicks has pixels of the picture as it was recorded, (0, 0) in the middle of the upper left pixel:

    {"camera": "cam1", "frame": 0, "joints": {"left_shoulder": [512.0, 310.5], "left_elbow": [540, 402], ...}}

camera and frame (number in the recording, the first that is tracked) may be left out; joints are those of the body
model. At least six are needed; shoulders, elbows, wrists, hips, knees, ankles, neck and head are a good set.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.motion import Modes, Motion
from hypose.calibration.findings import REVIEW, Finding
from hypose.cameras.camera import Camera
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.keypoints import person_size
from hypose.geometry import Array, runs
from hypose.io.files import read_json
from hypose.io.videos.video import frame_size
from hypose.pipeline.frame_anomalies import in_words
from hypose.pipeline.passes import AFTER_TRACKING, ClipState, Pass, judge_joints
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import PictureFrames, RecordedFrames
from hypose.pipeline.subject import TrackedSubject
from hypose.tracking.error_model import probability_by_spread
from hypose.tracking.frame_evidence import MIN_CONFIDENCE, keypoint_model
from hypose.tracking.monocular.initialise import LEAST_CLICKS, initialise
from hypose.tracking.monocular.points import FEWEST_PX, PointsOn, clicked_joints, keypoints_on, seen_points
from hypose.tracking.monocular.settings import MonoSettings

if TYPE_CHECKING:  # recordings are opened elsewhere
    from hypose.io.recordings.recording import Recording


def depth_note(motion: Motion, modes: Modes) -> str:
    """Write a note for the user: how uncertain the depth of the joints is, in mm, and how many other poses are
        possible.

    motion, modes: the result, and the alternative poses of its frames.
    """
    depth = 1e3 * float(np.nanmedian(modes.depth_sd))
    whole = 3 * np.asarray(motion.joint_sd) ** 2
    across = 1e3 * float(np.nanmedian(np.sqrt(np.maximum(whole - modes.depth_sd**2, 0.0) / 2)))
    rival = modes.alive > 1
    spread = 0.0
    if rival.any():
        apart = np.linalg.norm(modes.joints[:, 1:] - modes.joints[:, :1], axis=-1)
        spread = 1e3 * float(np.nanmedian(np.nanmax(apart[rival], axis=(1, 2))))
    others = np.median(modes.alive) - 1
    return (
        f"one camera does not measure depth: along its line of sight a joint is known to +-{depth:.0f} mm (1 sd, "
        f"median), across it to +-{across:.0f} mm; {others:.0f} other poses explain the pictures nearly as "
        f"well as the best one (median), with joints up to {spread:.0f} mm elsewhere: see modes.npz"
    )


POINT_STARTS = ("auto", "keypoints")
"""Start options that do not name a file of clicks."""

Clicks = Mapping[str, tuple[float, float]]
"""Clicked joints in a recorded picture: name -> (u, v), px."""


def load_clicks(path: str | Path, recording: Recording) -> Clicks:
    """Read a file of joints that were clicked in the first picture of the one camera of a recording.

    path: JSON file with "joints": {name: [u, v]}, px of the stored picture.
    Returns: (u, v) px by joint name.
    Raises: InputError where the file is not of this form, belongs to another camera or frame, or has too few joints.
    """
    path = Path(path)
    view = recording.views[0]
    document = read_json(path, "a file of clicks")
    if not isinstance(document, dict) or not isinstance(document.get("joints"), dict):
        raise InputError(f'The file of clicks {path} needs "joints": {{name: [u, v], ...}}; see docs/monocular.md.')
    if document.get("camera", view.name) != view.name:
        raise InputError(
            f"The clicks in {path} belong to camera {document['camera']!r}, and {view.name} is to be tracked; give "
            "--camera or other clicks."
        )
    first = recording.frames[0]
    if document.get("frame", first) != first:
        raise InputError(
            f"The clicks in {path} belong to frame {document['frame']}, and tracking begins at frame {first}; give "
            f"--frames {document['frame']}: or click in frame {first}."
        )
    size = picture_size(recording)
    joints = {name: _click(path, name, at, size) for name, at in document["joints"].items()}
    if len(joints) < LEAST_CLICKS:
        raise InputError(f"{path} holds {len(joints)} clicked joints; at least {LEAST_CLICKS} are needed to start.")
    return joints


def _click(path: Path, name: str, at: Any, size: tuple[int, int]) -> tuple[float, float]:
    """Check one click of a file and return it as (u, v), px.

    path: path of the file, for messages.
    name, at: joint and its value in the file.
    size: (width, height) size of the picture.
    Raises: InputError where the joint does not exist, or its place is not two numbers inside the picture.
    """
    if name not in JOINT_NAMES:
        raise InputError(f"{path}: there is no joint {name!r}; the joints are {', '.join(JOINT_NAMES)}.")
    numbers = isinstance(at, list) and len(at) == 2 and all(type(x) in (int, float) and np.isfinite(x) for x in at)
    if not numbers:
        raise InputError(f"{path}: {name} must be two numbers [u, v] in pixels, got {json.dumps(at)[:40]}.")
    u, v = float(at[0]), float(at[1])
    if not (-0.5 <= u <= size[0] - 0.5 and -0.5 <= v <= size[1] - 0.5):
        raise InputError(
            f"{path}: {name} was clicked at ({u:g}, {v:g}), outside the picture of {size[0]} x {size[1]} px; leave out "
            "joints that are not in the picture."
        )
    return u, v


def clicked_pixels(clicks: Clicks, recording: Recording, working: Camera) -> dict[str, tuple[float, float]]:
    """Convert clicks to undistorted pixels of the working camera.

    clicks: (u, v) px of the stored picture by joint name.
    working: pinhole camera of the working size.
    Returns: (u, v) px by joint name.
    """
    view, camera = recording.views[0], recording.rig[0]
    pixels = np.array(list(clicks.values()))
    calibrated = (pixels + 0.5) * np.array(camera.size) / picture_size(recording) - 0.5 + np.asarray(view.image_shift)
    shown = (camera.undistort_points(calibrated) + 0.5) * np.array(working.size) / np.array(camera.size) - 0.5
    return {name: (float(u), float(v)) for name, (u, v) in zip(clicks, shown, strict=True)}


def extent(pixels: Array) -> float:
    """Compute the larger side, px, of the box around points (N, 2)."""
    return float(np.ptp(pixels, axis=0).max())


def picture_size(recording: Recording) -> tuple[int, int]:
    """Return the size (width, height) of the stored pictures of a recording of one camera, px."""
    source = recording.views[0].source
    assert source is not None  # `one_view` has checked it
    return frame_size(source)


def clicks_of(start: str, recording: Recording) -> Clicks | None:
    """Load the clicks that a track starts from; None where it starts from key points.

    Raises: InputError where `start` is neither a file nor one of POINT_STARTS.
    """
    if start in POINT_STARTS:
        return None
    if not Path(start).is_file():
        raise InputError(
            f"--start {start} is no file of clicked joints, and with one camera it can otherwise only be "
            f"{' or '.join(POINT_STARTS)}; give one of these."
        )
    return load_clicks(start, recording)


def find_in_picture(clip: ClipState) -> TrackedSubject:
    """Find the body and rival start poses of the person of a clip from the pictures of one camera.

    Raises: InputError or EvidenceError where there is nothing to start from.
    """
    source, body, height, frame_rate = clip.source, clip.body, clip.options.height, clip.frame_rate
    start, floor = clip.options.start, clip.options.own.get("floor")
    recorded = isinstance(source, RecordedFrames)
    name = source.recording.views[0].name if recorded else "in memory"
    seen = (
        dict(enumerate(source.keypoints))  # without reading pictures
        if recorded
        else {i: points for i in range(len(source)) for points in source.frame(i).of(Keypoints)}
    )
    used = ["edges", "optical flow", *(["silhouettes"] if recorded and Silhouettes in source.kinds else [])]
    used += ["key points"] if seen and clip.options.looks_at in ("auto", "keypoints", "both") else []
    notes = [f"one camera ({name}): {', '.join(used)}"]
    with contextlib.closing(PictureFrames(source)) as frames:
        template = body or human()
        if start in POINT_STARTS:
            at, points = _first_keypoints(name, seen, frame_rate)
            frame = frames.frame(at)
            reported = f"the key points of frame {frame.index}"
            points_on: PointsOn = partial(keypoints_on, points)
        elif isinstance(source, RecordedFrames):
            at, frame = 0, frames.frame(0)
            clicks = load_clicks(start, source.recording)
            reported = f"{len(clicks)} clicked joints"
            pixels = clicked_pixels(clicks, source.recording, source.rig[0])
            scale = max(FEWEST_PX, SETTINGS.picture_click_share * extent(np.array(list(pixels.values()))))
            points_on = partial(clicked_joints, clicks=pixels, camera=source.rig[0], scale_px=scale)
        else:
            raise InputError(f"Clicks ({start}) belong to a recording; frames in memory start from their key points.")
        # frames over the whole clip, from which lengths of the body are measured
        rows = np.unique(np.linspace(at, len(source) - 1, SETTINGS.picture_length_frames + 1).astype(int))[1:].tolist()
        later = [partial(keypoints_on, seen[i]) for i in rows if body is None and i in seen and _enough(seen[i])]
        fit = initialise(
            template,
            points_on,
            frame,
            later=later,
            settings=MonoSettings(frame_rate=frame_rate),
            height=height,
            fixed_body=body is not None,
            floor=floor,
        )
    rivals = fit.hypotheses
    notes.append(f"start from {reported}: {rivals.count} rival poses, the best {fit.residual_px:.1f} px off")
    if body is None:
        further = f", the key points of {len(later)} further frames" if later else ""
        notes.append(f"body of {fit.body.stature:.2f} m from {reported}{further} and the picture's contours")
    if floor is not None:
        notes.append(f"the lower foot is taken to stand on a floor at z = {floor:g} m (--floor)")
    if body is not None and height is not None:
        notes.append("the given height is not used: the body is given")
    if body is None and height is None:
        notes.append(
            "the height is not known, so distances and lengths are as uncertain as people's heights (about 5 %); give "
            "--height"
        )
    return TrackedSubject(fit.body, None, rivals.best(), tuple(notes), rivals)


def _enough(seen: Keypoints) -> bool:
    """Return whether enough key points are seen for a start."""
    return seen_points(keypoints_on(seen, human())) >= LEAST_CLICKS


def _first_keypoints(name: str, seen: Mapping[int, Keypoints], frame_rate: float) -> tuple[int, Keypoints]:
    """Find the first frame of the first second with enough key points; return its number and its key points.

    name: name of the camera.
    seen: key points by frame.
    frame_rate: Hz.
    Raises: InputError without any key points; EvidenceError where no frame of the first second has enough.
    """
    if not seen:
        raise InputError(
            f"Camera {name} has no key points and no clicks were given, so there is nothing to start from; click "
            "joints in the first picture and give --start clicks.json, or add keypoints = ... in recording.toml."
        )
    for i in range(1 + int(frame_rate)):
        if i in seen and _enough(seen[i]):
            return i, seen[i]
    raise EvidenceError(
        f"Camera {name}: no frame of the first second has {LEAST_CLICKS} confident key points; give --frames to begin "
        "later, or --start clicks.json."
    )


_LEAST_POINTS, _LIMBS = 4, ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
"""Least number of key points that are compared, and their joints. Why limbs only: the many points of a face would
outweigh an arm."""


def image_deviation(body: Body, poses: Array, frames: Iterable[Frame]) -> Array:
    """Compute per frame the share of the limbs' key points that are far from the posed body; in frames without key
    points, the share of the joints that are far outside the mask.

    body: the person's body.
    poses: (T, D) pose vectors, rad and m; a pose that is not finite gives NaN.
    frames: T frames of one camera.
    Returns: (T,) 0 to 1; NaN where the picture shows too little of the person.
    """
    out = np.full(len(poses), np.nan)
    for t, frame in enumerate(frames):
        if not np.isfinite(poses[t]).all():
            continue
        by_masks = [_outside(body, poses[t], masks) for masks in frame.of(Silhouettes)]
        for found in [_far(body, poses[t], points) for points in frame.of(Keypoints)] or by_masks:
            out[t] = found
    return out


def against_the_picture(share: Array) -> tuple[Finding, ...]:
    """Make the finding that a motion does not fit the picture.

    share: (T,) of `image_deviation`.
    Returns: one finding; none where the mean share is at most SETTINGS.picture_deviation or all are NaN.
    """
    if not np.isfinite(share).any() or np.nanmean(share) <= SETTINGS.picture_deviation:
        return ()
    where = in_words(runs(np.nan_to_num(share) > SETTINGS.picture_deviation))
    text = (
        f"{100 * np.nanmean(share):.0f} % of what the picture shows of the person lies elsewhere than on the body, "
        f"above all in {where}: look at the overlay, and whether key points and camera are those of this video; begin "
        "elsewhere with --frames, or give --start with clicked joints"
    )
    return (Finding("picture", (), text, size=float(np.nanmean(share))),)


def _far(body: Body, pose: Array, keypoints: Keypoints) -> float:
    """Compute the share of the seen key points of the limbs that are farther than SETTINGS.picture_far times the
    person's size in the picture from those of a posed body.

    pose: (D,) pose vector, rad and m.
    keypoints: key points of one camera.
    Returns: 0 to 1; NaN where fewer than four key points of the limbs are seen.
    """
    points = np.nan_to_num(keypoints.points[0])
    model = keypoint_model(body, keypoints.names)
    limb = np.array([n.startswith(("left_", "right_")) and n.endswith(_LIMBS) for n in keypoints.names])
    seen = limb & model.known & (points[:, 2] > MIN_CONFIDENCE)
    size = person_size(points)
    if seen.sum() < _LEAST_POINTS or not size > 0:
        return np.nan
    uv = keypoints.rig[0].project_pinhole(model.positions(body, pose))
    return float((np.linalg.norm(uv - points[:, :2], axis=1)[seen] > SETTINGS.picture_far * size).mean())


def _outside(body: Body, pose: Array, silhouettes: Silhouettes) -> float:
    """Compute the share of the joints of a posed body that are farther outside the mask than SETTINGS.picture_outside
    times the longer side of its box; joints outside the picture do not count.

    pose: (D,) pose vector, rad and m.
    silhouettes: silhouettes of one camera.
    Returns: 0 to 1; NaN without a mask, or with no joint in the picture.
    """
    w, h = silhouettes.rig[0].size
    mask = np.minimum(silhouettes.masks[0, :h, :w], 1)
    if not silhouettes.usable[0] or not mask.any():
        return np.nan
    away = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 3)
    uv = np.rint(silhouettes.rig[0].project_pinhole(body.joints(pose))).astype(int)
    inside = (uv >= 0).all(1) & (uv[:, 0] < w) & (uv[:, 1] < h)
    if not inside.any():
        return np.nan
    return float(
        (away[uv[inside, 1], uv[inside, 0]] > SETTINGS.picture_outside * max(cv2.boundingRect(mask)[2:])).mean()
    )


# ---- passes ----------------------------------------------------------------------------------------------------------


def assess_picture(clip: ClipState) -> ClipState:
    """Judge the motion of one camera by its picture; the modes give the other possible poses.

    The motion gets frames of low confidence and, by its covariance, the error probability of each joint; its
    uncertainty is in the modes.
    """
    motion = clip.motion
    assert motion is not None and motion.poses is not None and clip.modes is not None
    deviation = image_deviation(clip.who.body, motion.poses, clip.frames(range(len(motion))))
    low_confidence = deviation > SETTINGS.picture_deviation_frame
    before = motion.low_confidence
    low_confidence = low_confidence if before is None else before | low_confidence
    p = probability_by_spread(motion.joint_covariance).astype(np.float32)
    motion = replace(motion, low_confidence=low_confidence, error_probability=p)
    sd = 1e3 * float(np.nanmedian(clip.modes.depth_sd))
    text = (
        f"one camera does not measure depth, which is known to +-{sd:.0f} mm (1 sd, median) as far as the lens and the "
        "person's size are right: see the notes"
    )
    found = *against_the_picture(deviation), Finding("depth", (), text, size=sd, severity=REVIEW)
    notes = (*clip.notes, depth_note(motion, clip.modes))
    return replace(clip, motion=motion, notes=notes).with_findings(*found)


IN_PICTURE: tuple[Pass, ...] = tuple(assess_picture if step is judge_joints else step for step in AFTER_TRACKING)
"""Passes of one person after tracking in the pictures of one camera."""
