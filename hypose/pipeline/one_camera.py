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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.motion import Modes, Motion
from hypose.calibration.findings import REVIEW, Finding
from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.errors import EvidenceError, InputError
from hypose.evidence.body_parts import detect_ends, end_colors
from hypose.evidence.frame import Frame, Keypoints, Picture, Silhouettes
from hypose.evidence.keypoints import person_size
from hypose.evidence.skin import skin_map
from hypose.geometry import Array, runs
from hypose.io.files import read_json
from hypose.io.videos.video import open_video
from hypose.pipeline.frame_anomalies import in_words
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.subject import TrackedSubject
from hypose.tracking.frame_evidence import MIN_CONFIDENCE, keypoint_model
from hypose.tracking.monocular.initialise import LEAST_CLICKS, initialise
from hypose.tracking.monocular.points import FEWEST_PX, PointsOn, clicked_joints, keypoints_on, seen_points
from hypose.tracking.monocular.problem import SMALLEST_MASK
from hypose.tracking.monocular.settings import MonoSettings

if TYPE_CHECKING:  # recordings are opened elsewhere
    from hypose.io.recordings.frames import FrameSettings
    from hypose.io.recordings.recording import Recording
    from hypose.io.recordings.view_source import ViewSource


class FrameSource(Protocol):
    """Protocol of a source of frames by number: hypose.io.recordings.frames.FrameStream, or a synthetic scene."""

    def __len__(self) -> int: ...

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, 0 <= index < len."""
        ...


@runtime_checkable
class RecordedFrames(FrameSource, Protocol):
    """Protocol of the frames of a recording: hypose.io.recordings.frames.FrameStream."""

    recording: Recording
    options: FrameSettings
    rig: CameraRig
    kinds: frozenset[type]
    keypoints: Sequence[Keypoints]
    frames: range

    def pictures(self) -> list[ViewSource]:
        """Open the pictures of all views; the caller closes them."""
        ...


class PictureFrames:
    """Frames of a source with the undistorted picture of its one camera, at working size (`Frame.picture`).

    The mask of a frame is put into its picture; where it shows no person, the picture has none. The frames of another
    source than a FrameStream, such as a synthetic scene, have their pictures already and are not changed.
    source: frames by number.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source, self._pictures = source, None
        self._kept: dict[int, Frame] = {}
        if isinstance(source, RecordedFrames):
            # read forwards, while the stream makes masks ahead
            self._pictures = source.pictures()[0]

    def frame(self, index: int, /) -> Frame:
        """Read a frame with its picture, without the picture of the frame before.

        index: 0 <= index < length of the source.
        """
        frame = self._source.frame(index)
        if self._pictures is None or not isinstance(self._source, RecordedFrames):
            return frame
        mask = None
        for seen in frame.of(Silhouettes):
            if seen.usable[0] and seen.areas[0] >= SMALLEST_MASK:
                mask = seen.masks[0]
        picture = Picture(self._source.rig[0], self._pictures.image(frame.index), None, mask)
        return Frame(frame.time, frame.index, keypoints=frame.keypoints, picture=picture)

    def walk(self, indices: range) -> Iterator[Frame]:
        """Yield the frames one after the other, each with its picture and that of the frame before it.

        indices: frames, forwards or backwards; "before" is meant in this direction. The first frame has a picture
            before it too, unless the source begins (or ends) there.
        """
        behind = indices.start - indices.step
        last = self._read(behind, indices.step) if indices and 0 <= behind < len(self._source) else None
        for index in indices:
            frame = self._read(index, indices.step)
            if frame.picture is not None:
                before = None if last is None or last.picture is None else last.picture.image
                yield replace(frame, picture=replace(frame.picture, before=before))
            else:
                yield frame
            last = frame

    def _read(self, index: int, step: int) -> Frame:
        """Read a frame with its picture.

        index: number of the frame.
        step: direction of the walk; below 0 several frames are read at once in their order and kept, so that the video
            is never decoded backwards.
        """
        if step > 0:
            return self.frame(index)
        if index not in self._kept:
            first = self.frame(index) if not self._kept else next(iter(self._kept.values()))
            size = 1 if first.picture is None else first.picture.image.nbytes
            self._kept = {
                i: self.frame(i)
                for i in range(max(0, index + 1 - max(1, SETTINGS.picture_ahead_bytes // size)), index + 1)
            }
        return self._kept[index]

    def close(self) -> None:
        """Release the video."""
        if self._pictures is not None:
            self._pictures.close()


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


def tracked_frames(
    source: FrameSource, indices: range, needs: Sequence[str], subject: TrackedSubject
) -> Iterator[Frame]:
    """Yield the frames that a recipe tracks, with the evidence that it needs.

    source: frames by number.
    indices: frames, forwards or backwards.
    needs: kinds of evidence that the recipe uses, as in Recipe.
    subject: the person; its body at the start pose shows where the skin colours are learned.
    Returns: frames with the picture of the one camera where the recipe needs pictures; frames with detections by skin
        colour where it needs detections, and the recording has pictures but no key points; unchanged frames otherwise.
    """
    if "picture" in needs:
        with contextlib.closing(PictureFrames(source)) as frames:
            yield from frames.walk(indices)
        return
    if not (
        "detections" in needs
        and isinstance(source, RecordedFrames)
        and Keypoints not in source.kinds
        and all(view.source is not None for view in source.recording.views)
    ):
        yield from (source.frame(i) for i in indices)
        return
    with contextlib.closing(ColourDetections(source, subject.body, subject.start)) as coloured:
        yield from (coloured.frame(i) for i in indices)


class ColourDetections:
    """Frames of a recording with the detections of hands and head by skin colour (`Frame.detections`, without
    names).

    The skin colours are learned from the first frame, whose pose is known. A frame depends on the recording and that
    pose alone, not on the order in which frames are read. The pictures are read a second time, in addition to the
    masks.
    source: frames of the recording.
    body, start: body of the person, and its pose (D,) in the first frame.
    Raises: InputError where the pictures are grey, or the frames have no masks.
    """

    def __init__(self, source: RecordedFrames, body: Body, start: Array) -> None:
        self.source, self.body = source, body
        self._pictures = source.pictures()
        first = source.frame(0).the(Silhouettes)
        images = self._images(0, first)
        if np.ptp(images.astype(np.int16), axis=-1).max() < 8:
            raise InputError(
                "The videos are grey, and skin colour drives this recipe: give key points, or choose another recipe."
            )
        self._colours = end_colors(body, start, first, images)

    def __len__(self) -> int:
        return len(self.source)

    def frame(self, index: int, /) -> Frame:
        """Read a frame with its detections; without them where fewer than two views see the person."""
        frame = self.source.frame(index)
        for silhouettes in frame.of(Silhouettes):
            centre = centre_of(silhouettes)
            if centre is not None:
                images = self._images(index, silhouettes)
                maps = np.stack([skin_map(i, m, self._colours) for i, m in zip(images, silhouettes.masks, strict=True)])
                detections, _ = detect_ends(silhouettes, maps, centre, self.body.stature)
                return replace(frame, detections=detections)
        return frame

    def close(self) -> None:
        """Release the videos."""
        for view in self._pictures:
            view.close()

    def _images(self, index: int, silhouettes: Silhouettes) -> NDArray[np.uint8]:
        """Read the undistorted pictures of a frame, in the pixels of its masks.

        index: frame, counted from the start of recording.frames.
        silhouettes: masks of the frame.
        Returns: (C, h, w, 3) BGR; black where a view is not usable.
        """
        out = np.zeros((*silhouettes.masks.shape, 3), np.uint8)
        for c in np.flatnonzero(silhouettes.usable):
            picture = self._pictures[int(c)].image(self.source.frames[index])
            out[c, : picture.shape[0], : picture.shape[1]] = picture
        return out


def centre_of(silhouettes: Silhouettes) -> Array | None:
    """Triangulate the middle of the person (3,) m from the centroids of the masks; None with fewer than two views."""
    middle = np.zeros((len(silhouettes.masks), 1, 2))
    for c, mask in enumerate(silhouettes.masks):
        rows, columns = np.nonzero(mask)
        if len(rows):
            middle[c, 0] = columns.mean(), rows.mean()
    seen = (silhouettes.usable & (silhouettes.areas > 0)).astype(np.float64)[:, None]
    point, views = triangulate(silhouettes.rig, middle, seen)
    return point[0] if views[0] >= 2 else None


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
    with open_video(source_of(recording)) as reader:
        size = reader.size
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
    with open_video(source_of(recording)) as reader:
        stored = np.array(reader.size, dtype=np.float64)
    pixels = np.array(list(clicks.values()))
    calibrated = (pixels + 0.5) * np.array(camera.size) / stored - 0.5 + np.asarray(view.image_shift)
    shown = (camera.undistort_points(calibrated) + 0.5) * np.array(working.size) / np.array(camera.size) - 0.5
    return {name: (float(u), float(v)) for name, (u, v) in zip(clicks, shown, strict=True)}


def extent(pixels: Array) -> float:
    """Compute the larger side, px, of the box around points (N, 2)."""
    return float(np.ptp(pixels, axis=0).max())


def source_of(recording: Recording) -> Path:
    """Return the file or folder of pictures of a recording of one camera."""
    source = recording.views[0].source
    assert source is not None  # `one_view` has checked it
    return source


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


def subject_in_picture(
    source: FrameSource,
    frame_rate: float,
    *,
    start: str = "auto",
    evidence: str = "auto",
    body: Body | None = None,
    height: float | None = None,
    floor: float | None = None,
) -> TrackedSubject:
    """Find the person in the pictures of one camera: body and rival start poses.

    source: frames by number.
    frame_rate: Hz.
    start: one of POINT_STARTS, or a file of clicks.
    evidence: one of `tracking.monocular.recipe.PICTURE_CUES`; only a note to the user depends on it.
    body: the person's own body; None: a body is fitted.
    height: m, where known.
    floor: height of the floor in the world, m; None: not known.
    Raises: InputError or EvidenceError where there is nothing to start from.
    """
    with contextlib.closing(PictureFrames(source)) as frames:
        template, seen = body or human(), _keypoints_of(source)
        notes = [_evidence_note(source, evidence, bool(seen))]
        if start in POINT_STARTS:
            at, points = _first_keypoints(source, seen, frame_rate)
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
        later = () if body is not None else _later_points(seen, at, len(source))
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


def _keypoints_of(source: FrameSource) -> dict[int, Keypoints]:
    """Return the key points by frame, without reading pictures where possible."""
    if isinstance(source, RecordedFrames):
        return dict(enumerate(source.keypoints))
    return {i: points for i in range(len(source)) for points in source.frame(i).of(Keypoints)}


def _evidence_note(source: FrameSource, evidence: str, keypoints: bool) -> str:
    """Return the sentence that names the camera and the evidence that is used.

    source: frames by number.
    evidence: option of the command, one of `tracking.monocular.recipe.PICTURE_CUES`.
    keypoints: whether any frame has key points.
    """
    name = source.recording.views[0].name if isinstance(source, RecordedFrames) else "in memory"
    masked = isinstance(source, RecordedFrames) and Silhouettes in source.kinds
    used = ["edges", "optical flow"]
    used += ["silhouettes"] if masked else []
    used += ["key points"] if keypoints and evidence in ("auto", "keypoints", "both") else []
    return f"one camera ({name}): {', '.join(used)}"


def _later_points(seen: Mapping[int, Keypoints], first: int, stop: int) -> tuple[PointsOn, ...]:
    """Select key points of frames over the whole clip, from which lengths of the body are measured.

    seen: key points by frame.
    first, stop: number of the frame of the start, and of all frames.
    Returns: functions that place the key points of a frame on a body.
    """
    rows = np.unique(np.linspace(first, stop - 1, SETTINGS.picture_length_frames + 1).astype(int))[1:].tolist()
    return tuple(partial(keypoints_on, seen[i]) for i in rows if i in seen and _enough(seen[i]))


def _enough(seen: Keypoints) -> bool:
    """Return whether enough key points are seen for a start."""
    return seen_points(keypoints_on(seen, human())) >= LEAST_CLICKS


def _first_keypoints(source: FrameSource, seen: Mapping[int, Keypoints], frame_rate: float) -> tuple[int, Keypoints]:
    """Find the first frame of the first second with enough key points; return its number and its key points.

    seen: key points by frame.
    frame_rate: Hz.
    Raises: InputError without any key points; EvidenceError where no frame of the first second has enough.
    """
    name = source.recording.views[0].name if isinstance(source, RecordedFrames) else "in memory"
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


def depth_is_uncertain(modes: Modes) -> Finding:
    """Make the finding that says how well depth is known, which one picture cannot show."""
    sd = 1e3 * float(np.nanmedian(modes.depth_sd))
    text = (
        f"one camera does not measure depth, which is known to +-{sd:.0f} mm (1 sd, median) as far as the lens and the "
        "person's size are right: see the notes"
    )
    return Finding("depth", (), text, size=sd, severity=REVIEW)


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
