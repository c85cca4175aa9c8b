"""The people that key points and masks of a recording show: all detections, and those of the recording's person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.cameras.camera import CameraRig
from hypose.evidence.association import object_points, people_of_objects
from hypose.evidence.frame import Keypoints
from hypose.evidence.keypoints import keypoint_names
from hypose.evidence.one_person import OnePerson, one_person, without_held
from hypose.geometry import Array
from hypose.io.recordings.object_masks import ObjectMasks
from hypose.io.recordings.recording import Recording, keypoints_of_recording, stored_sizes
from hypose.io.videos.video import evenly_spread

_SAMPLES = 24  # frames in which objects are compared


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
        return RecordedPerson((), [], nothing, OnePerson(nothing, False, (), False, (), ()))
    names = keypoint_names(recording.keypoint_set)
    views = [without_held([frame[c] for frame in candidates], first=3) for c in range(len(small))]
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
    frames = evenly_spread(recording.frames.start, recording.frames.stop, _SAMPLES)
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
    for row in evenly_spread(0, len(keypoints), _SAMPLES):
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
