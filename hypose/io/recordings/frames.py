"""Frames of evidence (silhouettes, key points, depth) of a recording, in any order, with one thread per camera.

Each picture of a camera is decoded, then resized and undistorted to the working size, then segmented into a mask. Key
points are undistorted and scaled in the same way. A frame depends on the recording and the options only: not on the
order in which frames are requested, on where a run was resumed, or on the number of threads.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, percentile_filter

from hypose.cameras.camera import Camera, CameraRig
from hypose.compute import mask_runs
from hypose.compute.threads import default_threads
from hypose.errors import InputError
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
from hypose.evidence.keypoints import person_size, thick_skeleton
from hypose.evidence.outlines import OUTLINE_POINTS, WORKING_HEIGHT, ViewOutline, outline_of_runs
from hypose.evidence.prefetch import make_ahead
from hypose.evidence.silhouettes import (
    MaskRuns,
    SilhouetteSettings,
    flag_collapsed,
    make_segmenter,
    make_silhouettes,
    with_doubted_limbs,
)
from hypose.geometry import Array, Image, Mask
from hypose.io.file_names import folder_for
from hypose.io.files import write_bytes, write_text
from hypose.io.recordings.object_masks import SIDECAR
from hypose.io.recordings.recording import Recording
from hypose.io.recordings.recording_people import load_person, persons_objects
from hypose.io.recordings.view_source import Preparer, ViewSource
from hypose.io.videos.video import evenly_spread, open_video

# ---- masks in work -------------------------------------------------------------------------------------------------
# The masks of a stream's frames: packed, in computation, and kept for another request of the same frame.


KEPT_BYTES = 160 << 20
"""Memory for masks that are kept, bytes; enough for ten minutes of four cameras."""


@dataclass(frozen=True)
class PackedMask:
    """The mask of one view and frame in packed form.

    runs: the mask; None where there is none.
    reason: why there is no mask.
    colours: colour codes and colour edges of the picture in the mask's box, where they are wanted and known.
    """

    runs: MaskRuns | None
    reason: str
    colours: tuple[NDArray[np.uint16], NDArray[np.uint8]] | None = None

    @property
    def area(self) -> int:
        """Area of the mask, px; 0 where there is none."""
        return 0 if self.runs is None else self.runs.area

    def outline(self) -> ViewOutline | None:
        """Compute the outline of the mask as tracking uses it; None where there is no mask."""
        return None if self.runs is None else outline_of_runs(self.runs, OUTLINE_POINTS, WORKING_HEIGHT)


class PendingMasks:
    """Masks and outlines of one frame that worker threads compute.

    lanes: executor of each view, which runs the tasks of this view in order.
    make: function of view and frame that makes a mask.
    index: number of the frame.
    """

    def __init__(self, lanes: Sequence[Executor], make: Callable[[int, int], PackedMask], index: int) -> None:
        self._done = [lane.submit(make, c, index) for c, lane in enumerate(lanes)]
        self._outlines: list[Future[ViewOutline | None]] = []
        self.asked = False  # whether the outlines were requested; a picture of the masks does not need them

    def _masks(self) -> list[PackedMask]:
        return [f.result() for f in self._done]

    def masks(self) -> tuple[list[MaskRuns | None], list[str]]:
        """Wait for the masks of all views.

        Returns: by view, the mask (None: there is none) and the reason for its absence.
        """
        done = self._masks()
        return [d.runs for d in done], [d.reason for d in done]

    def areas(self) -> NDArray[np.int64]:
        """Wait for the masks, and return their areas (C,), px."""
        return np.array([d.area for d in self._masks()])

    def colours(self, shape: tuple[int, ...]) -> Colours | None:
        """Collect the colours within the masks; None where no view has any.

        shape: (C, h, w), that of the masks.
        """
        codes, seen = np.zeros(shape, np.uint16), np.zeros(shape[0], np.bool_)
        edges = np.zeros((shape[0], 2, *shape[1:]), np.uint8)
        for c, found in enumerate(self._masks()):
            if found.colours is not None and found.runs is not None:
                y0, y1, x0, x1 = found.runs.box
                codes[c, y0:y1, x0:x1], edges[c, :, y0:y1, x0:x1] = found.colours
                seen[c] = True
        return Colours(codes, seen, edges) if seen.any() else None

    def begin_outlines(self, lanes: Sequence[Executor]) -> None:
        """Start the computation of the outlines, each after the mask of its view.

        lanes: executor of each view.
        """
        if not self._outlines:
            self._outlines = [lane.submit(_outline, f) for lane, f in zip(lanes, self._done, strict=True)]

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
    return done.result().outline()


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
    silhouettes: settings of the masks; None for key points only, and then nothing is decoded.
    band: keep masks only within a thick skeleton drawn from the key points, where there are any.
    people: whether there are several people; masks then keep the parts of all people, no mask is rejected for its
        area, and there is no band.
    colours: add the colours of the pictures within the masks.
    """

    longer_side: int = 480
    silhouettes: SilhouetteSettings | None = field(default_factory=SilhouetteSettings)
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


def load_keypoints(recording: Recording, options: FrameSettings | None = None) -> list[Keypoints] | None:
    """Load the key points of the recording's person in each frame, px of the working-size cameras.

    options: settings with the working size; the defaults where None.
    Returns: one per frame of recording.frames, with confidence 0 where the person is not seen; None where the recording
        has no key points.
    """
    found = load_person(recording, _rig_of(recording, options))
    return None if found is None else found.keypoints


@dataclass(frozen=True)
class _Skeletons:
    """Thick skeletons of all frames and views, drawn from key points with short gaps bridged.

    points: (T, C, K, 3) px, px, confidence; 0.31 in bridged gaps.
    heights: (T, C) height of the person in the picture, px.
    names: K names of the key points.
    first: number of the first frame.
    """

    points: Array
    heights: Array
    names: tuple[str, ...]
    first: int

    def cover(self, view: int, frame: int, camera: Camera) -> Mask | None:
        """Draw the region of the person, a thick skeleton, as a mask of 0 and 1.

        view: index of the view.
        frame: number of the video's frame.
        camera: camera of the working size.
        Returns: (h, w) of the camera's size; None where fewer than six key points are seen, or the person is less than
            8 px tall.
        """
        p, height = self.points[frame - self.first, view], self.heights[frame - self.first, view]
        if (p[:, 2] > 0.3).sum() < 6 or height < 8:
            return None
        return thick_skeleton(p, self.names, (camera.size[1], camera.size[0]), _COVER * height)

    def band(self, view: int, frame: int, camera: Camera) -> Mask | None:
        """Draw the region outside which a mask is cleared: the region of the person with a margin around it.

        view, frame, camera: as for `cover`.
        Returns: (h, w) of 0 and 1; None where `cover` is None.
        """
        mask = self.cover(view, frame, camera)
        if mask is None or not mask.any():
            return mask
        extent = max(int(np.ptp(np.flatnonzero(mask.any(a)))) for a in (0, 1))
        size = 2 * max(1, round(_BAND * extent)) + 1
        return np.asarray(cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))), dtype=np.uint8)

    def widened(self, view: int, frame: int, band: Mask, mask: Mask) -> Mask | None:
        """Widen the band by the limbs that the mask does not confirm.

        view: index of the view.
        frame: number of the video's frame.
        band, mask: (h, w) of 0 and 1.
        Returns: the wider band (h, w); None where the mask confirms all limbs.
        """
        p, height = self.points[frame - self.first, view], float(self.heights[frame - self.first, view])
        return with_doubted_limbs(band, mask, p, self.names, height)


def _skeletons(keypoints: Sequence[Keypoints], first: int) -> _Skeletons:
    """Bridge short gaps in the key points, so that skeletons can be drawn.

    keypoints: key points of all frames, in px of the working size.
    first: number of the first frame.
    """
    points = np.stack([k.points for k in keypoints])
    frames = np.arange(len(points))
    for c, k in np.ndindex(points.shape[1:3]):
        seen = points[:, c, k, 2] > 0.3
        if seen.any():
            for axis in (0, 1):
                points[:, c, k, axis] = np.interp(frames, frames[seen], points[seen, c, k, axis])
            points[~seen & (np.asarray(distance_transform_edt(~seen)) <= _LONGEST_GAP), c, k, 2] = 0.31
    heights = np.array([[person_size(p) for p in frame] for frame in points])
    return _Skeletons(points, percentile_filter(heights, 75, (61, 1), mode="nearest"), keypoints[0].names, first)


def build_backgrounds(
    recording: Recording,
    options: FrameSettings | None = None,
    keypoints: Sequence[Keypoints] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[BackgroundModel | None, ...]:
    """Build the background model of each view.

    A clip of the empty room is used alone. Photos of it are combined with frames of the recording. Without either,
    frames of the recording are used, and the key points show where the person is.

    options: settings; the defaults where None.
    keypoints: those of all frames, for the region of the person; None where there are none.
    progress: called with ("background", done, total) for every picture that is read.
    Returns: one model per view; None for views with masks, depth views and views without pictures.
    Raises: InputError where no picture of a view can be read.
    """
    o = options or FrameSettings()
    total, pictures = sum(v.segmented for v in recording.views) * _BACKGROUND_FRAMES, itertools.count(1)

    def counted(image: Image) -> Image:
        if progress is not None:
            progress("background", min(next(pictures), total - 1), total)
        return image

    small = _rig_of(recording, o)
    skeletons = _skeletons(keypoints, recording.frames[0]) if keypoints else None

    def build(c: int) -> BackgroundModel | None:
        view = recording.views[c]
        if not view.segmented:
            return None
        prepare = Preparer(recording.rig[c], small[c], view.image_shift)
        plate = None
        if view.background is not None:
            with open_video(view.background) as reader:
                chosen = evenly_spread(0, reader.n_frames, _BACKGROUND_FRAMES)
                images = [counted(prepare(reader.read(i))) for i in chosen]
                if reader.n_frames >= _CLIP:
                    return from_frames(images)
                plate = from_plates(images)
        source = ViewSource(view, recording.rig[c], small[c], parallel=len(recording.views))
        try:
            frames, hidden = [], []
            for frame in evenly_spread(recording.frames.start, recording.frames.stop, _BACKGROUND_FRAMES):
                try:
                    frames.append(counted(source.image(frame)))
                except InputError:
                    if not frames:
                        raise
                    break  # the video breaks off: use the frames that were read so far
                hidden.append(None if skeletons is None else skeletons.cover(c, frame, small[c]))
        finally:
            source.close()
        known = [(f, h) for f, h in zip(frames, hidden, strict=True) if h is not None]
        if len(known) < max(4, len(frames) // 4):
            return from_recording(frames, None, plate)
        return from_recording([f for f, _ in known], np.stack([h for _, h in known]), plate)

    with ThreadPoolExecutor(len(recording.views)) as pool:
        made = tuple(pool.map(build, range(len(recording.views))))
    if progress is not None and total:
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
    rig: pinhole cameras of the working size.
    keypoints: key points of the person per frame; None where there are none.
    doubted: key points per frame that include those of views that do not fit, for diagnostics of the calibration.
    others: number of other people that the key points show.
    Raises: InputError where the recording has no frames.
    """

    def __init__(
        self,
        recording: Recording,
        options: FrameSettings | None = None,
        backgrounds: Sequence[BackgroundModel | None] | None = None,
        progress: Callable[[str, int, int], None] | None = None,
    ) -> None:
        self.recording, self.options = recording, options or FrameSettings(silhouettes=recording.silhouettes)
        if self.options.people and self.options.silhouettes is not None:
            self.options = replace(self.options, silhouettes=self.options.silhouettes.of_all_people, band=False)
        self.rig = _rig_of(recording, self.options)
        self.frames = recording.frames
        if len(self.frames) == 0:
            raise InputError(f"Recording {recording.name} has no frames to work on; check frame_range.")
        person = load_person(recording, self.rig)
        self.keypoints = None if person is None else person.keypoints
        whose = None if person is None else person.one
        notes = () if whose is None or self.options.people else whose.notes
        self.people_notes = notes if person is None else (*notes, *person.held)
        # other people whom key points show
        self.others = 0 if whose is None or self.options.people else max(len(whose.people) - 1, 0)
        self.doubted = self.keypoints
        if person is not None and person.one.apart:
            doubted = load_person(recording, self.rig, keep_misfits=True)
            self.doubted = None if doubted is None else doubted.keypoints
        banded = self.keypoints is not None and self.options.band
        self._skeletons = _skeletons(self.keypoints, self.frames[0]) if banded and self.keypoints else None
        self.backgrounds: tuple[BackgroundModel | None, ...] = ()
        self._sources: list[ViewSource] = []
        self._lanes: list[ThreadPoolExecutor] = []
        self._ahead: dict[int, PendingMasks] = {}
        self._given: PendingMasks | None = None
        self._kept, self._kept_bytes = dict[tuple[int, int], PackedMask](), 0  # masks by view and index
        self._last = -1
        self._areas: dict[int, NDArray[np.int64]] = {}
        if self.options.silhouettes is not None and recording.has_pictures:
            self._open(backgrounds, progress)

    def _open(
        self,
        backgrounds: Sequence[BackgroundModel | None] | None,
        progress: Callable[[str, int, int], None] | None,
    ) -> None:
        r = self.recording
        self.backgrounds = (
            build_backgrounds(r, self.options, self.keypoints, progress) if backgrounds is None else tuple(backgrounds)
        )
        for view, camera, small, background in zip(r.views, r.rig, self.rig, self.backgrounds, strict=True):
            source = ViewSource(view, camera, small, self.options.people, len(r.views))
            if background is not None:
                source.segment = make_segmenter(background, self.options.silhouettes)
            self._sources.append(source)
        masks = [s.objects for s in self._sources]
        objects, notes = persons_objects(r, self.rig, masks, self.keypoints, self.options.people)
        for source, chosen in zip(self._sources, objects, strict=True):
            if source.objects is not None:
                source.objects.chosen = chosen
        self.people_notes = (*self.people_notes, *notes)
        # each camera has its own thread, so that its frames are read in order; with fewer cores, cameras share threads,
        # because more threads than cores mostly wait for each other
        pools = [ThreadPoolExecutor(1, thread_name_prefix=v.name) for v in r.views[: default_threads()]]
        self._lanes = [pools[c % len(pools)] for c in range(len(r.views))]

    @property
    def tells_apart(self) -> bool:
        """Whether at least one view has masks of several separate objects."""
        return any(s.objects is not None and len(s.objects.objects) > 1 for s in self._sources)

    @property
    def guessed_rooms(self) -> str:
        """Warning about views whose background comes from the recording itself although the person's region is unknown;
        "" where there are none.
        """
        views = zip(self.recording.views, self.backgrounds, strict=False)
        guessed = [v.name for v, b in views if b is not None and v.background is None]
        if not guessed or self.keypoints is not None:
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
        return (*self.people_notes, *low_confidence, *unread, *things)

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
        number = self.frames[index]
        silhouettes = colours = depth = None
        if self._lanes:
            history, pending = self._look(index)
            masks, reasons = pending.masks()
            areas = pending.areas()
            if self.options.people:  # people who come or go change the area, which is no fault
                history = history[:, :0]
            collapsed = flag_collapsed(areas, history, self.rig.names, number)
            why = [given or found for given, found in zip(reasons, collapsed, strict=True)]
            silhouettes = make_silhouettes(masks, self.rig, why)
            if self.options.people:
                owners = np.zeros_like(silhouettes.masks)
                for c, source in enumerate(self._sources):
                    found = source.owners(number)
                    owners[c, : found.shape[0], : found.shape[1]] = found
                silhouettes = replace(silhouettes, owners=owners)
            make_ahead(silhouettes, pending.outlines)
            colours = pending.colours(silhouettes.masks.shape) if self.options.colours else None
            depth = self._depth(number, silhouettes)
            if not self.options.people:
                rooms = [s.furnished[0] for s in self._sources]
                silhouettes = behind_things(silhouettes, depth, rooms)
        keypoints = None if self.keypoints is None else self.keypoints[index]
        return Frame(number / self.recording.frame_rate, number, silhouettes, keypoints, colours=colours, depth=depth)

    def _depth(self, number: int, silhouettes: Silhouettes) -> Depth | None:
        """Collect the depth maps of a frame.

        number: number of the video's frame.
        silhouettes: those of the same frame.
        Returns: None where there are no depth cameras.
        """
        sources = [s.depth for s in self._sources]
        if all(s is None for s in sources):
            return None
        maps = np.zeros(silhouettes.masks.shape, np.float32)
        usable = silhouettes.usable & np.array([s is not None for s in sources])
        blank = np.zeros(len(sources), dtype=np.bool_)
        for c, source in enumerate(sources):
            if source is None:
                continue
            try:
                found = self._lanes[c].submit(source.map, number).result()
            except InputError:  # its mask could not be made either, with a reason
                if usable[c]:
                    raise
                continue
            blank[c] = not found.any()
            if usable[c]:
                maps[c, : found.shape[0], : found.shape[1]] = found
        person = silhouettes.masks * usable.astype(np.uint8)[:, None, None]
        return Depth(maps, person, silhouettes.rig, usable, blank=blank)

    def image(self, view: int, index: int) -> Image:
        """Read the undistorted picture (h, w, 3) BGR of a view at working size, for overlays.

        index: 0 <= index < len(stream), from the start of recording.frames.
        Raises: InputError where the stream was opened without silhouettes.
        """
        if not self._lanes:
            raise InputError("This stream was opened without silhouettes and decodes no images.")
        return self._lanes[view].submit(self._sources[view].image, self.frames[index]).result()

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
            source.segment = make_segmenter(background, settings)
        runs, reason = self._mask(view, number)
        if runs is None:
            raise InputError(reason)
        return mask_runs.draw(runs)

    def _mask(self, view: int, frame: int) -> tuple[MaskRuns | None, str]:
        """Make the mask of a view.

        frame: number of the video's frame.
        Returns: as `ViewSource.mask`.
        """
        band = widened = None
        if self._skeletons is not None:
            band = self._skeletons.band(view, frame, self.rig[view])
            widened = None if band is None else partial(self._skeletons.widened, view, frame, band)
        return self._sources[view].mask(frame, band, widened)

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
                self._ahead[i].begin_outlines(self._lanes)
        for i in missing:
            self._areas[i] = self._ahead[i].areas()
            if i < index:
                del self._ahead[i]
        for old in [s for s in self._areas if s < samples[0] - 500 or s > samples[-1] + 500]:
            del self._areas[old]
        self._given = pending = self._ahead.pop(index)
        if index % _SAMPLE_STEP == 0:
            self._areas[index] = pending.areas()
        return np.stack([self._areas[s] for s in samples], 1), pending

    def _packed(self, view: int, index: int) -> PackedMask:
        """Get a mask from memory or make it; masks with colours are too large to be kept."""
        found = self._kept.get((view, index))
        if found is None:
            found = self._made(view, index)
            size = 0 if found.runs is None else found.runs.code.nbytes
            if found.colours is None and self._kept_bytes + size <= KEPT_BYTES:
                self._kept[view, index] = found
                self._kept_bytes += size
        return found

    def _made(self, view: int, index: int) -> PackedMask:
        """Make the mask of a view, with colours where they are wanted.

        index: frame, counted from the start of recording.frames.
        """
        runs, reason = self._mask(view, self.frames[index])
        wanted = self.options.colours and runs is not None and runs.area > 0
        image = self._sources[view].image_of_mask(self.frames[index]) if wanted else None
        if image is None or runs is None:
            return PackedMask(runs, reason)
        y0, y1, x0, x1 = runs.box
        image = image[y0:y1, x0:x1]
        return PackedMask(runs, reason, (colour_codes(image), colour_edges(image)))


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
    views = [mask_folder(folder, v.name, c) for v, c in zip(stream.recording.views, stream.rig, strict=True)]
    shown = 0
    for done, frame in enumerate(stream, 1):
        if frame.silhouettes is None:
            raise InputError(
                f"{stream.recording.name} has key points alone, and silhouettes are made from pictures; give the "
                "videos in recording.toml."
            )
        write_frame_masks(frame.silhouettes, views, frame.index)
        if progress is not None:
            progress(done, len(stream))
        shown += int((frame.silhouettes.areas > 0).sum())
    return shown


def mask_folder(folder: str | Path, view: str, camera: Camera) -> Path:
    """Make the folder for the masks of a view, with a note that they are undistorted and of the camera's size."""
    path = folder_for(Path(folder), view)
    write_text(path / SIDECAR, json.dumps({"undistorted": True, "size": list(camera.size)}) + "\n")
    return path


def write_frame_masks(silhouettes: Silhouettes, folders: Sequence[Path | None], number: int) -> None:
    """Write the masks of a frame as PNG files.

    silhouettes: masks of all views.
    folders: folder of each view; None for a view whose masks are not written.
    number: number of the frame, which names the files.
    """
    for path, camera, mask in zip(folders, silhouettes.rig, silhouettes.masks, strict=True):
        if path is not None:
            ok, data = cv2.imencode(".png", mask[: camera.size[1], : camera.size[0]] * np.uint8(255))
            write_bytes(path / f"{number:06d}.png", data.tobytes() if ok else b"", synced=False)
