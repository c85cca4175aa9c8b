"""The studio's server: build the application with all addresses, and run it for `hypose view`."""

from __future__ import annotations

import contextlib
import io
import shutil
import socket
import threading
import zipfile
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles

from hypose import __version__
from hypose.app.live.servers import listen_error, quiet_logs, token_for
from hypose.app.reports.calibration_pages import printed_board
from hypose.app.reports.report_parts import DESCRIPTIONS, OPENSIM_FILES
from hypose.app.studio import clicks
from hypose.app.studio.catalog import Catalog, Item, Kind, NotFound, is_recording
from hypose.app.studio.gesture_session import (
    GestureTopic,
    gesture_thumbnail,
    models_shown,
    sources_shown,
)
from hypose.app.studio.http import (
    MAX_MESSAGE,
    Guard,
    NotNow,
    data_answer,
    digits,
    error_response,
    request_choice,
    route,
    serve_topics,
)
from hypose.app.studio.job_kinds import forms, fused_in
from hypose.app.studio.jobs import Jobs
from hypose.app.studio.live_topics import CameraTopic, FuseTopic
from hypose.app.studio.recordings import (
    Recordings,
    edit_recording,
    first_picture,
    list_folder,
    make_recording,
    tick_findings,
)
from hypose.app.studio.results import Results
from hypose.body.default_body import human
from hypose.errors import HyposeError, InputError

STATIC_FOLDER = Path(__file__).parent / "static"
"""Folder of the built page."""
MOST_CONNECTIONS = 256


class Studio:
    """State of a server: the catalog, jobs, topics and open files; `app` is the ASGI application.

    root: folder that is served.
    host: address of this computer on which it is served.
    token: secret that pages must show; None: one is made where other computers can connect.
    """

    def __init__(self, root: Path, host: str = "127.0.0.1", token: str | None = None) -> None:
        self.token: str = token_for(host, token)
        self.catalog: Catalog = Catalog(root)
        self.jobs: Jobs = Jobs(self.catalog)
        self.recordings: Recordings = Recordings(self.catalog)
        self.results: Results = Results(self.catalog, self.recordings)
        self.gestures: GestureTopic = GestureTopic(self.catalog)
        self.fusion, self.cameras = FuseTopic(self.catalog), CameraTopic(self.catalog)
        topics = {t.name: t for t in (self.jobs, self.gestures, self.fusion, self.cameras)}
        sockets = WebSocketRoute("/ws/{topic}", partial(serve_topics, topics))
        files = [Mount("/static", StaticFiles(directory=STATIC_FOLDER))] if STATIC_FOLDER.is_dir() else []
        self._routed = Starlette(
            routes=[route("/", _page), *routes(self), sockets, *files],
            lifespan=self._lifespan,
            exception_handlers={
                404: lambda request, error: error_response(404, "There is nothing at this address."),
                Exception: lambda request, error: error_response(
                    500, f"This should not have happened ({type(error).__name__}); the server's terminal says more."
                ),
            },
        )
        self.app: Guard = Guard(self._routed, self.token)

    def state(self) -> dict[str, Any]:
        """Return all recordings, results and other items for the page's lists."""
        catalog = self.catalog
        found = [self.results.head(i) for i in catalog.items("result", fresh=True)]
        return {
            "version": __version__,
            "root": catalog.root.name,
            "recordings": [
                {
                    "id": i.id,
                    "name": i.path.name,
                    "path": catalog.shown(i.path),
                    "results": [r["id"] for r in found if r["recording"] == i.id],
                }
                for i in catalog.items("recording")
            ],
            "results": found,
            "models": models_shown(catalog),
            "sources": sources_shown(catalog),
            "skeletons": [
                {
                    "id": i.id,
                    "name": i.path.name,
                    "path": catalog.shown(i.path),
                    "result": catalog.id_of("result", out) if (out / "motion.npz").is_file() else None,
                }
                for i in catalog.items("skeletons")
                for out in [fused_in(i.path)]
            ],
            "jobs": [j.shown() for j in self.jobs.every()],
        }

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """Compile kernels while the server starts; stop all topics and jobs when it ends."""
        warm = threading.Thread(target=_warm, name="warm", daemon=True)
        warm.start()
        yield
        await self.fusion.stop()
        await self.cameras.stop()
        await self.jobs.close()
        await run_in_threadpool(self.gestures.close)
        self.recordings.close()


def _warm() -> None:
    """Compile the kernels that a result needs, before a page waits for them."""
    skeleton = human().skeleton
    skeleton.forward(np.zeros((1, skeleton.dof)))


def _page(request: Request) -> Response:
    if not (STATIC_FOLDER / "index.html").is_file():
        return Response(NOT_BUILT + "\n", 503, media_type="text/plain")
    return FileResponse(STATIC_FOLDER / "index.html", headers={"Cache-Control": "no-store"})


NOT_BUILT = (
    "The studio's page is not part of this installation: it could not be built when hypose was installed. Install "
    "hypose from a wheel, or build the page with `python hatch_build.py` in the sources (it needs the network once)."
)


def make_server(studio: Studio) -> uvicorn.Server:
    """Make a server that is not running yet: limited connections, small messages, no compression (pictures are
    compressed), no server name, and no trust in proxy headers.

    Returns: the server. Its run(sockets=[...]) serves on sockets of `open_port`, and `should_exit` ends it.
    """
    made = uvicorn.Config(
        studio.app,
        http="h11",
        limit_concurrency=MOST_CONNECTIONS,
        timeout_keep_alive=20,
        proxy_headers=False,
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=MAX_MESSAGE,
        ws_per_message_deflate=False,
        ws_max_queue=32,
        ws_ping_timeout=60,  # a page on a busy computer may not answer for long
        timeout_graceful_shutdown=2,
    )
    quiet_logs()
    return uvicorn.Server(made)


def open_port(host: str, port: int) -> socket.socket:
    """Open a port on which clients can connect already; they are answered as soon as a server runs.

    host: address of this computer.
    port: 0: any free one.
    Raises: InputError where the port cannot be used.
    """
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except (OSError, OverflowError) as error:
        raise InputError(
            f"Port {port} on {host} cannot be used ({listen_error(error)}); choose another with --port, 0 takes any "
            "free one."
        ) from None


def run_server(root: Path, host: str, port: int, token: str | None, ready: Callable[[str], None]) -> None:
    """Serve until Ctrl-C or SIGTERM; ready(address) is called when the page can be opened.

    root: folder that is served.
    host: address of this computer on which it is served.
    token: secret that pages must show; None: one is made where other computers can connect.
    port: 0: any free one.
    Raises: InputError where the port cannot be used.
    """
    opened = open_port(host, port)
    studio = Studio(root, host, token)
    query = f"?token={quote(studio.token)}" if studio.token else ""
    host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, host)
    ready(f"http://{host}:{opened.getsockname()[1]}/{query}")
    with contextlib.suppress(KeyboardInterrupt):
        make_server(studio).run(sockets=[opened])


_RECORDING_FILES = ("calibration.png", "check.html", "check.png", "silhouettes/sheet.jpg")
_JPEG = "image/jpeg"
_MASKS = ("none", "edge", "fill", "only")
_UNTRUSTED = (
    "sandbox allow-scripts; default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src "
    "'unsafe-inline'; media-src data: blob:; worker-src blob:"
)
"""Content security policy of pages from the served folder: they can show themselves, but reach neither the server nor
anything else.
"""
_Body = dict[str, Any]


def routes(studio: Studio) -> list[Route]:
    """Build all routes of a studio."""
    return [
        route("/api/state", lambda request: studio.state()),
        *_of_jobs(studio.jobs, studio.results),
        *_of_recordings(studio),
        *_of_results(studio),
        *_of_clicks(studio),
    ]


def _of(
    catalog: Catalog, kind: Kind, path: str, call: Callable[..., Any], method: str = "GET", status: int = 200
) -> Route:
    """Make the route of an item, /api/KINDs/ID and then `path`; call gets the item first, then as for `route`."""

    def found(request: Request, *body: _Body) -> Any:
        return call(catalog.find(kind, request.path_params["id"]), request, *body)

    return route(f"/api/{kind}s/{{id}}{path}", found, method, status)


def _of_jobs(jobs: Jobs, results: Results) -> list[Route]:
    """Build the routes that list, start, stop, resume and show jobs."""

    def view(request: Request) -> Response:
        job = jobs.find(request.path_params["id"])
        return data_answer(results.so_far(job.plan, job.began))

    return [
        route("/api/jobs", lambda request: [j.shown() for j in jobs.every()]),
        route("/api/jobs", lambda request, body: jobs.start(body.get("kind"), body), "POST", 201),
        route("/api/job-forms", lambda request: forms()),
        route("/api/jobs/{id}", lambda request: jobs.find(request.path_params["id"]).shown()),
        route("/api/jobs/{id}/cancel", lambda request, _: jobs.cancel(request.path_params["id"]), "POST"),
        route("/api/jobs/{id}/resume", lambda request, _: jobs.resume(request.path_params["id"]), "POST", 201),
        route("/api/jobs/{id}/view", view),
    ]


def _of_recordings(studio: Studio) -> list[Route]:
    """Build the routes of recordings and folders."""
    catalog, recordings = studio.catalog, studio.recordings

    def one(item: Item, _: Request) -> Any:
        mine = [r.id for r in catalog.items("result") if catalog.recording_of(r.path) == item.path]
        return recordings.shown(item, mine)

    def picture(item: Item, request: Request) -> Response:
        query, wanted = request.query_params, request.path_params
        width = digits(query.get("width", "640"), "The width")
        mask = request_choice(query.get("mask", "none"), "way to show a mask", _MASKS)
        data = recordings.picture(item, wanted["camera"], wanted["frame"], width, mask, query.get("settings"))
        return data_answer(data, _JPEG, 60)

    def edited(item: Item, request: Request, body: _Body) -> Any:
        recording = None
        with contextlib.suppress(HyposeError):
            recording = recordings.load(item)
        edit_recording(item.path, recording, body, catalog)
        tick_findings(item.path, body.get("findings", []))
        return one(item, request)

    def folder(request: Request) -> Any:
        query = request.query_params
        if "recording" in query:
            return list_folder(catalog, catalog.find("recording", query["recording"]).path, True)
        where = catalog.inside(query.get("path", ""))
        return list_folder(catalog, where, "within" in query and not is_recording(where))

    def make(request: Request, body: _Body) -> Any:
        made = make_recording(catalog, body)
        catalog.items("recording", fresh=True)
        return recordings.shown(catalog.find("recording", catalog.id_of("recording", made)), [])

    def board(request: Request) -> Response:
        headers = {"Content-Disposition": 'inline; filename="hypose-board.pdf"'}
        sheet = printed_board(request.query_params.get("paper", "a4"))
        return Response(sheet, media_type="application/pdf", headers=headers)

    def file(item: Item, request: Request) -> Response:
        return _file(item.path / "results", request.path_params["name"], _RECORDING_FILES, catalog)

    return [
        route("/api/board.pdf", board),
        route("/api/folder", folder),
        route(
            "/api/folder/picture.jpg",
            lambda request: data_answer(first_picture(catalog, request.query_params.get("path", "")), _JPEG, 60),
        ),
        route("/api/recordings", make, "POST", 201),
        _of(catalog, "recording", "", one),
        _of(catalog, "recording", "/repair", edited, "POST"),
        _of(catalog, "recording", "/image/{camera}/{frame:int}.jpg", picture),
        _of(catalog, "recording", "/file/{name:path}", file),
        _of(
            catalog,
            "recording",
            "/mask-settings",
            lambda item, _, body: recordings.save_settings(item, body),
            "POST",
        ),
    ]


def _of_results(studio: Studio) -> list[Route]:
    """Build the routes of results and gesture models."""
    catalog, results = studio.catalog, studio.results

    def pictures(item: Item, request: Request) -> Response:
        width = digits(request.query_params.get("width", "640"), "The width")
        # a row of a result does not change while a page is open
        return data_answer(results.pictures(item).row(request.path_params["row"], width), seconds=60)

    def outlines(item: Item, request: Request) -> Any:
        return {"views": results.pictures(item).outlines(request.path_params["row"])}

    def opensim(item: Item, _: Request) -> Response:
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in OPENSIM_FILES:
                if (path := item.path / name).is_file() and catalog.contains(path):
                    archive.write(path, name)
        headers = {"Content-Disposition": 'attachment; filename="opensim.zip"'}
        return Response(packed.getvalue(), media_type="application/zip", headers=headers)

    def delete(item: Item, _: Request) -> Any:
        inside = [i for i in catalog.items() if i.path != item.path and i.path.is_relative_to(item.path)]
        if inside or item.path == catalog.root:
            raise InputError(f"{item.path.name} is served itself, or others lie in it; delete it from outside.")
        if studio.jobs.needs(item.id):
            raise NotNow(f"A job is at work on {item.path.name}; stop it first.")
        studio.recordings.close()  # some systems cannot delete open files
        try:
            shutil.rmtree(item.path)  # links in it are removed, not followed
        except OSError as error:
            raise InputError(
                f"{item.path.name} cannot be deleted ({(error.strerror or str(error)).lower()})."
            ) from None
        catalog.items("result", fresh=True)
        return {"name": item.path.name}

    def file(item: Item, request: Request) -> Response:
        return _file(item.path, request.path_params["name"], DESCRIPTIONS, catalog)

    return [
        route("/api/results", lambda request: [results.head(i) for i in catalog.items("result")]),
        _of(catalog, "result", "", delete, "DELETE"),
        _of(catalog, "result", "/view", lambda item, _: data_answer(results.block(item))),
        _of(catalog, "result", "/pictures/{row:int}", pictures),
        _of(catalog, "result", "/outlines/{row:int}", outlines),
        _of(catalog, "result", "/thumbnail.jpg", lambda item, _: data_answer(results.thumbnail(item), _JPEG, 600)),
        _of(catalog, "result", "/files/{name}", file),
        _of(catalog, "result", "/opensim.zip", opensim),
        _of(catalog, "result", "/gait", lambda item, _: results.gait(item)),
        _of(catalog, "model", "/thumbnail.jpg", lambda item, _: data_answer(gesture_thumbnail(item.path), _JPEG, 600)),
    ]


def _of_clicks(studio: Studio) -> list[Route]:
    """Build the routes of clicked joints."""
    catalog, recordings = studio.catalog, studio.recordings

    def body(request: Request) -> Response:
        return data_answer(clicks.body_block(dict(request.query_params), catalog, recordings))

    def save(item: Item, _: Request, body: _Body) -> Any:
        return clicks.save(body, item, catalog, recordings)

    def one(item: Item, request: Request) -> Any:
        return clicks.read_clicks(item, request.path_params["name"])

    return [
        route("/api/click-joints", lambda _: [{"joint": k, "title": v} for k, v in clicks.CLICK_JOINTS.items()]),
        route("/api/click-body", body),
        route("/api/fit-clicks", lambda request, body: clicks.fit_clicks(body, catalog, recordings), "POST"),
        _of(catalog, "recording", "/starts", save, "POST", 201),
        _of(catalog, "recording", "/starts/{name}", one),
    ]


def _file(folder: Path, name: str, known: Any, catalog: Catalog) -> Response:
    """Return the answer with a file of a folder, if its name is one of the known ones."""
    path = folder / name
    if name not in known or not path.is_file() or not catalog.contains(path):
        raise NotFound(f"There is no file {name[:80]!r} here.")
    headers = {"Content-Security-Policy": _UNTRUSTED, "Cache-Control": "no-store"}
    shown = path.suffix in (".html", ".png", ".jpg", ".mp4")
    return FileResponse(path, headers=headers, filename=None if shown else path.name)
