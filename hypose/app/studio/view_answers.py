"""Results as the View screen asks for them: one block of bytes, pictures and outlines of any frame, files, exports."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route

from hypose.app.reports.summary import DESCRIPTIONS
from hypose.app.studio.answers import answer, block_answer, body_of, told
from hypose.app.studio.asked import digits
from hypose.app.studio.catalog import Catalog, Item, NotFound
from hypose.app.studio.gait_view import gait_view
from hypose.app.studio.jobs import Jobs
from hypose.app.studio.memory_cache import Kept
from hypose.app.studio.thumbnails import Glimpse, glimpse_of, thumbnail
from hypose.app.studio.view_bundle import view_bundle
from hypose.app.studio.view_pictures import ViewPictures
from hypose.app.studio.view_result import first_frame, load_view, quality_of
from hypose.app.studio.zipped_folder import archive_name, zipped
from hypose.errors import HyposeError, InputError
from hypose.io.motions.results import load_motion
from hypose.io.recordings.recording import load_recording

_BLOCKS, _PICTURES, _THUMBNAILS, _GAITS = 24 << 20, 64 << 20, 4 << 20, 4 << 20
"""Bytes of blocks, of open pictures, of thumbnails and of answers on gait that are kept."""
_DESCRIBED = ("recording.toml", "Config.toml", "calibration.toml")
_MOTION = ("motion.npz", "body.npz")
_JUDGED = ("verdict.json", "modes.npz", "checkpoint.npz")
"""Files beside a motion that say how good it is, and whether it is all."""
Stamp = tuple[float | None, ...]
T = TypeVar("T")
_UNTRUSTED = (
    "sandbox allow-scripts; default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src "
    "'unsafe-inline'; media-src data: blob:; worker-src blob:"
)
"""For pages that lie in the served folder: they may show themselves, and reach neither the server nor anything else."""


@dataclass(frozen=True)
class _Head:
    """What a list shows of a result, as of when its files had this stamp. glimpse: None where it cannot be read."""

    stamp: Stamp
    facts: dict[str, Any]
    glimpse: Glimpse | None


class Results:
    """What is open of results; used by several threads."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._blocks: Kept[bytearray] = Kept(_BLOCKS, len, one_more=True)
        # of four cameras of 1080p more is open than is kept of others: to open it for every picture would take seconds
        self._pictures: Kept[ViewPictures] = Kept(_PICTURES, lambda p: p.held, ViewPictures.close, one_more=True)
        self._thumbnails: Kept[bytes] = Kept(_THUMBNAILS, len)
        self._heads: dict[str, _Head] = {}
        self._gaits: Kept[bytes] = Kept(_GAITS, len)
        self._one = threading.Lock()  # whole motions are held by one thread at a time: they are what is large here

    def block(self, item: Item) -> bytearray:
        """The whole result; made again when its files have changed, or those of its recording."""

        def make() -> bytearray:
            with self._one:
                return view_bundle(load_view(item.path))

        folder = self._catalog.recording_of(item.path)
        described = () if folder is None else _stamp(folder, (*_DESCRIBED, "truth.npz"))
        with self._blocks.use((item.id, _stamp(item.path, (*_JUDGED, *DESCRIPTIONS)), described), make) as block:
            return block

    def pictures(self, item: Item) -> AbstractContextManager[ViewPictures]:
        """The pictures of a result's recording, while they are used; NotFound when it has none. Results of the same
        frames share them."""
        folder = self._catalog.recording_of(item.path)
        if folder is None:
            raise NotFound("The result has no recording beside it, so there are no pictures of it.")
        facts = self.head(item)  # the motion itself is not needed, and may be large
        frames = facts["first_frame"], facts["frames"]
        return self._pictures.use(
            (folder, _stamp(folder, _DESCRIBED), *frames), lambda: ViewPictures(load_recording(folder), *frames)
        )

    def head(self, item: Item) -> dict[str, Any]:
        """What a list says of a result."""
        return self._head(item).facts

    def _head(self, item: Item) -> _Head:
        stamp = _stamp(item.path, (*_MOTION, *_JUDGED))
        known = self._heads.get(item.id)  # without waiting for whoever holds a motion
        if known is not None and known.stamp == stamp:
            return known
        with self._one:  # several that ask at once do not each read all
            if item.id not in self._heads or self._heads[item.id].stamp != stamp:
                self._heads[item.id] = self._read_head(item, stamp)
            return self._heads[item.id]

    def _read_head(self, item: Item, stamp: Stamp) -> _Head:
        folder = self._catalog.recording_of(item.path)
        recipe, correctable, quality, first, glimpse = "unknown", False, {}, 0, None
        try:
            motion = load_motion(item.path / "motion.npz")
            frames, rate = len(motion), motion.frame_rate
            recipe = str(motion.provenance.get("recipe", recipe))
            first = first_frame(motion)
            correctable = folder is not None and motion.poses is not None and not (item.path / "modes.npz").exists()
            quality, glimpse = quality_of(item.path, motion), glimpse_of(motion)
        except HyposeError:
            frames, rate = 0, 0.0
        facts = {
            "id": item.id,
            "title": f"{folder.name}: {item.path.name}" if folder is not None else item.path.name,
            "name": item.path.name,
            "path": self._catalog.shown(item.path),
            "recording": self._catalog.id_of("recording", folder) if folder is not None else None,
            "recipe": recipe,
            "frames": frames,
            "first_frame": first,
            "frame_rate": rate,
            "seconds": frames / rate if rate else 0.0,
            "complete": frames > 0 and not (item.path / "checkpoint.npz").exists(),
            "changed": stamp[0] or item.changed,
            "correctable": correctable,
            "pictured": folder is not None,
            **quality,
        }
        return _Head(stamp, facts, glimpse)

    def thumbnail(self, item: Item) -> bytes:
        """A small JPEG: the person with the skeleton in the middle of the result, as the first camera sees it."""
        with self._thumbnails.use((item.id, _stamp(item.path)), lambda: self._thumbnail(item)) as data:
            return data

    def _thumbnail(self, item: Item) -> bytes:
        glimpse = self._head(item).glimpse
        if glimpse is None:
            raise NotFound("This result cannot be read, so there is no picture of it.")
        with self.pictures(item) as opened:
            return thumbnail(glimpse, opened)

    def gait(self, item: Item) -> bytes:
        """How somebody walks, as JSON."""

        def make() -> bytes:
            with self._one:
                return bytes(answer(gait_view(item.path)).body)

        with self._gaits.use((item.id, _stamp(item.path)), make) as data:
            return data

    def drop(self) -> None:
        """Release the files that are not in use."""
        self._gaits.drop()
        self._thumbnails.drop()
        self._pictures.drop()
        self._blocks.drop()

    def close(self) -> None:
        """Release the files."""
        self._gaits.close()
        self._thumbnails.close()
        self._pictures.close()
        self._blocks.close()


def _stamp(folder: Path, files: Sequence[str] = _MOTION) -> Stamp:
    """Changes when these files of a folder are written again, or are there no longer; of a checkpoint, which is written
    all the time, when it comes and goes."""

    def written(name: str) -> float | None:
        try:
            at = (folder / name).stat().st_mtime
        except OSError:
            return None
        return 0.0 if name == "checkpoint.npz" else at

    return tuple(written(n) for n in files)


def file_answer(folder: Path, name: str, catalog: Catalog) -> Response:
    """A file of a folder by its name, which the caller has found to be one that may be given away."""
    path = folder / name
    if not path.is_file() or not catalog.contains(path):
        raise NotFound(f"There is no file {name[:80]!r} here.")
    headers = {"Content-Security-Policy": _UNTRUSTED, "Cache-Control": "no-store"}
    shown = path.suffix in (".html", ".png", ".jpg", ".mp4")
    return FileResponse(path, headers=headers, filename=None if shown else path.name)


def routes(catalog: Catalog, results: Results, jobs: Jobs) -> list[Route]:
    """The routes below /api/results."""

    blocks, gaits = asyncio.Lock(), asyncio.Lock()  # of what takes long one at a time is made

    def item_of(request: Request) -> Item:
        return catalog.find("result", request.path_params["id"])

    async def in_turn(turn: asyncio.Lock, request: Request, make: Callable[[Item], T]) -> T | None:
        """None: it was looked at only briefly, and nobody waits for it any more."""
        item = item_of(request)
        async with turn:
            return None if await request.is_disconnected() else await run_in_threadpool(make, item)

    async def every(request: Request) -> Response:
        return answer(await run_in_threadpool(lambda: [results.head(i) for i in catalog.items("result")]))

    async def view(request: Request) -> Response:
        data = await in_turn(blocks, request, results.block)
        return Response(status_code=204) if data is None else block_answer(data)

    async def pictures(request: Request) -> Response:
        item, row = item_of(request), digits(request.path_params["row"], "The row")
        width = digits(request.query_params.get("width", "640"), "The width")

        def of_row() -> bytes:
            with results.pictures(item) as opened:
                return opened.row(row, width)

        data = await run_in_threadpool(of_row)
        # the same row of the same result stays what it is while a page is open
        return Response(data, media_type="application/octet-stream", headers={"Cache-Control": "private, max-age=60"})

    async def small(request: Request) -> Response:
        data = await run_in_threadpool(results.thumbnail, item_of(request))
        return Response(data, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=600"})

    async def outlines(request: Request) -> Response:
        item, row = item_of(request), digits(request.path_params["row"], "The row")

        def of_row() -> list[list[list[float]]]:
            with results.pictures(item) as opened:
                return opened.outlines(row)

        return answer({"views": await run_in_threadpool(of_row)})

    async def file(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in DESCRIPTIONS:
            raise NotFound(f"A result has no file {name[:80]!r}.")
        return file_answer(item_of(request).path, name, catalog)

    async def everything(request: Request) -> Response:
        item = item_of(request)
        headers = {
            "Content-Disposition": f'attachment; filename="{archive_name(item.path)}"',
            "Cache-Control": "no-store",
        }
        return StreamingResponse(zipped(item.path, catalog), media_type="application/zip", headers=headers)

    async def gait(request: Request) -> Response:
        data = await in_turn(gaits, request, results.gait)
        if data is None:
            return Response(status_code=204)
        return Response(data, media_type="application/json", headers={"Cache-Control": "no-store"})

    async def export(request: Request) -> Response:
        formats = (await body_of(request)).get("formats")
        if not isinstance(formats, list) or not formats:
            raise InputError("Name the formats to export, for example trc.")
        job = jobs.start("export", {"result": item_of(request).id, "options": {"formats": formats}})
        return answer(job.shown(), 201)

    return [
        Route("/api/results", told(every)),
        Route("/api/results/{id}/view", told(view)),
        Route("/api/results/{id}/pictures/{row}", told(pictures)),
        Route("/api/results/{id}/outlines/{row}", told(outlines)),
        Route("/api/results/{id}/thumbnail.jpg", told(small)),
        Route("/api/results/{id}/files/{name}", told(file)),
        Route("/api/results/{id}/all.zip", told(everything)),
        Route("/api/results/{id}/gait", told(gait)),
        Route("/api/results/{id}/export", told(export), methods=["POST"]),
    ]
