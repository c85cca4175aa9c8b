"""The small picture of a gesture in a list: the hand as the depth camera saw it, from a session that taught it."""

from __future__ import annotations

from pathlib import Path

import cv2
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from hypose.app.studio.answers import told
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.gesture_pictures import coloured
from hypose.gestures.depth_pictures import surface_depth
from hypose.pipeline.gesture_files import load_model, read_recording

_SIZE = 96
"""px, width and height."""
_HALF_M = 0.22
"""Half side of what is shown, at the surface where the gesture is done."""
_QUALITY = 82


def gesture_thumbnail(model: Path) -> bytes | None:
    """A JPEG of the frame in the middle of those from which a model learned its gesture last; None where no session
    that taught it lies beside the model."""
    learned = load_model(model)
    for entry in reversed(learned.history):
        folder = model.parent / Path(str(entry.get("session", ""))).name  # beside it, whatever the model says
        if folder == model.parent or not (folder / "session.json").is_file():
            continue
        recording = read_recording(folder)
        shown = [f for f in recording.learned() if f.gesture and recording.gestures[f.gesture - 1] in learned.names]
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


def routes(catalog: Catalog) -> list[Route]:
    """The picture of a model."""

    async def small(request: Request) -> Response:
        item = catalog.find("model", request.path_params["id"])
        data = await run_in_threadpool(gesture_thumbnail, item.path)
        if data is None:
            return Response(status_code=204)
        return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=600"})

    return [Route("/api/models/{id}/thumbnail.jpg", told(small))]
