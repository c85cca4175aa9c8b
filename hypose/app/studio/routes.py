"""The studio's REST interface: what is done at which address (docs/studio-protocol.md)."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route

from hypose.app.reports.summary import DESCRIPTIONS
from hypose.app.studio import clicks
from hypose.app.studio.answers import NotNow, block_answer, choice, digits, jpeg_answer, route, text
from hypose.app.studio.catalog import Catalog, Item, Kind, NotFound, is_recording
from hypose.app.studio.folders import first_picture, listed, make_recording
from hypose.app.studio.gesture_views import gesture_thumbnail
from hypose.app.studio.job_kinds import is_name
from hypose.app.studio.mending import mend
from hypose.errors import HyposeError, InputError

if TYPE_CHECKING:
    from hypose.app.studio.server import Studio

_RECORDING_FILES = ("calibration.png", "check.html", "check.png", "silhouettes/sheet.jpg")
_MASKS = ("none", "edge", "fill", "only")
_UNTRUSTED = (
    "sandbox allow-scripts; default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src "
    "'unsafe-inline'; media-src data: blob:; worker-src blob:"
)
"""For pages that lie in the served folder: they may show themselves, and reach neither the server nor anything else."""
T = TypeVar("T")
Body = dict[str, Any]


def routes(studio: Studio) -> list[Route]:
    """All addresses of a studio."""
    catalog = studio.catalog

    def item_of(kind: Kind, request: Request) -> Item:
        return catalog.find(kind, request.path_params["id"])

    return [
        route("/api/state", lambda request: studio.state()),
        *_of_jobs(studio),
        *_of_recordings(studio, item_of),
        *_of_results(studio, item_of),
        *_of_folders(studio, item_of),
        route(
            "/api/models/{id}/thumbnail.jpg", lambda r: jpeg_answer(gesture_thumbnail(item_of("model", r).path), 600)
        ),
        *_of_clicks(studio, item_of),
    ]


ItemOf = Callable[[Kind, Request], Item]


def _of_folders(studio: Studio, item_of: ItemOf) -> list[Route]:
    """Recordings and results are renamed, and results deleted for good."""
    catalog = studio.catalog

    @contextlib.contextmanager
    def changing(item: Item, what: str) -> Iterator[None]:
        """While the folder of an item is changed no job works on it, and nothing in it is open."""
        if item.path == catalog.root:
            raise InputError(f"{item.path.name} is the folder that is served; change it from outside.")
        if any(studio.jobs.needs(i.id) for i in catalog.every() if i.path.is_relative_to(item.path)):
            raise NotNow(f"A job is at work on {item.path.name}; stop it first.")
        studio.let_go()
        try:
            yield
        except OSError as error:
            raise InputError(f"{item.path.name} cannot be {what} ({(error.strerror or str(error)).lower()}).") from None
        catalog.items(item.kind, fresh=True)

    def delete(request: Request) -> Any:
        item = item_of("result", request)
        if any(i.path != item.path and i.path.is_relative_to(item.path) for i in catalog.every()):
            raise InputError(f"Other recordings or results lie in {item.path.name}; delete it from outside.")
        with changing(item, "deleted"):
            shutil.rmtree(item.path)  # links in it are removed, not followed
        return {"name": item.path.name}

    def rename(kind: Kind, request: Request, body: Body) -> Any:
        item, name = item_of(kind, request), body.get("name")
        if not isinstance(name, str) or not is_name(name):
            raise InputError(f"{str(name)[:40]!r} is no name; use letters, digits, -, _ and dots between.")
        place = item.path.with_name(name)
        if place != item.path and place.exists():
            raise NotNow(f"There is {name} already; choose another name.")
        with changing(item, "renamed"):
            item.path.rename(place)
        return {"id": catalog.id_of(kind, place), "kind": kind, "name": name, "path": catalog.shown(place)}

    return [
        route("/api/recordings/{id}/name", partial(rename, "recording"), "POST"),
        route("/api/results/{id}/name", partial(rename, "result"), "POST"),
        route("/api/results/{id}", delete, "DELETE"),
    ]


def _of_jobs(studio: Studio) -> list[Route]:
    jobs = studio.jobs

    def start(request: Request, body: Body) -> Any:
        return jobs.start(text(body.get("kind"), "kind of job", 40, "say which is to be started"), body).shown()

    def view(request: Request) -> Response:
        job = jobs.find(request.path_params["id"])
        return block_answer(studio.results.so_far(job.plan, job.began, studio.recordings))

    return [
        route("/api/jobs", lambda request: [j.shown() for j in jobs.every()]),
        route("/api/jobs", start, "POST", 201),
        route("/api/jobs/{id}", lambda request: jobs.find(request.path_params["id"]).shown()),
        route("/api/jobs/{id}/cancel", lambda r, _: jobs.cancel(r.path_params["id"]).shown(), "POST"),
        route("/api/jobs/{id}/resume", lambda r, _: jobs.resume(r.path_params["id"]).shown(), "POST", 201),
        route("/api/jobs/{id}/view", view),
    ]


def _of_recordings(studio: Studio, item_of: ItemOf) -> list[Route]:
    catalog, recordings = studio.catalog, studio.recordings

    def one(request: Request) -> Any:
        item = item_of("recording", request)
        mine = [r.id for r in catalog.items("result") if catalog.recording_of(r.path) == item.path]
        return recordings.shown(item, mine)

    def picture(request: Request) -> Response:
        query = {k: v for k, v in request.query_params.items() if k != "token"}
        frame, width = digits(request.path_params["frame"], "The frame"), digits(query.pop("width", "640"), "The width")
        mask = choice(query.pop("mask", "none"), "way to show a mask", _MASKS)
        item = item_of("recording", request)
        return jpeg_answer(recordings.picture(item, request.path_params["camera"], frame, width, mask, query), 60)

    def file(request: Request) -> Response:
        folder = item_of("recording", request).path / "results"
        return _file(folder, request.path_params["name"], _RECORDING_FILES, catalog)

    def settings(request: Request, body: Body) -> Any:
        return recordings.save_settings(item_of("recording", request), body)

    def mended(request: Request, body: Body) -> Any:
        item = item_of("recording", request)
        try:
            recording = recordings.load(item)
        except HyposeError:
            recording = None
        mend(item.path, recording, body, catalog)
        return one(request)

    def folder(request: Request) -> Any:
        query = request.query_params
        if "recording" in query:
            return listed(catalog, catalog.find("recording", query["recording"]).path, True)
        where = catalog.inside(query.get("path", ""))
        return listed(catalog, where, "within" in query and not is_recording(where))

    def first(request: Request) -> Response:
        return jpeg_answer(first_picture(catalog, request.query_params.get("path", "")), 60)

    def make(request: Request, body: Body) -> Any:
        made = make_recording(catalog, body)
        catalog.items("recording", fresh=True)
        return recordings.shown(catalog.find("recording", catalog.id_of("recording", made)), [])

    return [
        route("/api/folder", folder),
        route("/api/folder/picture.jpg", first),
        route("/api/recordings", make, "POST", 201),
        route("/api/recordings/{id}", one),
        route("/api/recordings/{id}/mend", mended, "POST"),
        route("/api/recordings/{id}/image/{camera}/{frame}.jpg", picture),
        route("/api/recordings/{id}/file/{name:path}", file),
        route("/api/recordings/{id}/mask-settings", settings, "POST"),
    ]


def _of_results(studio: Studio, item_of: ItemOf) -> list[Route]:
    catalog, results = studio.catalog, studio.results
    blocks, gaits = asyncio.Lock(), asyncio.Lock()  # of what takes long one at a time is made

    async def in_turn(turn: asyncio.Lock, request: Request, make: Callable[[Item], T]) -> T | None:
        """None: it was looked at only briefly, and nobody waits for it any more."""
        item = item_of("result", request)
        async with turn:
            return None if await request.is_disconnected() else await run_in_threadpool(make, item)

    async def view(request: Request) -> Response:
        return block_answer(await in_turn(blocks, request, results.block))

    async def gait(request: Request) -> Response:
        data = await in_turn(gaits, request, results.gait)
        return Response(data or b"null", media_type="application/json", headers={"Cache-Control": "no-store"})

    def row_of(request: Request) -> int:
        return digits(request.path_params["row"], "The row")

    def pictures(request: Request) -> Response:
        width = digits(request.query_params.get("width", "640"), "The width")
        with results.pictures(item_of("result", request)) as opened:
            data = opened.row(row_of(request), width)
        # the same row of the same result stays what it is while a page is open
        return Response(data, media_type="application/octet-stream", headers={"Cache-Control": "private, max-age=60"})

    def outlines(request: Request) -> Any:
        with results.pictures(item_of("result", request)) as opened:
            return {"views": opened.outlines(row_of(request))}

    def small(request: Request) -> Response:
        return jpeg_answer(results.thumbnail(item_of("result", request)), 600)

    def file(request: Request) -> Response:
        return _file(item_of("result", request).path, request.path_params["name"], DESCRIPTIONS, catalog)

    def export(request: Request, body: Body) -> Any:
        item = item_of("result", request)
        return studio.jobs.start("export", {"result": item.id, "options": {"formats": body.get("formats")}}).shown()

    return [
        route("/api/results", lambda request: [results.head(i) for i in catalog.items("result")]),
        route("/api/results/{id}/view", view),
        route("/api/results/{id}/pictures/{row}", pictures),
        route("/api/results/{id}/outlines/{row}", outlines),
        route("/api/results/{id}/thumbnail.jpg", small),
        route("/api/results/{id}/files/{name}", file),
        route("/api/results/{id}/gait", gait),
        route("/api/results/{id}/export", export, "POST", 201),
    ]


def _of_clicks(studio: Studio, item_of: ItemOf) -> list[Route]:
    catalog, recordings = studio.catalog, studio.recordings

    def body(request: Request) -> Response:
        return block_answer(clicks.body_block(dict(request.query_params), catalog, recordings))

    def save(request: Request, body: Body) -> Any:
        return clicks.save(body, item_of("recording", request), catalog, recordings)

    def one(request: Request) -> Any:
        return clicks.load(item_of("recording", request), request.path_params["name"])

    return [
        route("/api/click-joints", lambda _: [{"joint": k, "title": v} for k, v in clicks.CLICK_JOINTS.items()]),
        route("/api/click-body", body),
        route("/api/fit-clicks", lambda request, body: clicks.fitted(body, catalog, recordings), "POST"),
        route("/api/recordings/{id}/starts", save, "POST", 201),
        route("/api/recordings/{id}/starts/{name}", one),
    ]


def _file(folder: Path, name: str, known: Any, catalog: Catalog) -> Response:
    """A file of a folder that may be given away by its name."""
    path = folder / name
    if name not in known or not path.is_file() or not catalog.contains(path):
        raise NotFound(f"There is no file {name[:80]!r} here.")
    headers = {"Content-Security-Policy": _UNTRUSTED, "Cache-Control": "no-store"}
    shown = path.suffix in (".html", ".png", ".jpg", ".mp4")
    return FileResponse(path, headers=headers, filename=None if shown else path.name)
