"""Who may talk to the server: this computer's own pages, or who shows the token.

A web page of somebody else can make a browser send requests to 127.0.0.1. So a WebSocket, and whatever changes
something, must come from the page that this server served (its Origin is the host that was asked for); and the host
that was asked for must be one the server goes by, else a foreign name that was pointed to 127.0.0.1 would pass.
"""

from __future__ import annotations

import secrets
from http import HTTPStatus
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from hypose.app.live.servers import shows_secret
from hypose.app.studio.answers import error_response

LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
_CHANGING = frozenset({"POST", "PUT", "DELETE", "PATCH"})
_POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "worker-src 'self' blob:; media-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Nothing from elsewhere is loaded, whatever a recording or a bug puts into the page."""


def token_for(host: str, token: str | None = None) -> str | None:
    """What pages must show to a server that listens on a host: a new one when others can reach it and none is given."""
    return token or (None if host in LOOPBACK else secrets.token_urlsafe(16))


class Guard:
    """Refuses what may not talk to the server, before anything else sees it. token: None when it listens on this
    computer alone."""

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request or connection."""
        if scope["type"] not in ("http", "websocket"):
            return await self._app(scope, receive, send)
        try:
            problem = self._problem(scope)
        except ValueError:  # an Origin or Host that is no address
            problem = HTTPStatus.BAD_REQUEST, "The request names no proper host."
        if problem is None:
            await self._app(scope, receive, self._hardened(scope, send))
        elif scope["type"] == "http":
            await error_response(problem[0].value, problem[1])(scope, receive, send)
        else:
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": problem[1][:120]})

    def _problem(self, scope: Scope) -> tuple[HTTPStatus, str] | None:
        """Why a request is refused, None when it is not."""
        headers = Headers(scope=scope)
        asked = headers.get("host", "")
        name = (urlsplit(f"//{asked}").hostname or "").lower() if asked.isprintable() else ""
        if self._token is None and name not in LOOPBACK:
            return HTTPStatus.FORBIDDEN, f"This server does not go by {asked[:80]!r}; open it as http://127.0.0.1."
        changing = scope["type"] == "websocket" or scope["method"] in _CHANGING
        origin = headers.get("origin")
        foreign = origin is not None and urlsplit(origin).netloc.lower() != asked.lower()
        if changing and (foreign or headers.get("sec-fetch-site") in ("cross-site", "same-site")):
            return HTTPStatus.FORBIDDEN, "Pages of other sites may not talk to this server; open its own page."
        query, bearer = scope["query_string"].decode("latin-1"), headers.get("authorization", "")
        secret = self._token is not None and scope["path"].startswith(("/api/", "/ws/"))
        if secret and not shows_secret(query, bearer, self._token or ""):
            return HTTPStatus.UNAUTHORIZED, "The token is missing or wrong; use the address that `hypose view` printed."
        return None

    def _hardened(self, scope: Scope, send: Send) -> Send:
        if scope["type"] != "http":
            return send

        async def sending(message) -> None:  # noqa: ANN001 - an ASGI message
            if message["type"] == "http.response.start":
                headers = Headers(raw=message["headers"])
                extra = {"x-content-type-options": "nosniff", "referrer-policy": "no-referrer"}
                extra["cross-origin-resource-policy"] = "same-origin"
                if "content-security-policy" not in headers:
                    extra["content-security-policy"] = _POLICY
                message["headers"] = [*message["headers"], *((k.encode(), v.encode()) for k, v in extra.items())]
            await send(message)

        return sending
