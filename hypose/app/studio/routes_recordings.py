"""The routes below /api/recordings: looking at recordings, and changing how their masks are made."""

from __future__ import annotations

from typing import cast

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from hypose.app.studio.answers import answer, body_of, told
from hypose.app.studio.asked import digits
from hypose.app.studio.catalog import Catalog, Item, NotFound
from hypose.app.studio.mending import mend
from hypose.app.studio.recordings import Recordings, Shown
from hypose.app.studio.uploads import Uploads
from hypose.app.studio.view_answers import file_answer
from hypose.errors import HyposeError, InputError

_FILES = ("calibration.png", "check.html", "check.png", "silhouettes/sheet.jpg")
_SHOWN = ("none", "edge", "fill", "only")


def routes(catalog: Catalog, recordings: Recordings, uploads: Uploads) -> list[Route]:
    """The routes."""

    def item_of(request: Request) -> Item:
        return catalog.find("recording", request.path_params["id"])

    async def one(request: Request) -> Response:
        item = item_of(request)
        mine = [r.id for r in catalog.items("result") if catalog.recording_of(r.path) == item.path]
        return answer(await run_in_threadpool(recordings.shown, item, mine))

    async def picture(request: Request) -> Response:
        item, query = item_of(request), dict(request.query_params)
        query.pop("token", None)
        frame = digits(request.path_params["frame"], "The frame")
        width = digits(query.pop("width", "640"), "The width")
        shown = query.pop("mask", "none")
        if shown not in _SHOWN:
            raise InputError(f"A mask cannot be shown as {shown[:20]!r}; choose {', '.join(_SHOWN)}.")
        camera = request.path_params["camera"]
        data = await run_in_threadpool(recordings.picture, item, camera, frame, width, cast(Shown, shown), query)
        return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=60"})

    async def file(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in _FILES:
            raise NotFound(f"A recording has no file {name[:80]!r} to show.")
        return file_answer(item_of(request).path / "results", name, catalog)

    async def settings(request: Request) -> Response:
        item, value = item_of(request), await body_of(request)
        return answer(await run_in_threadpool(recordings.save_settings, item, value))

    async def mended(request: Request) -> Response:
        item, value = item_of(request), await body_of(request)

        def change() -> None:
            try:
                recording = recordings.load(item)
            except HyposeError:
                recording = None
            mend(item.path, recording, value, uploads)

        await run_in_threadpool(change)
        return await one(request)

    return [
        Route("/api/recordings/{id}/mend", told(mended), methods=["POST"]),
        Route("/api/recordings/{id}", told(one)),
        Route("/api/recordings/{id}/image/{camera}/{frame}.jpg", told(picture)),
        Route("/api/recordings/{id}/file/{name:path}", told(file)),
        Route("/api/recordings/{id}/mask-settings", told(settings), methods=["POST"]),
    ]
