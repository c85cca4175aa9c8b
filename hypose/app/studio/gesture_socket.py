"""What the server tells of gestures: the lists of sessions, models and sources, and the WebSocket of the trainer."""

from __future__ import annotations

import importlib.util
from functools import lru_cache
from pathlib import Path
from typing import Any

from starlette.routing import BaseRoute, WebSocketRoute
from starlette.websockets import WebSocket

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.gesture_room import GestureRoom, Places
from hypose.app.studio.outlet import SocketOutlet
from hypose.app.studio.sockets import Sockets
from hypose.errors import HyposeError
from hypose.io.files import read_bytes, read_json
from hypose.pipeline.gesture_files import load_model
from hypose.synthetic.gesture_people import load_people
from hypose.synthetic.gesture_poses import GESTURES

FOLDER = "gestures"
"""Where sessions and models go, in the served folder."""
_MOST_BYTES = 64 << 20
"""Of a session's frames.csv."""


def places(catalog: Catalog) -> Places:
    """Where the trainer finds and puts files."""
    return Places(
        catalog.root / FOLDER,
        lambda id: catalog.find("model", id).path,
        lambda id: catalog.find("session", id).path,
        lambda path: catalog.id_of("model" if path.suffix == ".npz" else "session", path),
    )


def routes(room: GestureRoom, sockets: Sockets) -> list[BaseRoute]:
    """The WebSocket."""

    async def talk(ws: WebSocket) -> None:
        outlet = SocketOutlet(ws)
        room.join(outlet)
        try:
            await outlet.talk(room.handle)
        finally:
            room.leave(outlet)

    async def socket(ws: WebSocket) -> None:
        await sockets.serve(ws, talk)

    return [WebSocketRoute("/ws/gesture", socket)]


def sessions_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """The recorded sessions, for a list: read briefly, without their pictures."""
    out = []
    for item in catalog.items("session"):
        gestures, frames = _brief(item.path)
        shown = {"id": item.id, "name": item.path.name, "path": catalog.shown(item.path)}
        out.append({**shown, "gesture": ", ".join(gestures), "frames": frames})
    return out


def models_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """The models that can be used, for a list."""
    out = []
    for item in catalog.items("model"):
        facts = _facts_of_model(item.path, item.changed)
        if facts is not None:
            shown = {"id": item.id, "name": item.path.stem, "path": catalog.shown(item.path)}
            out.append({**shown, **facts})
    return out


@lru_cache(maxsize=512)
def _facts_of_model(path: Path, changed: float) -> dict[str, Any] | None:
    """What a list says of a model as it was changed last; None where it cannot be used."""
    try:
        model = load_model(path)
    except HyposeError:
        return None
    return {"gestures": model.names, "growing": model.learner is not None, "thresholds": model.thresholds}


def sources_shown(catalog: Catalog) -> list[dict[str, Any]]:
    """Where depth can come from; with "missing" when it cannot just now."""
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
    """Names of the gestures and number of frames of a session."""
    try:
        names = read_json(folder / "session.json", "a session.json").get("gestures")
        frames = read_bytes(folder / "frames.csv", "a frames.csv", _MOST_BYTES).count(b"\n") - 1
    except (HyposeError, AttributeError):
        return [], 0
    return [str(n) for n in names] if isinstance(names, list) else [], max(0, frames)
