"""Make a recording folder from files of depth cameras: maps in millimetres, lenses and camera poses."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion
from hypose.calibration.depth_registration import (
    CoarseAlignment,
    rough_registration,
)
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import EvidenceError, HyposeError, InputError
from hypose.evidence.depth_background import learn_background
from hypose.evidence.depth_evidence import Depth, camera_on_floor
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.silhouettes import make_silhouettes
from hypose.geometry import Array, se3_inverse
from hypose.io.files import file_name, text_of
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.io.recordings.recording import Recording, ViewSettings, write_recording
from hypose.io.recordings.recording_views import DepthSource
from hypose.io.sensors.depth import FOLDER_RATE, DepthFile, open_depth, write_depth_png
from hypose.io.videos.video import list_images
from hypose.pipeline.moved_sensors import solve_places
from hypose.pipeline.recorded_frames import count_people
from hypose.pipeline.run import TrackResult
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_source
from hypose.pipeline.track_loop import StageProgress
from hypose.pipeline.track_options import TrackOptions

_MADE = ("read", "depth", "background", "calibration.toml", "recording.toml")


def import_depth(
    sources: Sequence[str | Path],
    folder: str | Path,
    *,
    empty: Sequence[str | Path] = (),
    frame_rate: float | None = None,
    millimetres: float = 1.0,
    seed: int = 0,
    progress: StageProgress | None = None,
) -> tuple[Path, tuple[str, ...]]:
    """Convert recordings of depth cameras into a recording folder.

    sources: one recording per camera (`hypose.io.sensors.depth`).
    folder: new folder.
    empty: recordings of the empty room in the same order, or none.
    frame_rate: Hz of folders of maps, which do not contain it; None: 30 Hz.
    millimetres: millimetres per step of a value, of folders of maps.
    seed: seed of random numbers.
    progress: called with stage, done, total.
    Returns: path of recording.toml, and sentences for the user.
    Raises: InputError names the input that cannot be used; then, and after an interruption, the folder is left as it
        was.

    Each camera finds the floor in its own maps. Several cameras are registered by the person who moves in front of
    them, including their clocks; frames before the last camera began are left out. Map k is the map at time k / frame
    rate; lost frames become empty maps.
    """
    if empty and len(empty) != len(sources):
        raise InputError(f"Give the empty room of every camera, in the same order: {len(sources)}, not {len(empty)}.")
    _all_different(sources)
    _all_different(empty)
    folder = Path(folder)
    if there := [name for name in _MADE if os.path.lexists(folder / name)]:
        raise InputError(f"{folder} holds {', '.join(there)} already; give a new folder.")
    try:
        return _imported(sources, folder, empty, frame_rate, millimetres, seed, progress or (lambda *_: None))
    except BaseException:  # an incomplete folder would be tracked as if it were complete
        for name in _MADE:
            shutil.rmtree(folder / name, ignore_errors=True)
            with contextlib.suppress(OSError):
                (folder / name).unlink(missing_ok=True)
        raise


def _all_different(given: Sequence[str | Path]) -> None:
    """Raise InputError where a recording is given twice; two cameras would be one."""
    real = [Path(one).resolve() for one in given]
    if twice := [one for one, path in zip(given, real, strict=True) if real.count(path) > 1]:
        raise InputError(f"{twice[0]} is given twice; give the recording of every camera once.")


def _imported(
    sources: Sequence[str | Path],
    folder: Path,
    empty: Sequence[str | Path],
    frame_rate: float | None,
    millimetres: float,
    seed: int,
    report: StageProgress,
) -> tuple[Path, tuple[str, ...]]:
    views, cameras, times, notes = list[ViewSettings](), list[Camera](), list[Array](), list[str]()
    for n, source in enumerate(sources):
        report("read", n, len(sources))
        own, taken = file_name(Path(source).stem), [v.name for v in views]
        name = next(n for n in (own, *(f"{own}_{k}" for k in range(2, len(taken) + 3))) if n not in taken)
        camera, seen = _written(source, folder / "read" / name, frame_rate, millimetres)
        if Path(source).is_dir() and frame_rate is None:
            notes.append(f"{name}: a folder of maps does not tell its frame rate; {FOLDER_RATE:g} per s are taken.")
        files = {"depth": folder / "depth" / name}
        if empty:
            files["background"] = folder / "background" / name
            lens, _ = _written(empty[n], files["background"], frame_rate, millimetres)
            if lens.size != camera.size:
                raise InputError(
                    f"{empty[n]} has maps of {lens.size[0]} x {lens.size[1]} px, {source} of {camera.size[0]} x "
                    f"{camera.size[1]} px; record both in the same mode."
                )
        floor = _on_floor(source, files.get("background", folder / "read" / name), camera)
        views.append(ViewSettings(name, files))
        cameras.append(replace(camera, name=name, camera_from_world=floor))
        notes.append(f"{name}: {cameras[-1].position[2]:.2f} m above the floor.")
        times.append(seen)
    report("read", len(sources), len(sources))
    rates = [_rate(t, source) for t, source in zip(times, sources, strict=True)]
    if max(rates) / min(rates) > 1.02:
        said = ", ".join(f"{v.name} {r:.1f}" for v, r in zip(views, rates, strict=True))
        raise InputError(
            f"The cameras have different frame rates ({said} per s); record all at one rate, and give that of folders."
        )
    rate = float(np.round(np.median(rates), 1))
    orders = list[NDArray[np.intp]]()
    for view, seen in zip(views, times, strict=True):
        order = _nearest(seen, seen[0] + np.arange(round((seen[-1] - seen[0]) * rate) + 1) / rate, rate)
        if lost := int((order < 0).sum()):
            notes.append(f"{view.name}: {lost} of {len(order)} frames were lost while recording; their maps are empty.")
        orders.append(order)
    _arrange(folder, views, orders, cameras)
    recording = _recording(folder, CameraRig(tuple(cameras)), views, rate)
    if len(views) > 1:
        clips = []
        for k, (view, camera) in enumerate(zip(views, cameras, strict=True)):
            report("masks", k, len(views))
            clips.append(_clip(_recording(folder, CameraRig((camera,)), [view], rate)))
        report("masks", len(views), len(views))
        try:
            found = register_depth(clips, rate, seed=seed, progress=report)
        except HyposeError as error:
            shared, many = list[str](), FrameSettings(silhouettes=recording.silhouettes, people=True)
            for view, camera in zip(views, cameras, strict=True) if empty else ():
                with FrameStream(_recording(folder, CameraRig((camera,)), [view], rate), many) as frames:
                    if count_people(frames.frame, min(len(frames), SETTINGS.placing_looked_at)) > 1:
                        shared.append(view.name)
            if shared:
                first_s = SETTINGS.placing_looked_at / rate
                raise type(error)(
                    f"Several people stand before {' and '.join(shared)}, and the places of cameras are found from one "
                    f"person alone: let one move before all of them for the first {first_s:.0f} s, and the "
                    f"others come then. ({error})"
                ) from error
            places = ", ".join(f"{c.name} {c.position[2]:.2f} m" for c in cameras)
            raise type(error)(f"{error} By their maps the cameras hang above the floor: {places}.") from error
        late = np.rint((found.seconds.max() - found.seconds) * rate).astype(int)
        _arrange(folder, views, [order[skip:] for order, skip in zip(orders, late, strict=True)], cameras)
        # the lenses are those of the maps as they were written; the clips have smaller ones without distortion
        placed = [replace(c, camera_from_world=f.camera_from_world) for c, f in zip(cameras, found.rig, strict=True)]
        recording = _recording(folder, CameraRig(tuple(placed)), views, rate)
        for view, rough, seconds in zip(views[1:], found.rough, found.seconds[1:], strict=True):
            notes.append(
                f"{view.name}: brought together by the person; clock {seconds:+.3f} s, {1000 * rough.apart:.0f} mm "
                "between the two motions at first."
            )
    shutil.rmtree(folder / "read")
    return write_recording(recording, folder), tuple(notes)


def _written(source: str | Path, folder: Path, frame_rate: float | None, millimetres: float) -> tuple[Camera, Array]:
    """Write the maps of a recording to a folder; return the camera, and the increasing times (T,) s of the maps."""
    opened: DepthFile = open_depth(source, frame_rate or FOLDER_RATE, millimetres)
    folder.mkdir(parents=True, exist_ok=True)
    times, read = list[float](), 0
    for frame in opened.frames:
        read += 1
        if not times or frame.time > times[-1]:
            write_depth_png(folder / f"{len(times):06d}.png", frame.depth)
            times.append(frame.time)
    if not times:
        raise InputError(f"{source} has no depth frames; record again.")
    if len(times) <= read // 2:
        raise InputError(f"{source} does not tell when its frames were seen; record again.")
    return opened.camera, np.array(times)


def _on_floor(source: str | Path, folder: Path, camera: Camera) -> Array:
    """Estimate camera_from_world (4, 4) from the floor in the median of the camera's first maps; an error names the
    source.
    """
    maps = DepthSource(ViewSettings(camera.name, {"depth": folder}), camera, camera.pinhole())
    calm = learn_background([maps.map(k) for k in range(min(SETTINGS.placing_calm, len(list_images(folder))))]).depth
    try:
        found = camera_on_floor(calm, camera)
    except EvidenceError as error:
        raise EvidenceError(f"{source}: {error}") from None
    height = float(se3_inverse(found)[2, 3])
    if not SETTINGS.placing_height_m[0] < height < SETTINGS.placing_height_m[1]:
        raise InputError(
            f"{source}: the camera would hang {height:.2f} m above the floor; if the steps of its values are no "
            "millimetres, say with --millimetres how many one is."
        )
    return found


def _rate(times: Array, source: str | Path) -> float:
    """Compute the frame rate, Hz, counting lost frames."""
    if len(times) < 2:
        return FOLDER_RATE
    steps = np.diff(times)
    usual = float(steps[steps < 1.5 * np.median(steps)].mean())  # times are rounded to milliseconds
    count = np.rint(steps / usual).sum()
    if count > 2 * len(steps):
        raise InputError(
            f"{source}: {count - len(steps):.0f} of {count + 1:.0f} frames are missing between its first and its last; "
            "give what lies before and after the gap one by one."
        )
    found = float(count / (times[-1] - times[0]))
    if not 1 <= found <= 1000:
        raise InputError(f"{source} has {found:g} frames per s by its times, which cannot be; record again.")
    return found


def _nearest(times: Array, at: Array, rate: float) -> NDArray[np.intp]:
    """Find the frame that is nearest to each of the instants `at` (N,) s; -1 where none is near enough.

    times: (T,) of the frames, s.
    rate: Hz.
    """
    rows = np.rint(np.interp(at, times, np.arange(len(times)))).astype(np.intp)
    return np.where(np.abs(times[rows] - at) <= SETTINGS.placing_near / rate, rows, -1)


def _arrange(
    folder: Path, views: Sequence[ViewSettings], orders: Sequence[NDArray[np.intp]], cameras: Sequence[Camera]
) -> None:
    """Copy the maps that were read of each view to its depth maps, in an order (T,) of their numbers, -1: an empty map.

    Raises: InputError names a view that has no map.
    """
    shutil.rmtree(folder / "depth", ignore_errors=True)
    for view, order, camera in zip(views, orders, cameras, strict=True):
        if not len(order):
            raise InputError(f"{view.name} ended before the others began; start all cameras together.")
        files = list_images(folder / "read" / view.name)
        view.files["depth"].mkdir(parents=True)
        for k, n in enumerate(order.tolist()):
            target = view.files["depth"] / f"{k:06d}.png"
            if n < 0:
                write_depth_png(target, np.zeros(camera.size[::-1]))
            else:
                shutil.copyfile(files[n], target)


def _recording(folder: Path, rig: CameraRig, views: Sequence[ViewSettings], rate: float) -> Recording:
    count = min(len(list_images(v.files["depth"])) for v in views)
    name = text_of(folder.resolve().name)
    return Recording(folder, name, rig, tuple(views), rate, None, keypoint_set=None, n_frames=count)


def _clip(recording: Recording) -> list[Frame]:
    """Read the first frames of a camera in which a person is seen, without those at both ends that show little of the
    person. Why: the person who starts the cameras walks in first.
    """
    found, areas = list[Frame](), list[int]()
    with FrameStream(recording) as frames:
        for frame in frames:
            masks = frame.the(Silhouettes)
            area = int(masks.areas[0]) if masks.usable[0] else 0
            if found or area > SETTINGS.placing_least_share * masks.masks[0].size:
                found.append(frame)
                areas.append(area)
            if len(found) == SETTINGS.placing_looked_at:
                break
    if not found:
        raise EvidenceError(
            f"{recording.views[0].name} shows no person; record a person who walks about and turns before all cameras."
        )
    shown = np.array(areas)
    whole = np.flatnonzero(shown > 0.5 * np.median(shown[shown > 0]))
    return found[whole[0] : whole[-1] + 1]


@dataclass(frozen=True)
class RegisteredSensors:
    """Depth cameras in one common world.

    rig: the cameras, all in the world frame of the first one.
    seconds: (C,) to add to each camera's times, s.
    rough: first, rough alignment of each camera but the first.
    """

    rig: CameraRig
    seconds: Array
    rough: tuple[CoarseAlignment, ...]


def register_depth(
    clips: Sequence[Sequence[Frame]],
    frame_rate: float,
    *,
    seed: int = 0,
    progress: StageProgress = lambda stage, done, total: None,
) -> RegisteredSensors:
    """Register depth cameras by the motion of one person that each of them saw.

    clips: frames of each sensor; its rig is that sensor alone, in a world of its own with z up and the floor at z = 0
        (`hypose.evidence.depth_evidence.camera_on_floor`); times are on its own clock.
    frame_rate: Hz.
    progress: called with stage, done, total; raising KeyboardInterrupt in it ends the work.
    Returns: the cameras in the first one's world.
    Raises: InputError with fewer than two sensors; CalibrationError where the movements do not
        belong together; errors name the sensors.

    Each sensor is tracked alone; the motions give a first alignment; then places and poses are solved together.
    """
    if len(clips) < 2:
        raise InputError("Bringing depth cameras together needs at least two; one stands where it stands.")
    options, alone = TrackOptions(seed=seed), [clip[0].the(Depth).rig[0] for clip in clips]
    joints, times = [], [np.array([f.time for f in clip]) for clip in clips]
    ends = np.cumsum([len(clip) for clip in clips]).tolist()
    for k, clip in enumerate(clips):

        def tracked_alone(stage: str, done: int, _: int, before: int = ends[k] - len(clip)) -> None:
            if stage == "track":
                progress("each sensor alone", before + done, ends[-1])

        with _named(alone[k].name):
            found = track_source(FrameList(clip, frame_rate), frame_rate, options, progress=tracked_alone)
            joints.append(_whole(found).joints)
    rough = list[CoarseAlignment]()
    for k in range(1, len(clips)):
        with _named(f"{alone[0].name} and {alone[k].name}"):
            rough.append(rough_registration(times[0], joints[0], times[k], joints[k]))
    seconds = np.array([0.0, *(r.seconds for r in rough)])
    cameras = np.stack(
        [alone[0].camera_from_world]
        + [c.camera_from_world @ se3_inverse(r.a_from_b) for c, r in zip(alone[1:], rough, strict=True)]
    )
    paired = _pairs(times, seconds, frame_rate)
    for n in range(2):
        progress("together", n, 2)
        rig = CameraRig(tuple(replace(c, camera_from_world=e) for c, e in zip(alone, cameras, strict=True)))
        frames = [_together(clips, row, rig) for row in paired]
        found = track_source(FrameList(frames, frame_rate), frame_rate, options, find_places=False)
        motion = _whole(found)
        assert motion.poses is not None
        about = (found.body, motion.poses, 1 - motion.cost, cameras, SETTINGS.placing_frames)
        cameras = solve_places(frames.__getitem__, *about)
    progress("together", 2, 2)
    rig = CameraRig(tuple(replace(c, camera_from_world=e) for c, e in zip(alone, cameras, strict=True)))
    return RegisteredSensors(rig, seconds, tuple(rough))


@contextmanager
def _named(who: str) -> Iterator[None]:
    """Add the sensor's name to errors that are raised inside."""
    try:
        yield
    except HyposeError as error:
        raise type(error)(f"{who}: {error}") from error


def _whole(found: TrackResult) -> Motion:
    """Return the motion; raise KeyboardInterrupt where the run was interrupted."""
    if not found.complete:
        raise KeyboardInterrupt
    return found.motion


def _pairs(times: Sequence[Array], seconds: Array, frame_rate: float) -> list[list[int]]:
    """Find, for each frame of the first sensor, the frames of all sensors that are nearest in time; instants that one
    of them lacks are left out.
    """
    rows = np.stack([_nearest(own + shift, times[0], frame_rate) for own, shift in zip(times, seconds, strict=True)], 1)
    rows = rows[(rows >= 0).all(1)]
    if len(rows) < 10:
        raise InputError("The depth cameras share fewer than ten instants; start them together, or record for longer.")
    return rows.tolist()


def _together(clips: Sequence[Sequence[Frame]], row: Sequence[int], rig: CameraRig) -> Frame:
    """Combine one frame of each sensor into one frame of all."""
    own = [clip[k].the(Depth) for clip, k in zip(clips, row, strict=True)]
    silhouettes = make_silhouettes([d.person[0, :h, :w] for d, (w, h) in zip(own, rig.sizes, strict=True)], rig)
    maps = np.zeros(silhouettes.masks.shape, np.float32)
    for here, depth, (w, h) in zip(maps, own, rig.sizes, strict=True):
        here[:h, :w] = depth.maps[0, :h, :w]
    first = clips[0][row[0]]
    return Frame(first.time, first.index, silhouettes, depth=Depth(maps, silhouettes.masks, rig, silhouettes.usable))
