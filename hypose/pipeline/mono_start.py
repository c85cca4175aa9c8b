"""Where a monocular track starts: joints clicked in the first picture (a small JSON file), or a detector's key points.

The file of clicks, pixels of the picture as it was recorded, (0, 0) in the middle of the upper left pixel:

    {"camera": "cam1", "frame": 0, "joints": {"left_shoulder": [512.0, 310.5], "left_elbow": [540, 402], ...}}

camera and frame (number in the recording, the first that is tracked) may be left out; joints are those of the body
model. At least six are needed; shoulders, elbows, wrists, hips, knees, ankles, neck and head are a good set.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hypose.body.body import Body
from hypose.body.ready_bodies import JOINT_NAMES, human
from hypose.cameras.camera import Camera
from hypose.errors import EvidenceError, InputError
from hypose.evidence.keypoints import person_size
from hypose.geometry import Array
from hypose.io.recordings.frames import FrameOptions, load_keypoints
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import open_video
from hypose.json_text import parse_json
from hypose.monocular.initialise import LEAST_POINTS, InitialFit, initialise
from hypose.monocular.points_fit import PointsOn
from hypose.monocular.settings import MonoSettings
from hypose.monocular.types import MonoPoints, clicked_joints, points_from_keypoints
from hypose.pipeline.mono_stream import MonoStream, working_side

CLICK_SHARE, KEYPOINT_SHARE = 0.010, 0.016
"""1 sd of a click and of a detector's point, as a share of the person's size in the picture."""
FEWEST_PX = 1.0
LENGTH_FRAMES = 10
"""So many further frames with key points decide the lengths of somebody whose body is not known."""

Clicks = Mapping[str, tuple[float, float]]
"""Joints clicked in a recorded picture: name -> (u, v) px."""


def load_clicks(path: str | Path, recording: Recording) -> Clicks:
    """Read a file of clicks for the one camera of a recording; an InputError says what is wrong with it."""
    path = Path(path)
    view = recording.views[0]
    try:
        document = parse_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"The file of clicks {path} cannot be read ({error.strerror}); check --start.") from None
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"The file of clicks {path} is not JSON ({error}); see docs/monocular.md.") from None
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
    with open_video(_source(recording)) as reader:
        size = reader.size
    joints = {name: _click(path, name, at, size) for name, at in document["joints"].items()}
    if len(joints) < LEAST_POINTS:
        raise InputError(f"{path} holds {len(joints)} clicked joints; at least {LEAST_POINTS} are needed to start.")
    return joints


def _click(path: Path, name: str, at: Any, size: tuple[int, int]) -> tuple[float, float]:
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
    """Clicks in the undistorted pixels of the working camera."""
    view, camera = recording.views[0], recording.rig[0]
    with open_video(_source(recording)) as reader:
        stored = np.array(reader.size, dtype=np.float64)
    pixels = np.array(list(clicks.values()))
    calibrated = (pixels + 0.5) * np.array(camera.size) / stored - 0.5 + np.asarray(view.image_shift)
    shown = (camera.undistort_points(calibrated) + 0.5) * np.array(working.size) / np.array(camera.size) - 0.5
    return {name: (float(u), float(v)) for name, (u, v) in zip(clicks, shown, strict=True)}


def side_to_work_on(recording: Recording, clicks: Clicks | None) -> int:
    """Longer side of the working pictures, px, by the size of the person at the start."""
    if clicks is not None:
        with open_video(_source(recording)) as reader:
            return working_side(recording, _extent(np.array(list(clicks.values()))), reader.size)
    points = load_keypoints(recording)
    sizes = [person_size(k.points[0]) for k in (points or [])[: 1 + int(recording.frame_rate)]]
    found = [s for s in sizes if s > 0]
    if points is None or not found:
        return FrameOptions().longer_side
    return working_side(recording, float(np.median(found)), points[0].rig[0].size)


def _extent(pixels: Array) -> float:
    return float(np.ptp(pixels, axis=0).max())


def _source(recording: Recording) -> Path:
    source = recording.views[0].source
    assert source is not None  # mono_stream.one_view saw to it
    return source


def find_start(
    stream: MonoStream,
    *,
    clicks: Clicks | None = None,
    body: Body | None = None,
    height: float | None = None,
    floor: float | None = None,
    settings: MonoSettings | None = None,
) -> tuple[InitialFit, tuple[str, ...]]:
    """The first hypotheses and sentences about them. body: the person's own (then only poses are looked for); floor:
    height of the floor in the world, m, None when it is not known."""
    recording = stream.recording
    template = body or human()
    if clicks is not None:
        at, source = 0, f"{len(clicks)} clicked joints"
        pixels = clicked_pixels(clicks, recording, stream.camera)
        scale = max(FEWEST_PX, CLICK_SHARE * _extent(np.array(list(pixels.values()))))

        def points_on(b: Body) -> MonoPoints:
            return clicked_joints(b, pixels, scale)

    else:
        at, seen, names = _first_keypoints(stream)
        source = f"the key points of frame {recording.frames[at]}"

        def points_on(b: Body) -> MonoPoints:
            return keypoints_on(b, names, seen)

    later = () if body is not None else _later_points(stream, at)
    fit = initialise(
        template,
        stream.camera,
        points_on,
        stream.frame(at),
        later=later,
        settings=settings,
        height=height,
        fixed_body=body is not None,
        floor=floor,
    )
    notes = [f"start from {source}: {len(fit.hypotheses)} rival poses, the best {fit.residual_px:.1f} px off"]
    if body is None:
        further = f", the key points of {len(later)} further frames" if later else ""
        notes.append(f"body of {fit.body.stature:.2f} m from {source}{further} and the picture's contours")
    if floor is not None:
        notes.append(f"the lower foot is taken to stand on a floor at z = {floor:g} m (--floor)")
    if body is not None and height is not None:
        notes.append("the given height is not used: the body is given")
    if body is None and height is None:
        notes.append(
            "the height is not known, so distances and lengths are as uncertain as people's heights (about 5 %); give "
            "--height"
        )
    return fit, tuple(notes)


def keypoints_on(body: Body, names: tuple[str, ...], keypoints: Array) -> MonoPoints:
    """Key points (K, 3) on a body, with the error that detectors have at that size."""
    scale = max(FEWEST_PX, KEYPOINT_SHARE * person_size(keypoints))
    return points_from_keypoints(body, names, keypoints, scale_px=scale)


def _later_points(stream: MonoStream, first: int) -> tuple[PointsOn, ...]:
    """The key points of LENGTH_FRAMES frames over the whole clip, to measure lengths with."""
    points = stream.start_points
    if points is None:
        return ()
    rows = np.unique(np.linspace(first, len(stream) - 1, LENGTH_FRAMES + 1).astype(int))[1:]
    names = points[0].names
    seen = (np.asarray(points[i].points[0]) for i in rows)
    template = human()
    enough = [k for k in seen if (keypoints_on(template, names, k).confidence > 0).sum() >= LEAST_POINTS]
    return tuple(partial(keypoints_on, names=names, keypoints=k) for k in enough)


def _first_keypoints(stream: MonoStream) -> tuple[int, Array, tuple[str, ...]]:
    """The first frame of the first second with enough key points, its points (K, 3) and their names."""
    view = stream.recording.views[0]
    points = stream.start_points
    if points is None:
        raise InputError(
            f"Camera {view.name} has no key points and no clicks were given, so there is nothing to start from; click "
            "joints in the first picture and give --start clicks.json, or add keypoints = ... in recording.toml."
        )
    for i in range(min(len(stream), 1 + int(stream.recording.frame_rate))):
        seen = np.asarray(points[i].points[0])
        if (keypoints_on(human(), points[i].names, seen).confidence > 0).sum() >= LEAST_POINTS:
            return i, seen, points[i].names
    raise EvidenceError(
        f"Camera {view.name}: no frame of the first second has {LEAST_POINTS} confident key points; give --frames to "
        "begin later, or --start clicks.json."
    )
