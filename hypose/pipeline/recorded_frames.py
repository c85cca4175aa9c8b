"""Open the frames of a recording as a run needs them: pictures of one camera, masks of one person or of all people.

Whether masks show several people is decided view by view, without a calibration, since the calibration may be the thing
that is checked.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import CameraRig
from hypose.errors import HyposeError, InputError
from hypose.evidence.frame import Frame, Silhouettes, pieces_of
from hypose.evidence.keypoints import person_size
from hypose.evidence.people import HullPerson, people_seen, views_to_find
from hypose.io.recordings.frames import FrameSettings, FrameStream, load_keypoints, unreported
from hypose.io.recordings.recording import Recording
from hypose.pipeline.one_camera import Clicks, clicks_of, extent, picture_size
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.track_loop import StageProgress
from hypose.pipeline.track_options import TrackOptions


def frames_wanted(recording: Recording, options: TrackOptions) -> FrameSettings | None:
    """Choose the settings with which the frames of a recording are read for a run.

    Returns: the settings; None: the usual ones of several cameras.

    Raises: InputError where a recipe for one camera lacks the pictures, masks or key points that it needs.
    """
    if options.of_picture:
        side = side_to_work_on(recording, clicks_of(options.start, recording))
        return FrameSettings(side, masks=needs_masks(recording, options.looks_at))
    if options.looks_at == "keypoints":  # key points need no images, so nothing is decoded
        return FrameSettings(masks=False)
    if options.looks_at == "silhouettes" and "colours" in options.preset.likes and options.own.get("colours"):
        return FrameSettings(silhouettes=recording.silhouettes, colours=True)
    return None


def check_views(recording: Recording, of_picture: bool = False) -> None:
    """Raise InputError where the number of cameras does not suit: two or more, one depth camera, or with `of_picture`
    the picture of one.
    """
    if of_picture:
        view = one_view(recording, None).views[0]
        if view in recording.depth_views:
            raise InputError(f"{view.name} is a depth camera, and this recipe looks at pictures; leave --recipe out.")
    elif len(recording.views) == 1 and not recording.depth_views:
        name = recording.views[0].name
        raise InputError(
            f"{recording.name} has one camera, {name}, and this needs two or more; track one with --recipe monocular "
            f"--camera {name}, or add the others as [[view]] in recording.toml."
        )


# ---- one camera ----------------------------------------------------------------------------------------------------


def one_view(recording: Recording, camera: str | None) -> Recording:
    """Limit a recording to one camera.

    camera: name of the camera; None: the only one of the recording.
    Raises: InputError where this does not name a camera with pictures; it lists the cameras.
    """
    names = [v.name for v in recording.views]
    if camera is None and len(names) > 1:
        raise InputError(
            f"The recording {recording.name} has {len(names)} cameras ({', '.join(names)}); name one with --camera."
        )
    if camera is not None and camera not in names:
        raise InputError(
            f"The recording {recording.name} has no camera {camera!r}; it has {', '.join(names)}: give one of them "
            "with --camera."
        )
    k = 0 if camera is None else names.index(camera)
    view = recording.views[k]
    if view.source is None:
        raise InputError(
            f"Camera {view.name} has masks but neither video nor images, and one camera alone needs pictures; give its "
            "video in recording.toml."
        )
    return replace(recording, views=(view,), rig=CameraRig((recording.rig[k],)))


def needs_masks(recording: Recording, evidence: str) -> bool:
    """Return whether masks of the one camera are made: it has masks, and the evidence is with them.

    evidence: option of the command, one of `tracking.recipes.PICTURE_CUES`.
    Raises: InputError where the evidence needs masks or key points that the camera does not have.
    """
    view = recording.views[0]
    masked = bool(
        {"masks", "background"} & view.files.keys()
    )  # a background learned from the clip has the person in it
    if evidence in ("silhouettes", "both") and not masked:
        raise InputError(
            f"Camera {view.name} has neither masks nor a background, so it gives no silhouettes; add masks or a "
            "background in recording.toml, or leave --evidence out."
        )
    if evidence in ("keypoints", "both") and (recording.keypoint_set is None or "keypoints" not in view.files):
        raise InputError(
            f"Camera {view.name} has no key points; add keypoints = ... to the view in recording.toml, or leave "
            "--evidence out."
        )
    return masked and evidence in ("auto", "silhouettes", "both")


def side_to_work_on(recording: Recording, clicks: Clicks | None) -> int:
    """Compute the longer side (px) of the pictures to work on, so that the person is about SETTINGS.picture_target_px
    tall at the start.

    clicks: joints clicked in the first picture; None: the key points of the first second show the size.
    Returns: between SETTINGS.picture_smallest_side and the calibrated size; the usual size where the person's is not
        known.
    """
    points = load_keypoints(recording)[: 1 + int(recording.frame_rate)] if clicks is None else []
    found = [size / max(k.rig[0].size) for k in points if (size := person_size(k.points[0])) > 0]
    if clicks is not None:
        found = [extent(np.array(list(clicks.values()))) / max(picture_size(recording))]
    if not found:
        return FrameSettings().longer_side
    longest, wanted = max(recording.rig[0].size), SETTINGS.picture_target_px / max(np.median(found), 1e-3)
    return round(min(max(wanted, min(SETTINGS.picture_smallest_side, longest)), longest))


# ---- several people ------------------------------------------------------------------------------------------------


def several_apart(silhouettes: Sequence[Silhouettes], often: float = 0.5) -> bool:
    """Return whether at least two views show people side by side in a share of the frames larger than `often`. One view
    alone can be an arm, or a chair that a table cuts off.
    """
    shown = [[u and _others_in_view(m) > 1 for m, u in zip(s.masks, s.usable, strict=True)] for s in silhouettes]
    usable = np.sum([s.usable for s in silhouettes], axis=0)
    return int((np.sum(shown, axis=0) > often * np.maximum(usable, 1)).sum()) >= 2


def _others_in_view(mask: NDArray[np.uint8]) -> int:
    """Count the large parts of a mask (h, w) that stand side by side; parts above each other count as one."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    parts = stats[1:]
    if not len(parts):
        return 0
    area, height = parts[:, cv2.CC_STAT_AREA], parts[:, cv2.CC_STAT_HEIGHT]
    first = int(area.argmax())
    large = parts[(area >= SETTINGS.several_large * area[first]) & (height >= 0.5 * height[first])]
    count, end = 0, -1
    for left, width in sorted(large[:, [cv2.CC_STAT_LEFT, cv2.CC_STAT_WIDTH]].tolist()):
        count += left > end
        end = max(end, left + width)
    return count


def people_frames(recording: Recording, options: TrackOptions, progress: StageProgress = unreported) -> FrameStream:
    """Open the frames of a recording with all people in the masks, where masks are wanted.

    Raises: InputError for key points together with depth cameras.
    """
    depth = [v.name for v in recording.depth_views]
    if depth and options.looks_at != "silhouettes":
        raise InputError(
            f"Several people before depth cameras ({', '.join(depth)}) are distinguished by what these measure, "
            f"not by key points; leave out --evidence {options.looks_at}, or --people."
        )
    masks = options.looks_at != "keypoints"
    settings = FrameSettings(silhouettes=recording.silhouettes, masks=masks, people=True, colours=True)
    return FrameStream(recording, settings, progress=progress)


def frames_to_examine(recording: Recording, progress: StageProgress = unreported) -> tuple[FrameStream, bool]:
    """Open the frames of a recording whose calibration is in doubt.

    Where several people stand side by side, the masks keep all of them. Why: which person a view shows is not known
    before the calibration is right.
    Returns: the frames, and whether several people are in the masks.
    """
    one = FrameStream(recording, progress=progress)
    depth = bool(recording.depth_views)  # a depth camera's mask keeps the largest part, or the one most like a person
    if Silhouettes not in one.kinds or one.tells_apart or (depth and len(recording.views) == 1):
        return one, False
    all_people = FrameStream(recording, replace(one.options, people=True), one.backgrounds or None)
    looks = 0 if depth else SETTINGS.several_looks
    rows = np.unique(np.linspace(0, len(all_people) - 1, looks).astype(int)).tolist()
    masks = pieces_of((all_people.frame(i) for i in rows), Silhouettes)
    several = several_apart(masks)
    # people who pass behind each other are counted if the cameras agree
    if not several and (depth or several_apart(masks, SETTINGS.several_now_and_then)):
        several = count_people(all_people.frame, len(all_people)) > 1
    kept, other = (all_people, one) if several else (one, all_people)
    other.close()
    return kept, several


def _apart(people: Sequence[HullPerson]) -> int:
    """Count the people who stand clearly apart from all larger ones."""
    kept: list[HullPerson] = []
    for p in people:
        if all(np.linalg.norm(p.axis - q.axis) > SETTINGS.people_near_m for q in kept):
            kept.append(p)
    return len(kept)


def count_people(frame_at: Callable[[int], Frame], total: int, looks: int = 5) -> int:
    """Count the people in the masks of a recording: the median over `looks` frames that are spread over it.

    frame_at: function that reads a frame by its number.
    total: number of frames.

    Children below a metre do not count, since objects have their size. A frame with fewer than three usable views does
    not count, unless there is a depth camera.
    """
    found = []
    for t in np.unique(np.linspace(0, total - 1, min(total, looks)).astype(int)).tolist():
        with contextlib.suppress(HyposeError):
            frame = frame_at(t)
            views = [int(masks.usable.sum()) for masks in frame.of(Silhouettes)]
            if any(count >= views_to_find(frame) for count in views):
                found.append(_apart([p for p in people_seen(frame) if p.tall]))
    return int(np.median(found)) if found else 0


def with_all_people(source: FrameStream, options: TrackOptions) -> FrameStream | None:
    """Open the frames of a recording with all people in the masks; None where the masks do not show several, or are not
    the only evidence.
    """
    settings, views = source.options, source.recording.views
    masks = Silhouettes in source.kinds and options.looks_at != "keypoints" and not options.of_picture
    # one depth camera keeps the largest person; several depth cameras, and pictures, may show other people; masks made
    # by other programs may be of one person
    given = any("masks" in view.files for view in views) or options.looks_at != "silhouettes"
    enough = len(views) > 1 and not given if source.recording.depth_views else len(views) > 2
    if not masks or not enough or source.tells_apart:
        return None
    whole = FrameSettings(settings.longer_side, settings.silhouettes, people=True, colours=True)
    all_people = FrameStream(source.recording, whole, source.backgrounds or None)
    if count_people(all_people.frame, len(all_people)) > 1:
        return all_people
    all_people.close()
    return None
