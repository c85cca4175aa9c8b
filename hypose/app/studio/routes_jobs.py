"""The routes of jobs and uploads, and the WebSocket on which jobs tell how far they are."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Sequence

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from hypose.app.studio.answers import answer, block_answer, body_of, pieces_of, told
from hypose.app.studio.asked import digits
from hypose.app.studio.catalog import Catalog
from hypose.app.studio.jobs import Job, Jobs
from hypose.app.studio.progress_view import block_so_far
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.sockets import Sockets, tell
from hypose.app.studio.uploads import Uploads
from hypose.errors import InputError

_TELL_S = 0.2
_PICTURE_PX = 320


def routes(
    catalog: Catalog, recordings: Recordings, uploads: Uploads, jobs: Jobs, sockets: Sockets
) -> Sequence[BaseRoute]:
    """The routes."""

    async def every(request: Request) -> Response:
        return answer([j.shown() for j in jobs.every()])

    async def start(request: Request) -> Response:
        value = await body_of(request)
        kind = value.get("kind")
        if not isinstance(kind, str):
            raise InputError("Say which kind of job is to be started.")
        return answer((await run_in_threadpool(jobs.start, kind, value)).shown(), 201)

    async def one(request: Request) -> Response:
        return answer(jobs.find(request.path_params["id"]).shown())

    async def cancel(request: Request) -> Response:
        return answer(jobs.cancel(request.path_params["id"]).shown())

    async def resume(request: Request) -> Response:
        return answer(jobs.resume(request.path_params["id"]).shown(), 201)

    async def view(request: Request) -> Response:
        job = jobs.find(request.path_params["id"])
        data = await run_in_threadpool(block_so_far, job.plan, job.began, catalog, recordings)
        if data is None:
            return Response(status_code=204)
        return block_answer(data)

    async def upload(request: Request) -> Response:
        stated = request.headers.get("content-length")
        size = None if stated is None else whole_size(stated)
        path = await uploads.receive(request.path_params["name"], pieces_of(request), size)
        return answer(await run_in_threadpool(uploads.examine, path), 201)

    async def picture(request: Request) -> Response:
        data = await run_in_threadpool(uploads.picture, request.path_params["name"], _PICTURE_PX)
        return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})

    async def forget(request: Request) -> Response:
        await run_in_threadpool(uploads.forget, request.path_params["name"])
        return answer({})

    async def make(request: Request) -> Response:
        folder = await run_in_threadpool(uploads.make_recording, await body_of(request))
        catalog.items("recording", fresh=True)
        item = catalog.find("recording", catalog.id_of("recording", folder))
        return answer(await run_in_threadpool(recordings.shown, item, []), 201)

    async def socket(ws: WebSocket) -> None:
        await sockets.serve(ws, lambda ws: _tell(ws, jobs))

    return [
        Route("/api/jobs", told(every)),
        Route("/api/jobs", told(start), methods=["POST"]),
        Route("/api/jobs/{id}", told(one)),
        Route("/api/jobs/{id}/cancel", told(cancel), methods=["POST"]),
        Route("/api/jobs/{id}/resume", told(resume), methods=["POST"]),
        Route("/api/jobs/{id}/view", told(view)),
        Route("/api/uploads/{name}", told(upload), methods=["PUT"]),
        Route("/api/uploads/{name}", told(forget), methods=["DELETE"]),
        Route("/api/uploads/{name}/picture.jpg", told(picture)),
        Route("/api/recordings", told(make), methods=["POST"]),
        WebSocketRoute("/ws/jobs", socket),
    ]


def whole_size(text: str) -> int:
    """The bytes that a request says it has."""
    return digits(text[-9:], "The length") + 10**9 * (digits(text[:-9], "The length") if len(text) > 9 else 0)


async def _tell(ws: WebSocket, jobs: Jobs) -> None:
    """Every change of a job, but not more often than a screen can show."""
    loop = asyncio.get_running_loop()
    changed: dict[str, Job] = {}
    awake = asyncio.Event()

    def note(job: Job) -> None:
        changed[job.id] = job
        awake.set()

    def heard(job: Job) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(note, job)

    stop = jobs.listen(heard)
    reading = asyncio.ensure_future(_drain(ws))
    states: dict[str, str] = {}
    try:
        await tell(ws, json.dumps({"t": "jobs", "jobs": [j.shown() for j in jobs.every()]}))
        while not reading.done():
            woken = asyncio.ensure_future(awake.wait())
            await asyncio.wait({woken, reading}, return_when=asyncio.FIRST_COMPLETED)
            woken.cancel()
            awake.clear()
            for job in [changed.pop(k) for k in list(changed)]:
                value = job.shown()
                await tell(ws, json.dumps({"t": "job", "job": value}))
                if states.get(job.id) != value["state"] and value["state"] in ("done", "failed", "cancelled"):
                    await tell(ws, json.dumps({"t": "files"}))
                states[job.id] = value["state"]
            await asyncio.wait({reading}, timeout=_TELL_S)
    finally:
        stop()
        reading.cancel()


async def _drain(ws: WebSocket) -> None:
    """The page has nothing to say here; reading notices when it leaves."""
    while (await ws.receive())["type"] != "websocket.disconnect":
        pass
