"""Views of a recording: the files of each camera, their size, length and frame rate, and whether the views agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.errors import CalibrationError, InputError
from hypose.geometry import Array
from hypose.io.recordings.object_masks import SIDECAR, ObjectMasks, open_masks
from hypose.io.videos.video import VideoReader, check_numbers, frame_size, frame_times, open_video, stored_frames

# Ratio of frame rates below which they count as equal: 29.97 and 30 frames/s differ by rounding in the container.
_ALIKE = 1.005


@dataclass(frozen=True)
class ViewSettings:
    """The files and settings of one camera's view.

    files: existing paths by kind of evidence: "video" (a file), "images" or "depth" (folders of images or depth maps),
        "masks" (video or folder), "background" (video, photo or folder that shows the empty room), "keypoints" (file or
        folder); without the kinds that the view does not have.
    image_shift: (x, y) to add to image coordinates, px of the calibrated size.
    accept_scaled: images of another shape were stretched, not cut.
    first_mask: number of the first frame's files, for masks of one folder per object; None for the view's lowest
        number.
    rate: frames/s at which the video is read by its time stamps; None to read it frame by frame.
    """

    name: str
    files: Mapping[str, Path] = field(default_factory=dict)
    image_shift: tuple[float, float] = (0.0, 0.0)
    accept_scaled: bool = False
    first_mask: int | None = None
    rate: float | None = None

    @property
    def source(self) -> Path | None:
        """The video, image folder or folder of depth maps; None where there are only masks or key points."""
        return next((self.files[kind] for kind in ("video", "images", "depth") if kind in self.files), None)

    @property
    def segmented(self) -> bool:
        """Whether masks are made from its video or images."""
        return self.has_pictures and not {"masks", "depth"} & self.files.keys()

    @property
    def has_pictures(self) -> bool:
        """Whether there is a video, images, depth maps or masks; else there are key points alone."""
        return bool({"video", "images", "depth", "masks"} & self.files.keys())

    def without(self, *kinds: str) -> ViewSettings:
        """Copy the view and leave out its files of some kinds."""
        return replace(self, files={kind: path for kind, path in self.files.items() if kind not in kinds})


_Clip = VideoReader | ObjectMasks
"""A video, folder of images or masks of a view, with its size, length and frame rate; no picture is read yet."""


def look(view: ViewSettings) -> list[_Clip]:
    """Open the files of a view (video or images, then masks)."""
    out: list[_Clip] = []
    for kind in [k for k in ("video", "images", "depth", "masks") if k in view.files]:
        path = view.files[kind]
        made_here = (path / SIDECAR).is_file()
        if made_here and view.source is not None:
            continue  # found by frame number; there may be masks of some frames only
        if path.is_dir() and not made_here:
            check_numbers(path)
        out.append(open_masks(path, view.first_mask) if kind == "masks" else open_video(path))
    return out


def look_together(views: Sequence[ViewSettings], notes: list[str]) -> tuple[list[ViewSettings], list[list[_Clip]]]:
    """Read the properties of all views' files, and number masks of one folder per object alike in all views.

    Where such files begin with different numbers, the lowest is the first frame of all views.

    notes: list to which a sentence about different numbers is added.
    Returns: the views, with `first_mask` set where needed, and the properties of their files.
    Why: a person who is not seen at the start has no masks there.
    """
    with ThreadPoolExecutor(len(views)) as pool:  # counting the frames that can be decoded takes time
        clips = list(pool.map(look, views))
    masks = {k: c for k, found in enumerate(clips) for c in found if isinstance(c, ObjectMasks)}
    numbered = {k: c.first for k, c in masks.items() if c.first is not None}
    begin, shortest = sorted(numbered.values()), min((masks[k].n_frames for k in numbered), default=0)
    if not 0 < (begin[-1] - begin[0] if begin else 0) < shortest:  # independent counters of cameras differ by more
        return list(views), clips
    same = [replace(v, first_mask=begin[0]) if k in numbered else v for k, v in enumerate(views)]
    late = ", ".join(f"{views[k].name} {first}" for k, first in numbered.items() if first != begin[0])
    notes.append(
        f"Files of masks begin with different numbers ({begin[0]}, but {late}): they are taken as the numbers of all "
        "views' frames."
    )
    return same, [look(v) if k in numbered else clips[k] for k, v in enumerate(same)]


def open_pictures(view: ViewSettings, threads: int | None = None) -> VideoReader | ObjectMasks:
    """Open the video, images or masks of a view, whichever it has first.

    threads: number of threads that decode a video; None for all.
    Raises: InputError where the view has none of them.
    """
    if view.source is not None:
        return open_video(view.source, threads, rate=view.rate)
    if "masks" not in view.files:
        raise InputError(f"View {view.name} has neither video, images nor masks.")
    return open_masks(view.files["masks"], view.first_mask)


def check_picture_size(
    view: ViewSettings, camera: Camera, path: Path, size: tuple[int, int], notes: list[str] | None
) -> None:
    """Check that pictures of a given size can be those of a camera.

    path: the pictures.
    size: their width and height, px.
    notes: list to which a sentence is added where they are scaled; None for no sentence.
    Raises: CalibrationError where the shapes differ by more than 1 %.
    """
    if size == camera.size:
        return
    (w, h), (cw, ch) = size, camera.size
    ratio = (w / h) / (cw / ch)
    if abs(ratio - 1) > 0.01 and not view.accept_scaled:
        advice = (
            "calibrate at this size, or, if the images were stretched (not cut), set accept_scaled = true "
            "for this view in recording.toml"
        )
        if abs((h / w) / (cw / ch) - 1) <= 0.01:
            advice = "the images look turned by 90 degrees: turn them back, or calibrate turned images"
        raise CalibrationError(
            f"View {view.name}: {path} is {w} x {h} px, camera {camera.name} is calibrated for {cw} x {ch} "
            f"px; {advice}."
        )
    if notes is not None and not (path / SIDECAR).is_file():  # hypose's own masks are usually smaller
        notes.append(
            f"View {view.name}: {path.name} is {w} x {h} px, the calibration {cw} x {ch} px; the images are "
            "taken as scaled."
        )


def check_background(view: ViewSettings, camera: Camera, size: tuple[int, int] | None) -> None:
    """Check that the background of a view fits its pictures.

    size: (width, height) size of the view's pictures.
    Raises: InputError where it does not fit.
    """
    background = view.files["background"]
    if "depth" not in view.files:
        check_picture_size(view, camera, background, frame_size(background), None)
        return
    if not background.is_dir():
        raise InputError(
            f"View {view.name}: the background of a depth view is a folder of 16-bit PNG of the empty room, "
            f"{background} is not; leave it out to go by the floor."
        )
    room = frame_size(background)
    if room != size:
        raise InputError(
            f"View {view.name}: the empty room in {background} is {room[0]} x {room[1]} px, the maps in "
            f"{view.files['depth']} are not; record both in the same mode of the camera, or leave the background out."
        )


def stored_numbers(view: ViewSettings) -> NDArray[np.int64] | None:
    """Compute the stored frame for each frame of a video that is read by its time stamps; None where the numbers are
    equal.
    """
    return None if "video" not in view.files or view.rate is None else stored_frames(view.files["video"], view.rate)


def on_one_clock(
    where: str,
    given: float | None,
    views: Sequence[ViewSettings],
    clips: Sequence[list[_Clip]],
    reported: float | None,
    notes: list[str],
) -> tuple[list[ViewSettings], float]:
    """Determine the frame rate of a recording, and read irregular videos by their time stamps.

    The frame rate is the given one, else that of the videos (the lowest), else that of the key points' file. Videos
    with lost frames, or with another or a varying frame rate, are read by their time stamps.

    where: start of the error messages.
    given: frame rate of recording.toml, frames/s; None where it has none.
    views, clips: views, and the properties of their files as `look_together` gives them.
    reported: frame rate of the key points' file, frames/s; None where it has none.
    notes: list to which sentences about irregular videos are added.
    Returns: the views with `rate` set where needed, and the frame rate; n_frames of the files of such views are set to
        the number of frames that are read.
    Raises: InputError where no frame rate is known.
    """
    times = [frame_times(v.files["video"]) if "video" in v.files else None for v in views]
    rates = [
        c.frame_rate if t is None else 1 / _step(t)
        for v, t, found in zip(views, times, clips, strict=True)
        for c in found
        if c.path == v.source and c.frame_rate is not None
    ]
    alike = not rates or max(rates) / min(rates) <= _ALIKE
    found = (float(np.median(rates)) if alike else min(rates)) if rates else reported
    if given is None and found is None:
        what = "images" if any(clips) else "key points"
        raise InputError(f"{where}: {what} carry no frame rate; add frame_rate = ... (frames per second).")
    if given is not None and found is not None and abs(given / found - 1) > 0.005:
        says = "videos say" if rates else "file of key points says"
        notes.append(f"frame_rate = {given:g} is used as given; the {says} {found:g} frames/s.")
    timed_views = [replace(v, rate=found) if t is not None and rates else v for v, t in zip(views, times, strict=True)]
    for k, (view, t) in enumerate(zip(timed_views, times, strict=True)):
        stored = stored_numbers(view)
        if stored is None or t is None:
            timed_views[k] = views[k]
            continue
        for clip in clips[k]:
            clip.n_frames = clip.stated_frames = len(stored)
        notes.append(f"View {view.name}: {_of_times(t)}, so it is read by its time stamps at {found:g} frames/s.")
    return timed_views, float(given if given is not None else found or 0.0)


def _step(times: Array) -> float:
    """Compute the mean time between two frames, without the steps over lost frames, s."""
    steps = np.diff(times)
    return float(steps[steps < 1.5 * np.median(steps)].mean())


def _of_times(times: Array) -> str:
    """Describe the irregularity in the time stamps of a video."""
    steps, step = np.diff(times), _step(times)
    lost = np.round(steps / step) - 1
    if lost.any():
        first, count = float(times[int(np.argmax(lost > 0))]), int(lost.sum())
        return f"its video lost {count} of {len(times) + count} frames, the first after {first:.2f} s"
    if np.abs(steps / step - 1).max() > 0.05:
        return f"the frame rate of its video varies between {1 / steps.max():.1f} and {1 / steps.min():.1f} frames/s"
    return f"its video has {1 / step:.4g} frames/s"


def common_frames(views: Sequence[ViewSettings], clips: Sequence[list[_Clip]], notes: list[str]) -> int:
    """Count the frames that every view has.

    views, clips: views, and the properties of their files.
    notes: list to which sentences are added where views differ or files are cut off.
    Raises: InputError where a view has no frames.
    """
    counts = {}
    for view, found in zip(views, clips, strict=True):
        for clip in found:
            with_masks = len(found) > 1 and clip is found[-1]
            counts[f"{view.name} masks" if with_masks else view.name] = clip.n_frames
            if clip.stated_frames > clip.n_frames:
                notes.append(
                    f"View {view.name}: {clip.path.name} states {clip.stated_frames} frames but decoding ends after "
                    f"frame {clip.n_frames - 1}; it is cut off or damaged, or its program stated too many: copy it "
                    "again if more was recorded."
                )
            if clip.n_frames == 0:
                raise InputError(f"View {view.name}: {clip.path} has no frames; record or copy it again.")
    low, high = min(counts.values()), max(counts.values())
    if high - low > 2:
        said = ", ".join(f"{n} {c}" for n, c in counts.items())
        notes.append(
            f"The views have different numbers of frames ({said}); the first {low} frames, which all have, "
            "are used. Check that all cameras start at the same instant."
        )
        next_low = sorted(counts.values())[1]
        if len(views) > 2 and next_low > 1.05 * low:  # one camera stopped before the others
            first = min(counts, key=lambda n: counts[n])
            notes[-1] += f" Without {first}, the others' {next_low} frames could be tracked."
    return low
