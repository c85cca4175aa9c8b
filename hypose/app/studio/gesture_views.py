"""Prepare gestures for the page: pictures of depth and votes, and lists of sessions, models and sources."""

from __future__ import annotations

import importlib.util
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.app.studio.catalog import Catalog, Item
from hypose.compute.forests import DepthImage
from hypose.errors import HyposeError
from hypose.gestures.depth_pictures import surface_depth
from hypose.io.files import read_bytes, read_json
from hypose.pipeline.gesture_files import load_model, read_recording
from hypose.synthetic.gesture_people import GESTURES, load_people

_MOST_BYTES = 64 << 20
"""Largest frames.csv of a session that is read, bytes."""
_SIZE, _QUALITY = 96, 82
"""Width and height of the thumbnail, px, and its JPEG quality."""
_HALF_M = 0.22
"""Half side of the shown square at the surface where the gesture is done, m."""
_NEAREST_MM, _FARTHEST_MM = 500, 4200
"""Range of the colours, mm; nearer and farther depths have the colour of the end."""
_JPEG_QUALITY = 75
_FARTHEST_LEVEL = 40
"""Level of the farthest depth in the colour map, of 255; level 0, black, shows holes."""


def depth_jpeg(depth: DepthImage) -> bytes:
    """Encode a depth picture (h, w) uint16 mm as a coloured JPEG."""
    return cv2.imencode(".jpg", coloured(depth), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def coloured(depth: DepthImage) -> NDArray[np.uint8]:
    """Convert a depth picture (h, w) uint16 mm to colours (h, w, 3) BGR; holes are dark."""
    return cv2.applyColorMap(np.take(_levels(), depth), cv2.COLORMAP_INFERNO)  # type: ignore[return-value] - uint8, as it says


def map_png(density: NDArray[np.float32], full: float) -> bytes:
    """Encode a map of voting surface (rows, columns) as PNG; alpha is the share of `full`, the density
    shown as opaque.
    """
    alpha = np.clip(density * (255 / max(full, 1e-12)), 0, 255).astype(np.uint8)
    image = np.empty((*alpha.shape, 4), np.uint8)
    image[..., :3] = (60, 90, 255)
    image[..., 3] = alpha
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


@cache
def _levels() -> NDArray[np.uint8]:
    """Return the level of each depth in mm in the colour map: 0 = hole, else the brighter the nearer."""
    far = np.clip((np.arange(1 << 16) - _NEAREST_MM) / (_FARTHEST_MM - _NEAREST_MM), 0, 1)
    level = np.rint(255 - (255 - _FARTHEST_LEVEL) * far).astype(np.uint8)
    level[0] = 0
    return level


def sessions_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """List the recorded gesture sessions for the page, as JSON values, without reading their pictures."""
    return [
        {**_named(item, item.path.name, catalog), "gesture": ", ".join(gestures), "frames": frames}
        for item in catalog.items("session")
        for gestures, frames in [_brief(item.path)]
    ]


def models_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """List the usable gesture models for the page, as JSON values."""
    found = [(item, _facts_of_model(item.path, item.changed)) for item in catalog.items("model")]
    return [{**_named(item, item.path.stem, catalog), **facts} for item, facts in found if facts is not None]


def _named(item: Item, name: str, catalog: Catalog) -> dict[str, Any]:
    """Return id, name and path of an item for a list."""
    return {"id": item.id, "name": name, "path": catalog.shown(item.path)}


@lru_cache(maxsize=512)
def _facts_of_model(path: Path, changed: float) -> dict[str, Any] | None:
    """Describe a model for the list; None where it cannot be used. changed: time of its last change, for the cache."""
    try:
        model = load_model(path)
    except HyposeError:
        return None
    return {"gestures": [model.name], "growing": True, "thresholds": [model.threshold]}


def sources_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """List the sources of depth pictures for the page, as JSON values; a source that is not available has the key
    "missing".
    """
    people = [
        {"value": f"simulated:{n}", "title": f"Simulated person {n + 1}", "gestures": GESTURES}
        for n in range(len(load_people()))
    ]
    recorded = [
        {"value": f"session:{item.id}", "title": f"Recorded session {item.path.name}", "gestures": _brief(item.path)[0]}
        for item in catalog.items("session")
    ]
    camera: dict[str, Any] = {"value": "realsense", "title": "RealSense camera"}
    if importlib.util.find_spec("pyrealsense2") is None:
        camera["missing"] = "The driver is not installed: pip install 'hypose[realsense]'."
    return [*people, *recorded, camera]


def _brief(folder: Path) -> tuple[list[str], int]:
    """Read the names of the gestures and the number of frames of a session."""
    try:
        names = read_json(folder / "session.json", "a session.json").get("gestures")
        frames = read_bytes(folder / "frames.csv", "a frames.csv", _MOST_BYTES).count(b"\n") - 1
    except (HyposeError, AttributeError):
        return [], 0
    return [str(n) for n in names] if isinstance(names, list) else [], max(0, frames)


def gesture_thumbnail(model: Path) -> bytes | None:
    """Return a JPEG thumbnail of a gesture: the middle one of the frames that a training session learned the gesture
    from.

    model: path of the model file; its sessions are searched in the same folder, the latest first.
    Returns: None where no session or frame is found.
    """
    learned = load_model(model)
    for entry in reversed(learned.history):
        folder = (
            model.parent / Path(str(entry.get("session", ""))).name
        )  # only its name is used, so that the folder lies next to the model
        if folder == model.parent or not (folder / "session.json").is_file():
            continue
        recording = read_recording(folder)
        shown = [f for f in recording.learned() if f.gesture and recording.gestures[f.gesture - 1] == learned.name]
        if not shown:
            continue
        frame = shown[len(shown) // 2]
        depth = frame.depth()
        z = surface_depth(depth, frame.x, frame.y)
        half = _HALF_M * recording.lens.fx / (2.0 if z is None else z / 1000)
        scale = _SIZE / (2 * half)
        cut = cv2.getRotationMatrix2D((frame.x, frame.y), 0, scale)
        cut[:, 2] += _SIZE / 2 - frame.x, _SIZE / 2 - frame.y
        small = cv2.warpAffine(coloured(depth), cut, (_SIZE, _SIZE), flags=cv2.INTER_AREA)
        return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
    return None
