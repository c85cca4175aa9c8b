"""The studio's server: everything put together, and `hypose view`'s main loop."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles

from hypose import __version__
from hypose.app.live.servers import quiet_logs
from hypose.app.studio.answers import refusal
from hypose.app.studio.catalog import Catalog, Item
from hypose.app.studio.gesture_session import GestureTopic
from hypose.app.studio.gesture_views import models_shown, sessions_shown, sources_shown
from hypose.app.studio.guard import Guard, token_for
from hypose.app.studio.hub import MAX_MESSAGE, Hub
from hypose.app.studio.job_kinds import fused_in
from hypose.app.studio.jobs import Jobs
from hypose.app.studio.live_topics import CameraTopic, FuseTopic
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.results import Results
from hypose.app.studio.routes import routes
from hypose.body.ready_bodies import human
from hypose.errors import InputError

STATIC = Path(__file__).parent / "static"
"""Where the built page lies."""
MOST_CONNECTIONS = 256


@dataclass(frozen=True)
class StudioOptions:
    """root: the folder that is served; host, port (0 = any free one); token: None = made when others can reach the
    host."""

    root: Path
    host: str = "127.0.0.1"
    port: int = 8765
    token: str | None = None


class Studio:
    """What a server holds: the catalog and everything that is open. `app` is the ASGI application."""

    def __init__(self, options: StudioOptions) -> None:
        self.token = token_for(options.host, options.token)
        self.catalog = Catalog(options.root)
        self.hub = Hub()
        self.jobs = Jobs(self.catalog, self.hub)
        self.results, self.recordings = Results(self.catalog), Recordings(self.catalog)
        self.gestures = GestureTopic(self.hub, self.catalog)
        self.fusion, self.cameras = FuseTopic(self.hub, self.catalog), CameraTopic(self.hub, self.catalog)
        for topic in (self.jobs, self.gestures, self.fusion, self.cameras):
            self.hub.add(topic)
        self._routed = Starlette(
            routes=[Route("/", _page), *routes(self), WebSocketRoute("/ws/{topic}", self.hub.serve), *_static()],
            lifespan=self._lifespan,
            exception_handlers={Exception: _bug, 404: _nothing},
        )
        self.app = Guard(self._routed, self.token)

    def state(self) -> dict[str, Any]:
        """Everything there is, for the page's lists."""
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
            "sessions": sessions_shown(catalog),
            "models": models_shown(catalog),
            "sources": sources_shown(catalog),
            "skeletons": [self._skeletons(i) for i in catalog.items("skeletons")],
            "jobs": [j.shown() for j in self.jobs.every()],
        }

    def _skeletons(self, item: Item) -> dict[str, Any]:
        """A recording of live sensors, for a list; result: id of what it was fused to."""
        fused = fused_in(item.path)
        result = self.catalog.id_of("result", fused) if (fused / "motion.npz").is_file() else None
        return {"id": item.id, "name": item.path.name, "path": self.catalog.shown(item.path), "result": result}

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        warm = threading.Thread(target=_warm, name="warm", daemon=True)
        warm.start()
        yield
        await self.fusion.stop()
        await self.cameras.stop()
        await run_in_threadpool(self.close)

    def let_go(self) -> None:
        """Close what is open of results and recordings: a file that is open cannot be moved everywhere."""
        self.results.drop()
        self.recordings.drop()

    def close(self) -> None:
        """Stop what runs with its work kept, and let go of everything."""
        self.gestures.close()
        self.jobs.close()
        self.let_go()


def _warm() -> None:
    """Load the kernels that a result is opened with, before somebody waits for them."""
    skeleton = human().skeleton
    skeleton.forward(np.zeros((1, skeleton.dof)))


def _static() -> list[BaseRoute]:
    """An installation without the page has nothing there."""
    return [Mount("/static", StaticFiles(directory=STATIC))] if STATIC.is_dir() else []


async def _page(request: Request) -> Response:
    if not (STATIC / "index.html").is_file():
        return Response(NOT_BUILT + "\n", 503, media_type="text/plain")
    return FileResponse(STATIC / "index.html", headers={"Cache-Control": "no-store"})


NOT_BUILT = (
    "The studio's page is not part of this installation: it could not be built when hypose was installed. Install "
    "hypose from a wheel, or build the page with `python hatch_build.py` in the sources (it needs the network once)."
)


async def _bug(request: Request, error: Exception) -> Response:
    return refusal(500, f"This should not have happened ({type(error).__name__}); the server's terminal says more.")


async def _nothing(request: Request, error: Exception) -> Response:
    return refusal(404, "There is nothing at this address.")


def config(studio: Studio, host: str, port: int) -> uvicorn.Config:
    """How the application is served: so many connections at most, small messages only, nothing compressed (pictures
    are), no signature, and who comes is told by the connection alone."""
    made = uvicorn.Config(
        studio.app,
        http="h11",
        limit_concurrency=MOST_CONNECTIONS,
        timeout_keep_alive=20,
        proxy_headers=False,
        host=host,
        port=port,
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=MAX_MESSAGE,
        ws_per_message_deflate=False,
        ws_max_queue=32,
        ws_ping_timeout=60,  # a page on a busy machine may be silent for long
        timeout_graceful_shutdown=2,
    )
    quiet_logs()
    return made


class _Server(uvicorn.Server):
    """Calls `ready` with the port as soon as it listens."""

    def __init__(self, settings: uvicorn.Config, ready: Callable[[int], None]) -> None:
        super().__init__(settings)
        self._ready = ready

    async def startup(self, sockets=None) -> None:  # noqa: ANN001 - as in uvicorn
        """Listen, then say so."""
        await super().startup(sockets)
        if self.started:
            self._ready(self.servers[0].sockets[0].getsockname()[1])


def make_server(
    studio: Studio, host: str, port: int, ready: Callable[[int], None] = lambda port: None
) -> uvicorn.Server:
    """A server that is not running yet; `should_exit` ends it."""
    return _Server(config(studio, host, port), ready)


def run(options: StudioOptions, ready: Callable[[str], None]) -> None:
    """Serve until Ctrl-C or SIGTERM; ready(address) is called when the page can be opened."""
    import socket

    studio = Studio(options)
    with socket.socket(socket.AF_INET6 if ":" in options.host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((options.host, options.port))
        except (OSError, OverflowError) as error:
            studio.close()
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(
                f"Port {options.port} on {options.host} cannot be used ({reason.lower()}); choose another with --port, "
                "0 takes any free one."
            ) from None
    token = f"?token={quote(studio.token)}" if studio.token else ""
    host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(options.host, options.host)
    server = make_server(studio, options.host, options.port, lambda port: ready(f"http://{host}:{port}/{token}"))
    with contextlib.suppress(KeyboardInterrupt):
        server.run()
