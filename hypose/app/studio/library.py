"""Recordings and results as a library: deleted with a way back, renamed.

What is deleted lies in a hidden folder of the served one until the server ends, so that it can be brought back.
"""

from __future__ import annotations

import secrets
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from hypose.app.studio.answers import NotNow, answer, body_of, told
from hypose.app.studio.catalog import Catalog, Item, Kind, NotFound
from hypose.app.studio.job_kinds import is_name
from hypose.errors import InputError

FOLDER = ".studio-trash"


@dataclass(frozen=True)
class _Deleted:
    kind: Kind
    place: Path
    kept: Path


class Library:
    """busy(id): whether a job that is under way needs an item; let_go(): closes what is open of the items."""

    def __init__(self, catalog: Catalog, busy: Callable[[str], bool], let_go: Callable[[], None]) -> None:
        self._catalog, self._busy, self._let_go = catalog, busy, let_go
        self._trash = catalog.root / FOLDER
        self._lock = threading.Lock()
        self._deleted: dict[str, _Deleted] = {}

    def delete(self, item: Item) -> str:
        """Put an item away; returns what brings it back."""
        self._check(item)
        token = secrets.token_hex(6)
        kept = self._trash / token / item.path.name
        kept.parent.mkdir(parents=True)
        self._move(item.path, kept)
        with self._lock:
            self._deleted[token] = _Deleted(item.kind, item.path, kept)
        return token

    def bring_back(self, token: str) -> Item:
        """Undo a deletion."""
        with self._lock:
            deleted = self._deleted.get(token)
            if deleted is None:
                raise NotFound("What was deleted is not there any more.")
            if deleted.place.exists():
                raise NotNow(f"There is another {deleted.place.name} now; rename it, then bring the old one back.")
            del self._deleted[token]
        deleted.place.parent.mkdir(parents=True, exist_ok=True)
        self._move(deleted.kept, deleted.place)
        return self._found(deleted.kind, deleted.place)

    def rename(self, item: Item, name: str) -> Item:
        """Give an item another name among its neighbours."""
        if not is_name(name):
            raise InputError(f"{name[:40]!r} is no name; use letters, digits, -, _ and dots between.")
        place = item.path.with_name(name)
        if place != item.path:
            self._check(item)
            if place.exists():
                raise NotNow(f"There is {name} already; choose another name.")
            self._move(item.path, place)
        return self._found(item.kind, place)

    def close(self) -> None:
        """Remove what was deleted for good."""
        shutil.rmtree(self._trash, ignore_errors=True)

    def _check(self, item: Item) -> None:
        if item.path == self._catalog.root:
            raise InputError(f"{item.path.name} is the folder that is served; delete or rename it from outside.")
        every = [*self._catalog.items("recording"), *self._catalog.items("result")]
        if any(self._busy(i.id) for i in every if i.path.is_relative_to(item.path)):
            raise NotNow(f"A job is at work on {item.path.name}; stop it first.")

    def _move(self, source: Path, target: Path) -> None:
        self._let_go()
        try:
            source.rename(target)
        except OSError as error:
            raise InputError(f"{source.name} cannot be moved ({(error.strerror or str(error)).lower()}).") from None

    def _found(self, kind: Kind, path: Path) -> Item:
        self._catalog.items(kind, fresh=True)
        return self._catalog.find(kind, self._catalog.id_of(kind, path))


def routes(catalog: Catalog, library: Library) -> list[Route]:
    """The routes of the library."""

    def of_kind(kind: Kind) -> list[Route]:
        async def delete(request: Request) -> Response:
            item = catalog.find(kind, request.path_params["id"])
            token = await run_in_threadpool(library.delete, item)
            catalog.items(kind, fresh=True)
            return answer({"trash": token, "name": item.path.name})

        async def rename(request: Request) -> Response:
            item, name = catalog.find(kind, request.path_params["id"]), (await body_of(request)).get("name")
            if not isinstance(name, str):
                raise InputError("Say what the new name is.")
            return answer(_shown(await run_in_threadpool(library.rename, item, name), catalog))

        return [
            Route(f"/api/{kind}s/{{id}}", told(delete), methods=["DELETE"]),
            Route(f"/api/{kind}s/{{id}}/name", told(rename), methods=["POST"]),
        ]

    async def bring_back(request: Request) -> Response:
        return answer(_shown(await run_in_threadpool(library.bring_back, request.path_params["token"]), catalog))

    return [
        *of_kind("recording"),
        *of_kind("result"),
        Route("/api/trash/{token}", told(bring_back), methods=["POST"]),
    ]


def _shown(item: Item, catalog: Catalog) -> dict[str, Any]:
    return {"id": item.id, "kind": item.kind, "name": item.path.name, "path": catalog.shown(item.path)}
