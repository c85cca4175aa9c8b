"""Frames of evidence (silhouettes, key points, depth) of a recording, in any order, with one thread per camera.

Each picture of a camera is decoded, then resized and undistorted to the working size, then segmented into a mask. Key
points are undistorted and scaled in the same way. A frame depends on the recording and the options only: not on the
order in which frames are requested, on where a run was resumed, or on the number of threads.
"""

from __future__ import annotations

import contextlib
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, percentile_filter

from hypose.cameras.camera import Camera, CameraRig
from hypose.compute import packed_masks
from hypose.compute.picture_to_mask import Box
from hypose.compute.threads import default_threads
from hypose.errors import InputError
from hypose.evidence.association import object_points, people_of_objects
from hypose.evidence.background import (
    BackgroundModel,
    from_frames,
    from_plates,
    from_recording,
)
from hypose.evidence.colours import colour_codes, colour_edges
from hypose.evidence.depth_background import behind_things
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Colours, Frame, Keypoints, Silhouettes
from hypose.evidence.keypoints import keypoint_names, person_size, thick_skeleton
from hypose.evidence.one_person import OnePerson, one_person, without_held
from hypose.evidence.outlines import OUTLINE_POINTS, WORKING_HEIGHT, ViewOutline, view_outline
from hypose.evidence.silhouettes import (
    BitMask,
    Segmenter,
    SilhouetteSettings,
    flag_collapsed,
    make_silhouettes,
    with_doubted_limbs,
)
from hypose.geometry import Array, Image, Mask
from hypose.io.files import folder_for, write_bytes, write_text
from hypose.io.recordings.object_masks import SIDECAR, ObjectMasks
from hypose.io.recordings.recording import Recording, keypoints_of_recording, stored_sizes
from hypose.io.recordings.recording_views import ViewSource
from hypose.io.videos.video import evenly_spread, open_video

# ---- people ----------------------------------------------------------------------------------------------------------
# The people that key points and masks of a recording show: all detections, and those of the recording's person.


_COMPARED = 24  # frames in which objects are compared


@dataclass(frozen=True)
class RecordedPerson:
    """Key points of the recording's person in its T frames; of a recording without key points, T is 0.

    names: K names of the key points.
    keypoints: T frames, undistorted px of the working-size cameras.
    raw: (C, T, K, 3) u, v and confidence, px of the calibrated, distorted pictures.
    one: result of the choice of the person, with other people and notes.
    held: a sentence about key points that were held over gaps; empty where there are none.
    """

    names: tuple[str, ...]
    keypoints: list[Keypoints]
    raw: Array
    one: OnePerson
    held: tuple[str, ...] = ()


def candidates_of(recording: Recording, small: CameraRig) -> list[list[Array | None]]:
    """Collect all detections of people in every frame and view.

    recording.keypoint_lag is added to the frame numbers of the files.

    small: pinhole cameras of the working size.
    Returns: per frame and view (P, K, 5): undistorted px u, v of `small`, confidence 0 to 1, px u, v of the calibrated,
        distorted picture; None for a view without detections. Empty where the recording has no key points.
    Raises: InputError where a file cannot be read.
    """
    if recording.keypoint_set is None or not any("keypoints" in v.files for v in recording.views):
        return []
    found = keypoints_of_recording(recording)
    sizes = stored_sizes(recording)
    views = []
    for camera, into, view, size in zip(recording.rig, small, found, sizes, strict=True):
        column: list[Array | None] = []
        scale = np.array(into.size) / np.array(camera.size)
        for f in recording.frames:
            people = None if view is None else view.frame(f - recording.keypoint_lag, camera.size, size)
            if people is None or not len(people):
                column.append(None)
                continue
            uv = (camera.undistort_points(people[..., :2]) + 0.5) * scale - 0.5
            confidence = np.where(np.isfinite(uv).all(-1), people[..., 2], 0.0)[..., None]
            column.append(np.concatenate([np.where(confidence > 0, uv, 0.0), confidence, people[..., :2]], -1))
        views.append(column)
    return [list(frame) for frame in zip(*views, strict=True)]


def load_person(recording: Recording, small: CameraRig, *, keep_misfits: bool = False) -> RecordedPerson:
    """Load the key points of the recording's person.

    small: pinhole cameras of the working size.
    keep_misfits: keep the key points of views that do not fit the others.
    Returns: key points, with confidence 0 where the person is not seen; no frames where the recording has none.
    """
    candidates = candidates_of(recording, small)
    if recording.keypoint_set is None or not candidates:
        nothing = np.zeros((len(small), 0, 0, 3))
        return RecordedPerson((), [], nothing, OnePerson(nothing, False, (), (), ()))
    names = keypoint_names(recording.keypoint_set)
    views = [without_held([frame[c] for frame in candidates]) for c in range(len(small))]
    candidates = [list(frame) for frame in zip(*(column for column, _ in views), strict=True)]
    one = one_person(candidates, names, small, recording.frame_rate, keep_misfits=keep_misfits)
    held = {name: count for name, (_, count) in zip(small.names, views, strict=True) if count}
    said = (
        f"{sum(held.values())} key points ({', '.join(held)}) do not move by a single digit while the "
        "others move: they were held over gaps, and are left out"
    )
    points = one.points if one.points.shape[-1] == 5 else np.zeros((*one.points.shape[:3], 5))
    keypoints = [Keypoints(points[t, ..., :3].copy(), names, small) for t in range(len(points))]
    raw = points[..., [3, 4, 2]].transpose(1, 0, 2, 3).copy()
    return RecordedPerson(names, keypoints, raw, one, (said,) if held else ())


def objects_of_people(recording: Recording, small: CameraRig, masks: Mapping[int, ObjectMasks]) -> list[dict[int, str]]:
    """Find the objects in the masks of different views that are the same person.

    small: pinhole cameras of the working size.
    masks: masks with several objects, by the index of their view.
    Returns: one dictionary {index of the view: name of the object} per person; people seen in most views and frames
        come first.
    """
    frames = evenly_spread(recording.frames.start, recording.frames.stop, _COMPARED)
    points: list[dict[str, Array]] = [{} for _ in small]
    for c, of_view in masks.items():
        camera, into = recording.rig[c], small[c]
        scale = np.array(camera.size) / np.array(of_view.size)
        shift = np.array(recording.views[c].image_shift)
        smaller = np.array(into.size) / np.array(camera.size)
        for s, f in enumerate(frames):
            for name, one in (of_view.at(f) if f < of_view.n_frames else {}).items():
                uv = camera.undistort_points((object_points(one) + 0.5) * scale - 0.5 + shift)
                points[c].setdefault(name, np.full((len(frames), 3, 2), np.nan))[s] = (uv + 0.5) * smaller - 0.5
    return people_of_objects(points, small)


def choose_objects(
    recording: Recording,
    small: CameraRig,
    masks: Mapping[int, ObjectMasks],
    keypoints: Sequence[Keypoints],
    all_people: bool = False,
) -> tuple[str, ...]:
    """Choose, in each view, the objects of the masks that are the recording's person, and set them as `chosen`.

    With key points these are the objects around them. Without, they are the objects that belong together in most views
    and frames. Where no view has several objects, all are the person.

    small: pinhole cameras of the working size.
    masks: masks with objects, by the index of their view.
    keypoints: those of all frames; empty without key points.
    all_people: choose all objects that another view shows as well.
    Returns: notes about the choice.
    """
    if not any(len(of_view.objects) > 1 for of_view in masks.values()):
        return ()
    people = objects_of_people(recording, small, masks)
    if all_people:
        people = [p for p in people if len(p) > 1]
    chosen, rest = [], []
    for c, of_view in masks.items():
        inside = {} if all_people else _points_inside(recording, small, c, of_view, keypoints)
        own = {p[c] for p in people[: None if all_people else 1] if c in p}
        if inside:
            own = {name for name, count in inside.items() if count > 0.3 * max(inside.values())}
        of_view.chosen = frozenset(own)
        name, others = recording.views[c].name, set(of_view.objects) - own
        chosen.append(f"{name} {' and '.join(sorted(own)) or 'none'}")
        rest += [f"{name} {' and '.join(sorted(others))}"] if others else []
    if all_people:
        said = f"The masks hold objects that no other view shows, and these are left out: {', '.join(rest)}."
        return (said,) if rest else ()
    how = "their key points" if keypoints else "the rays through them"
    return (f"The masks hold several objects; followed is, by {how}: {', '.join(chosen)}.",)


def _points_inside(
    recording: Recording, small: CameraRig, c: int, of_view: ObjectMasks, keypoints: Sequence[Keypoints]
) -> dict[str, int]:
    """Count the key points inside each object of a view, over some frames.

    small: pinhole cameras of the working size, in whose px the key points are.
    c: index of the view.
    of_view: its masks.
    keypoints: those of all frames; empty without key points.
    Returns: counts above 0 by the object's name.
    """
    out: dict[str, int] = {}
    camera, into = recording.rig[c], small[c]
    for row in evenly_spread(0, len(keypoints), _COMPARED):
        p, f = keypoints[row].points[c], recording.frames[row]
        p = p[p[:, 2] > 0.2][:, :2]
        if not len(p) or f >= of_view.n_frames:
            continue
        world = np.c_[(p - into.K[:2, 2]) / np.diag(into.K)[:2], np.ones(len(p))]  # rays, in the camera's own frame
        own = world @ camera.camera_from_world[:3, :3] + camera.position
        size = np.array(of_view.size)
        stored = (camera.project(own) - recording.views[c].image_shift + 0.5) * size / np.array(camera.size) - 0.5
        at = np.rint(stored[np.isfinite(stored).all(1)]).astype(int)
        at = at[(at >= 0).all(1) & (at < size).all(1)]
        for name, one in of_view.at(f).items():
            out[name] = out.get(name, 0) + int(one[at[:, 1], at[:, 0]].sum())
    return {n: count for n, count in out.items() if count}


# ---- masks in work -------------------------------------------------------------------------------------------------
# The masks of a stream's frames: packed, in computation, and kept for another request of the same frame.


KEPT_BYTES = 160 << 20
"""Memory for masks that are kept, bytes; enough for ten minutes of four cameras."""
Progress = Callable[[str, int, int], None]
"""Function that is called with the stage, the number of steps done and the total."""


def unreported(stage: str, done: int, total: int) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class PackedMask:
    """The mask of one view and frame in packed form.

    runs: the mask; None where there is none.
    reason: why there is no mask.
    colours: box of the mask (y0, y1, x0, x1), and the colour codes and colour edges of the picture in it; empty where
        they are not wanted or not known.
    """

    runs: BitMask | None
    reason: str
    colours: tuple[tuple[Box, NDArray[np.uint16], NDArray[np.uint8]], ...] = ()

    @property
    def area(self) -> int:
        """Area of the mask, px; 0 where there is none."""
        return 0 if self.runs is None else self.runs.area


class PendingMasks:
    """Masks and outlines of one frame that worker threads compute.

    lanes: executor of each view, which runs the tasks of this view in order.
    make: function of view and frame that makes a mask.
    index: number of the frame.
    """

    def __init__(self, lanes: Sequence[Executor], make: Callable[[int, int], PackedMask], index: int) -> None:
        self._lanes, self._done = lanes, [lane.submit(make, c, index) for c, lane in enumerate(lanes)]
        self._outlines: list[Future[ViewOutline | None]] = []
        self.asked = False  # whether the outlines were requested; a picture of the masks does not need them

    def masks(self) -> list[PackedMask]:
        """Wait for the masks of all views."""
        return [f.result() for f in self._done]

    def areas(self) -> NDArray[np.int64]:
        """Wait for the masks, and return their areas (C,), px."""
        return np.array([d.area for d in self.masks()])

    def begin_outlines(self) -> None:
        """Start the computation of the outlines, each after the mask of its view."""
        if not self._outlines:
            self._outlines = [lane.submit(_outline, f) for lane, f in zip(self._lanes, self._done, strict=True)]

    def outlines(self) -> list[ViewOutline | None] | None:
        """Wait for the outlines that were started; None where they were not started or the stream was closed."""
        self.asked = True
        try:
            return [f.result() for f in self._outlines] or None
        except CancelledError:  # the stream was closed
            return None

    def cancel(self) -> None:
        """Cancel the tasks that have not started yet."""
        for future in [*self._done, *self._outlines]:
            future.cancel()


def _outline(done: Future[PackedMask]) -> ViewOutline | None:
    runs = done.result().runs
    return None if runs is None else view_outline(runs, OUTLINE_POINTS, WORKING_HEIGHT)


def _colours(masks: Sequence[PackedMask], shape: tuple[int, ...]) -> Colours | None:
    """Collect the colours within the masks of a frame; None where no view has any.

    shape: (C, h, w) shape of all masks.
    """
    codes, seen = np.zeros(shape, np.uint16), np.zeros(shape[0], np.bool_)
    edges = np.zeros((shape[0], 2, *shape[1:]), np.uint8)
    for c, mask in enumerate(masks):
        for (y0, y1, x0, x1), of_view, edges_of_view in mask.colours:
            codes[c, y0:y1, x0:x1], edges[c, :, y0:y1, x0:x1] = of_view, edges_of_view
            seen[c] = True
    return Colours(codes, seen, edges) if seen.any() else None


_CLIP = 10  # fewer images count as photos, not as a clip
_COVER, _BAND = 0.052, 0.03  # half thickness of the limbs drawn, and margin around them, in heights of the person
_AHEAD = 3  # frames computed in advance
_BACKGROUND_FRAMES = 60  # frames from which a background model is made
_SAMPLE_STEP, _SAMPLES = 5, 11  # frames whose mask areas are the usual area
_LONGEST_GAP = 15  # frames over which a missing key point is bridged when the skeleton is drawn


@dataclass(frozen=True)
class FrameSettings:
    """Settings that turn pictures into frames of evidence.

    longer_side: working size, px of the longer image side; images are never enlarged.
    silhouettes: settings of the masks.
    masks: make masks; False for key points only, and then nothing is decoded.
    band: keep masks only within a thick skeleton drawn from the key points, where there are any.
    people: whether there are several people; masks then keep the parts of all people, no mask is rejected for its
        area, and there is no band.
    colours: add the colours of the pictures within the masks.
    """

    longer_side: int = 480
    silhouettes: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    masks: bool = True
    band: bool = True
    people: bool = False
    colours: bool = False


def working_rig(rig: CameraRig, options: FrameSettings | None = None, depth: Sequence[bool] = ()) -> CameraRig:
    """Make the pinhole cameras of the working size from the calibrated cameras.

    options: settings with the working size; the defaults where None.
    depth: for each camera, whether it is a depth camera. Depth cameras have a working size of their own.
    Why: scaled like the large pictures of other cameras, depth maps would show arms one pixel wide.
    """
    o = options or FrameSettings()
    small = rig.scaled(min(1.0, o.longer_side / float(rig.sizes.max()))).pinhole()
    if not any(depth):
        return small
    alone = [working_rig(CameraRig((c,)), o)[0] for c in rig]
    return CameraRig(tuple(a if own else c for c, a, own in zip(small, alone, depth, strict=True)))


def _rig_of(recording: Recording, options: FrameSettings | None = None) -> CameraRig:
    """Make the cameras of the working size for the views of a recording."""
    return working_rig(recording.rig, options, [v in recording.depth_views for v in recording.views])


def load_keypoints(recording: Recording) -> list[Keypoints]:
    """Load the key points of the recording's person in each frame, px of the cameras of the usual working size.

    Returns: one per frame of recording.frames, with confidence 0 where the person is not seen; empty where the
        recording has no key points.
    """
    return load_person(recording, _rig_of(recording)).keypoints


class _Skeletons:
    """Thick skeletons of all frames and views, drawn from key points with short gaps bridged.

    keypoints: key points of all frames, px of the working size; empty: no frame has any.
    first: number of the first frame.
    """

    def __init__(self, keypoints: Sequence[Keypoints], first: int) -> None:
        self._first, self._names = first, keypoints[0].names if keypoints else ()
        self._points = points = np.stack([k.points for k in keypoints]) if keypoints else np.zeros((0, 0, 0, 3))
        frames = np.arange(len(points))
        for c, k in np.ndindex(points.shape[1:3]):
            seen = points[:, c, k, 2] > 0.3
            if seen.any():
                for axis in (0, 1):
                    points[:, c, k, axis] = np.interp(frames, frames[seen], points[seen, c, k, axis])
                points[~seen & (np.asarray(distance_transform_edt(~seen)) <= _LONGEST_GAP), c, k, 2] = 0.31
        heights = np.array([[person_size(p) for p in frame] for frame in points])
        self._heights = percentile_filter(heights, 75, (61, 1), mode="nearest") if keypoints else heights

    def show(self, view: int, frame: int) -> bool:
        """Return whether a frame's key points of a view show the person: at least six, of at least 8 px height.

        frame: number of the video's frame.
        """
        if not len(self._points):
            return False
        p, height = self._points[frame - self._first, view], self._heights[frame - self._first, view]
        return bool((p[:, 2] > 0.3).sum() >= 6 and height >= 8)

    def cover(self, view: int, frame: int, camera: Camera) -> Mask:
        """Draw the region of the person, a thick skeleton, as a mask (h, w) of 0 and 1, where `show` is true.

        camera: camera of the working size.
        """
        p, height = self._points[frame - self._first, view], self._heights[frame - self._first, view]
        return thick_skeleton(p, self._names, (camera.size[1], camera.size[0]), _COVER * height)

    def band(self, view: int, frame: int, camera: Camera) -> Mask:
        """Draw the region outside which a mask is cleared: the region of the person with a margin around it."""
        drawn = self.cover(view, frame, camera)
        if not drawn.any():
            return drawn
        extent = max(int(np.ptp(np.flatnonzero(drawn.any(a)))) for a in (0, 1))
        size = 2 * max(1, round(_BAND * extent)) + 1
        return np.asarray(cv2.dilate(drawn, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))), dtype=np.uint8)

    def widened(self, view: int, frame: int, band: Mask, mask: Mask) -> Mask | None:
        """Widen the band by the limbs that the mask does not confirm.

        band, mask: (h, w) of 0 and 1.
        Returns: the wider band (h, w); None where the mask confirms all limbs.
        """
        p, height = self._points[frame - self._first, view], float(self._heights[frame - self._first, view])
        return with_doubted_limbs(band, mask, p, self._names, height)


def build_backgrounds(
    recording: Recording,
    options: FrameSettings | None = None,
    keypoints: Sequence[Keypoints] = (),
    progress: Progress = unreported,
) -> tuple[BackgroundModel | None, ...]:
    """Build the background model of each view.

    A clip of the empty room is used alone. Photos of it are combined with frames of the recording. Without either,
    frames of the recording are used, and the key points show where the person is.

    options: settings; the defaults where None.
    keypoints: those of all frames, for the region of the person; empty where there are none.
    progress: called with ("background", done, total) for every picture that is read.
    Returns: one model per view; None for views with masks, depth views and views without pictures.
    Raises: InputError where no picture of a view can be read.
    """
    total, pictures = sum(v.segmented for v in recording.views) * _BACKGROUND_FRAMES, itertools.count(1)

    def counted(image: Image) -> Image:
        progress("background", min(next(pictures), total - 1), total)
        return image

    small, skeletons = _rig_of(recording, options), _Skeletons(keypoints, recording.frames[0])

    def build(c: int) -> BackgroundModel | None:
        view = recording.views[c]
        if not view.segmented:
            return None
        source = ViewSource(view, recording.rig[c], small[c], parallel=len(recording.views))
        plate = None
        if "background" in view.files:
            with open_video(view.files["background"]) as reader:
                chosen = evenly_spread(0, reader.n_frames, _BACKGROUND_FRAMES)
                images = [counted(source.prepare(reader.read(i))) for i in chosen]
                if reader.n_frames >= _CLIP:
                    return from_frames(images)
                plate = from_plates(images)
        frames, known = list[Image](), dict[int, Mask]()
        with contextlib.closing(source):
            for frame in evenly_spread(recording.frames.start, recording.frames.stop, _BACKGROUND_FRAMES):
                try:
                    frames.append(counted(source.image(frame)))
                except InputError:
                    if not frames:
                        raise
                    break  # the video breaks off: use the frames that were read so far
                if skeletons.show(c, frame):
                    known[len(frames) - 1] = skeletons.cover(c, frame, small[c])
        if len(known) < max(4, len(frames) // 4):
            return from_recording(frames, None, plate)
        return from_recording([frames[k] for k in known], np.stack([*known.values()]), plate)

    with ThreadPoolExecutor(len(recording.views)) as pool:
        made = tuple(pool.map(build, range(len(recording.views))))
    if total:
        progress("background", total, total)
    return made


class FrameStream:
    """Frames of a recording as evidence: `len(stream)`, `stream.frame(i)`, iteration, and `with` to close it.

    A view is not usable in a frame where it has no image, an empty mask, or a mask far from its usual area (the median
    of about the last two seconds at 25 frames/s, or of the first at the start). The reason names camera and frame.

    recording: the recording to read.
    options: settings; by default the usual ones, with the recording's settings for masks.
    backgrounds: one model per view; built where None.
    progress: called with ("background", done, total) for every picture that is read to build the background models.

    Attributes:
    kinds: classes of evidence that frames of this stream can have.
    rig: pinhole cameras of the working size.
    keypoints: key points of the person per frame; empty where there are none.
    unchosen: the same with those of views that do not fit the others, for checks of the calibration.
    others: number of other people whom the key points show.
    Raises: InputError where the recording has no frames.
    """

    def __init__(
        self,
        recording: Recording,
        options: FrameSettings | None = None,
        backgrounds: Sequence[BackgroundModel | None] | None = None,
        progress: Progress = unreported,
    ) -> None:
        self.recording, self.options = recording, options or FrameSettings(silhouettes=recording.silhouettes)
        if self.options.people:
            self.options = replace(self.options, silhouettes=self.options.silhouettes.of_all_people, band=False)
        self.rig, self.frames = _rig_of(recording, self.options), recording.frames
        if len(self.frames) == 0:
            raise InputError(f"Recording {recording.name} has no frames to work on; check frame_range.")
        person = load_person(recording, self.rig)
        self.keypoints = self.unchosen = person.keypoints
        if person.one.apart:
            self.unchosen = load_person(recording, self.rig, keep_misfits=True).keypoints
        self.others = 0 if self.options.people else max(len(person.one.people) - 1, 0)
        self._people_notes = (*(() if self.options.people else person.one.notes), *person.held)
        self._skeletons = _Skeletons(self.keypoints if self.options.band else [], self.frames[0])
        self.backgrounds: tuple[BackgroundModel | None, ...] = ()
        self._sources: list[ViewSource] = []
        self._lanes: list[ThreadPoolExecutor] = []
        self._ahead: dict[int, PendingMasks] = {}
        self._given: PendingMasks | None = None
        self._kept, self._kept_bytes = dict[tuple[int, int], PackedMask](), 0  # masks by view and index
        self._last = -1
        self._areas: dict[int, NDArray[np.int64]] = {}
        masks = self.options.masks and recording.has_pictures
        self._readers: dict[type, Callable[[Frame, int], Frame]] = {}
        if masks:
            self._open(backgrounds, progress)
            self._readers[Silhouettes] = self._with_masks
        if masks and recording.depth_views:
            self._readers[Depth] = self._with_depth
        if self.keypoints:
            self._readers[Keypoints] = lambda frame, index: replace(frame, keypoints=self.keypoints[index])
        self.kinds = frozenset(self._readers)

    def _open(self, backgrounds: Sequence[BackgroundModel | None] | None, progress: Progress) -> None:
        r = self.recording
        self.backgrounds = (
            build_backgrounds(r, self.options, self.keypoints, progress) if backgrounds is None else tuple(backgrounds)
        )
        for view, camera, small, background in zip(r.views, r.rig, self.rig, self.backgrounds, strict=True):
            source = ViewSource(view, camera, small, self.options.people, len(r.views))
            if background is not None:
                source.segment = Segmenter(background, self.options.silhouettes)
            self._sources.append(source)
        objects = {c: s.objects for c, s in enumerate(self._sources) if s.objects is not None}
        self._people_notes += choose_objects(r, self.rig, objects, self.keypoints, self.options.people)
        self.tells_apart = any(len(o.objects) > 1 for o in objects.values())
        # each camera has its own thread, so that its frames are read in order; with fewer cores, cameras share threads,
        # because more threads than cores mostly wait for each other
        pools = [ThreadPoolExecutor(1, thread_name_prefix=v.name) for v in r.views[: default_threads()]]
        self._lanes = [pools[c % len(pools)] for c in range(len(r.views))]

    tells_apart = False
    """Whether at least one view has masks of several separate objects."""

    @property
    def guessed_rooms(self) -> str:
        """Warning about views whose background comes from the recording itself although the person's region is unknown;
        "" where there are none.
        """
        views = zip(self.recording.views, self.backgrounds, strict=False)
        guessed = [v.name for v, b in views if b is not None and "background" not in v.files]
        if not guessed or Keypoints in self.kinds:
            return ""
        which = "No view" if len(guessed) == len(self.recording.views) else f"{', '.join(guessed)}: no view of these"
        return (
            f"{which} has a picture of the empty room: it is taken from the recording itself, in which a person who "
            "hardly moves vanishes. Give a photo or clip of the empty room (background), masks, or key points."
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user about doubtful backgrounds, excluded people and unreadable frames so far."""
        named = zip(self.recording.views, self.backgrounds, strict=False)
        low_confidence = [f"View {v.name}: {b.note}" for v, b in named if b is not None and b.note]
        unread = (f"View {s.view.name} {s.note}" for s in self._sources if s.note)
        things = (
            f"View {s.view.name}: {area:.2f} m^2 of things that the empty room did not have are left out"
            for s in self._sources
            if (area := s.furnished[1]) > 0
        )
        return (*self._people_notes, *low_confidence, *unread, *things)

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(i) for i in range(len(self)))

    def __enter__(self) -> FrameStream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the threads and close the files."""
        for lane in self._lanes:
            lane.shutdown(wait=True, cancel_futures=True)
        for source in self._sources:
            source.close()
        self._lanes, self._ahead = [], {}

    def pictures(self) -> list[ViewSource]:
        """Open the pictures of all views, undistorted and at working size; the caller closes them."""
        return [ViewSource(*of) for of in zip(self.recording.views, self.recording.rig, self.rig, strict=True)]

    def frame(self, index: int, /) -> Frame:
        """Compute the evidence of one frame; access in increasing order is the fastest.

        index: 0 <= index < len(stream), from the start of recording.frames.
        Returns: the frame; its index is the number of the video frame, its time that number divided by the frame rate.
        Raises: InputError where the index is out of range.
        """
        if not 0 <= index < len(self.frames):
            raise InputError(f"The recording has the frames 0 to {len(self.frames) - 1}; {index} was asked for.")
        frame = Frame(self.frames[index] / self.recording.frame_rate, self.frames[index])
        for with_piece in self._readers.values():
            frame = with_piece(frame, index)
        return frame

    def _with_masks(self, frame: Frame, index: int) -> Frame:
        """Add silhouettes to a frame, and the colours within them where they are wanted."""
        history, pending = self._look(index)
        masks = pending.masks()
        if self.options.people:  # people who come or go change the area, which is no fault
            history = history[:, :0]
        collapsed = flag_collapsed(pending.areas(), history, self.rig.names, frame.index)
        why = [mask.reason or found for mask, found in zip(masks, collapsed, strict=True)]
        silhouettes = make_silhouettes([mask.runs for mask in masks], self.rig, why)
        if self.options.people:
            owners = np.zeros_like(silhouettes.masks)
            for c, source in enumerate(self._sources):
                found = source.owners(frame.index)
                owners[c, : found.shape[0], : found.shape[1]] = found
            silhouettes = replace(silhouettes, owners=owners)
        silhouettes.announce_outlines(pending.outlines)
        colours = _colours(masks, silhouettes.masks.shape) if self.options.colours else None
        return replace(frame, silhouettes=silhouettes, colours=colours)

    def _with_depth(self, frame: Frame, index: int) -> Frame:
        """Add the depth maps to a frame with silhouettes, and mark the pixels where a thing may hide the person."""
        silhouettes, sources = frame.the(Silhouettes), [s.depth for s in self._sources]
        maps = np.zeros(silhouettes.masks.shape, np.float32)
        usable = silhouettes.usable & np.array([s is not None for s in sources])
        blank = np.zeros(len(sources), dtype=np.bool_)
        for c, source in enumerate(sources):
            if source is None:
                continue
            try:
                found = self._lanes[c].submit(source.map, frame.index).result()
            except InputError:  # its mask could not be made either, with a reason
                usable[c] = False
                continue
            blank[c] = not found.any()
            if usable[c]:
                maps[c, : found.shape[0], : found.shape[1]] = found
        person = silhouettes.masks * usable.astype(np.uint8)[:, None, None]
        depth = Depth(maps, person, silhouettes.rig, usable, blank=blank)
        if not self.options.people:
            silhouettes = behind_things(silhouettes, depth, [s.furnished[0] for s in self._sources])
        return replace(frame, silhouettes=silhouettes, depth=depth)

    def mask(self, view: int, number: int, picture: Image | None, settings: SilhouetteSettings) -> Mask:
        """Make the mask of one view and frame with other settings, to preview them.

        The areas of other frames are not compared, so a collapsed mask is returned as it is.

        number: number of the video's frame, which may lie outside recording.frames.
        picture: stored picture (h, w, 3) BGR of the frame; None to read it.
        settings: settings of the mask; they have no effect where the view has masks of its own.
        Returns: (h, w) of 0 and 1, at working size.
        Raises: InputError where there is no mask; it names the reason.
        """
        if not self._sources:
            raise InputError(f"{self.recording.name} has key points alone, from which no masks are made.")
        source, background = self._sources[view], self.backgrounds[view]
        source.given = None if picture is None else (number, picture)
        if background is not None:
            source.segment = Segmenter(background, settings)
        runs, reason = self._mask(view, number)
        if runs is None:
            raise InputError(reason)
        return packed_masks.draw(runs)

    def _mask(self, view: int, frame: int) -> tuple[BitMask | None, str]:
        """Make the mask of a view.

        frame: number of the video's frame.
        Returns: as `ViewSource.mask`.
        """
        if not self._skeletons.show(view, frame):
            return self._sources[view].mask(frame)
        band = self._skeletons.band(view, frame, self.rig[view])
        return self._sources[view].mask(frame, band, partial(self._skeletons.widened, view, frame, band))

    def _look(self, index: int) -> tuple[NDArray[np.int64], PendingMasks]:
        """Get the masks of a frame and the mask areas that define the usual area, and start on the next frames.

        index: frame, counted from the start of recording.frames.
        Returns: areas (C, H), px, in the last H sampled frames before it, at the start in the first H; its masks.
        Why: the frames of these areas are a fixed choice, so a resumed run gives the same result. At the start they lie
            ahead; the masks up to there are kept, so that no video is read twice.
        """
        latest = max(_SAMPLES, -(-index // _SAMPLE_STEP))  # samples before this frame, at the start the first ones
        samples = [s * _SAMPLE_STEP for s in range(latest - _SAMPLES, latest) if s * _SAMPLE_STEP < len(self.frames)]
        missing = [s for s in samples if s not in self._areas]
        ahead = min(index + (_AHEAD if index in (0, self._last + 1) else 1), len(self.frames) - 1)
        self._last = index
        wanted = sorted({*missing, *range(index, max([ahead, *missing]) + 1)})
        for other in [i for i in self._ahead if not index <= i <= index + _SAMPLES * _SAMPLE_STEP]:
            self._ahead.pop(other).cancel()
        outlined = self._given is not None and self._given.asked
        for i in wanted:
            if i not in self._ahead:
                self._ahead[i] = PendingMasks(self._lanes, self._packed, i)
            if outlined and index <= i <= ahead:  # later frames are needed for their areas only
                self._ahead[i].begin_outlines()
        for i in missing:
            self._areas[i] = self._ahead[i].areas()
            if i < index:
                del self._ahead[i]
        self._areas = {s: areas for s, areas in self._areas.items() if samples[0] - 500 <= s <= samples[-1] + 500}
        self._given = pending = self._ahead.pop(index)
        if index % _SAMPLE_STEP == 0:
            self._areas[index] = pending.areas()
        return np.stack([self._areas[s] for s in samples], 1), pending

    def _packed(self, view: int, index: int) -> PackedMask:
        """Get a mask from memory or make it, with colours where they are wanted; those are too large to be kept.

        index: frame, counted from the start of recording.frames.
        """
        if (view, index) in self._kept:
            return self._kept[view, index]
        runs, reason = self._mask(view, self.frames[index])
        if runs is not None and runs.area > 0 and self.options.colours:
            image = self._sources[view].image_of_mask(self.frames[index])
            if image is not None:
                y0, y1, x0, x1 = runs.box
                image = image[y0:y1, x0:x1]
                return PackedMask(runs, reason, ((runs.box, colour_codes(image), colour_edges(image)),))
        size = 0 if runs is None else runs.bits.nbytes
        found = PackedMask(runs, reason)
        if self._kept_bytes + size <= KEPT_BYTES:
            self._kept[view, index] = found
            self._kept_bytes += size
        return found


# ---- mask folders --------------------------------------------------------------------------------------------------
# The silhouettes of a recording as folders of pictures, which another recording reads as its `masks`.


def write_masks(stream: FrameStream, folder: str | Path, progress: Callable[[int, int], None] | None = None) -> int:
    """Write the masks of a stream as PNG files (0 or 255), undistorted and at working size: folder/VIEW/FRAME.png.

    A note next to them says that they are undistorted, so a recording that names such a folder as `masks` reads them
    back exactly.

    progress: called with the number of frames done and the total after each frame.
    Returns: number of masks that are not empty.
    Raises: InputError where the stream has no silhouettes.
    """
    if Silhouettes not in stream.kinds:
        raise InputError(
            f"{stream.recording.name} has key points alone, and silhouettes are made from pictures; give the videos in "
            "recording.toml."
        )
    views = {c: mask_folder(folder, v.name, stream.rig[c]) for c, v in enumerate(stream.recording.views)}
    shown = 0
    for done, frame in enumerate(stream, 1):
        silhouettes = frame.the(Silhouettes)
        write_frame_masks(silhouettes, views, frame.index)
        if progress is not None:
            progress(done, len(stream))
        shown += int((silhouettes.areas > 0).sum())
    return shown


def mask_folder(folder: str | Path, view: str, camera: Camera) -> Path:
    """Make the folder for the masks of a view, with a note that they are undistorted and of the camera's size."""
    path = folder_for(Path(folder), view)
    write_text(path / SIDECAR, json.dumps({"undistorted": True, "size": list(camera.size)}) + "\n")
    return path


def write_frame_masks(silhouettes: Silhouettes, folders: Mapping[int, Path], number: int) -> None:
    """Write the masks of a frame as PNG files.

    silhouettes: masks of all views.
    folders: folders by the index of the view; the masks of other views are not written.
    number: number of the frame, which names the files.
    """
    for view, path in folders.items():
        width, height = silhouettes.rig[view].size
        _, data = cv2.imencode(".png", silhouettes.masks[view, :height, :width] * np.uint8(255))
        write_bytes(path / f"{number:06d}.png", data.tobytes(), synced=False)
