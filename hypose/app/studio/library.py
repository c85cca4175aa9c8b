"""Recordings and results as a library: renamed, and results deleted for good."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from hypose.app.studio.answers import NotNow, answer, body_of, told
from hypose.app.studio.catalog import Catalog, Item, Kind
from hypose.app.studio.job_kinds import is_name
from hypose.errors import InputError


class Library:
    """busy(id): whether a job that is under way needs an item; let_go(): closes what is open of the items."""

    def __init__(self, catalog: Catalog, busy: Callable[[str], bool], let_go: Callable[[], None]) -> None:
        self._catalog, self._busy, self._let_go = catalog, busy, let_go

    def delete(self, item: Item) -> None:
        """Remove the folder of a result with all that is in it, for good; links in it are removed, not followed."""
        self._check(item)
        if any(i.path != item.path and i.path.is_relative_to(item.path) for i in self._catalog.every()):
            raise InputError(f"Other recordings or results lie in {item.path.name}; delete it from outside.")
        self._change(item, lambda: shutil.rmtree(item.path), "deleted")

    def rename(self, item: Item, name: str) -> Item:
        """Give an item another name among its neighbours."""
        if not is_name(name):
            raise InputError(f"{name[:40]!r} is no name; use letters, digits, -, _ and dots between.")
        place = item.path.with_name(name)
        if place != item.path:
            self._check(item)
            if place.exists():
                raise NotNow(f"There is {name} already; choose another name.")
            self._change(item, lambda: item.path.rename(place), "renamed")
        return self._found(item.kind, place)

    def _check(self, item: Item) -> None:
        if item.path == self._catalog.root:
            raise InputError(f"{item.path.name} is the folder that is served; delete or rename it from outside.")
        if any(self._busy(i.id) for i in self._catalog.every() if i.path.is_relative_to(item.path)):
            raise NotNow(f"A job is at work on {item.path.name}; stop it first.")

    def _change(self, item: Item, change: Callable[[], object], what: str) -> None:
        self._let_go()
        try:
            change()
        except OSError as error:
            raise InputError(f"{item.path.name} cannot be {what} ({(error.strerror or str(error)).lower()}).") from None

    def _found(self, kind: Kind, path: Path) -> Item:
        self._catalog.items(kind, fresh=True)
        return self._catalog.find(kind, self._catalog.id_of(kind, path))


def routes(catalog: Catalog, library: Library) -> list[Route]:
    """The routes of the library."""

    async def delete(request: Request) -> Response:
        item = catalog.find("result", request.path_params["id"])
        await run_in_threadpool(library.delete, item)
        catalog.items("result", fresh=True)
        return answer({"name": item.path.name})

    def rename_of(kind: Kind) -> Route:
        async def rename(request: Request) -> Response:
            item, name = catalog.find(kind, request.path_params["id"]), (await body_of(request)).get("name")
            if not isinstance(name, str):
                raise InputError("Say what the new name is.")
            return answer(_shown(await run_in_threadpool(library.rename, item, name), catalog))

        return Route(f"/api/{kind}s/{{id}}/name", told(rename), methods=["POST"])

    return [
        rename_of("recording"),
        rename_of("result"),
        Route("/api/results/{id}", told(delete), methods=["DELETE"]),
    ]


def _shown(item: Item, catalog: Catalog) -> dict[str, Any]:
    return {"id": item.id, "kind": item.kind, "name": item.path.name, "path": catalog.shown(item.path)}
