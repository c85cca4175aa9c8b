"""Read requests of pages field by field, and build answers: JSON without NaN, errors as one sentence; refuse foreign
requests.

Every WebSocket message, request and address is read by these functions; their InputErrors are sentences for the page.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import AsyncIterator, Callable, Sequence
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from hypose.app.live.servers import LOOPBACK, shows_secret
from hypose.app.studio.catalog import NotFound
from hypose.app.studio.view_bundle import json_values
from hypose.errors import HyposeError, InputError
from hypose.json_text import parse_json

MAX_JSON = 1 << 20
_SLICE = 1 << 18
"""Bytes of a block that are sent at once."""
_DEEPEST = 16
_HALF_OF_PAIR = re.compile(r"[\ud800-\udfff]")
"""Half of a UTF-16 pair, which JSON allows but no text, file or terminal accepts."""


class NotNow(InputError):
    """Error: the request cannot be done in the present state."""


_STATUS: tuple[tuple[type[HyposeError], int], ...] = ((NotFound, 404), (NotNow, 409))


def answer(value: Any, status: int = 200) -> JSONResponse:
    """Build a JSON answer; numpy values become plain ones, NaN becomes null. The browser must not cache it, since files
    change.

    value: anything that `json_values` converts.
    status: status of HTTP.
    """
    return JSONResponse(json_values(value), status, headers={"Cache-Control": "no-store"})


def block_answer(block: bytes | bytearray | None) -> Response:
    """Build the answer with a block of a result (`view_bundle`), or an empty one. It is sent in slices, so that the
    block is not copied as a whole.
    """
    if block is None:
        return Response(status_code=204)

    async def slices() -> AsyncIterator[memoryview]:
        for at in range(0, len(block), _SLICE):
            yield memoryview(block)[at : at + _SLICE]

    headers = {"Cache-Control": "no-store", "Content-Length": str(len(block))}
    return StreamingResponse(slices(), media_type="application/octet-stream", headers=headers)


def jpeg_answer(data: bytes | None, seconds: int) -> Response:
    """Build the answer with a JPEG, or an empty one; it may be cached for so many seconds."""
    if data is None:
        return Response(status_code=204)
    return Response(data, media_type="image/jpeg", headers={"Cache-Control": f"private, max-age={seconds}"})


def error_response(status: int, sentence: str) -> JSONResponse:
    """Build the answer with an error sentence."""
    return JSONResponse({"error": sentence}, status)


def route(path: str, call: Callable[..., Any], method: str = "GET", status: int = 200) -> Route:
    """Make the route of an address.

    path: path of the address.
    call: gets the request, for POST also its JSON object; returns a response, or a value for a JSON answer. It runs in
        a thread unless it is asynchronous; its HyposeErrors become error answers.
    method: GET, POST or DELETE.
    status: status of HTTP for a value.
    """

    async def endpoint(request: Request) -> Response:
        try:
            given = (request, await _body_of(request)) if method == "POST" else (request,)
            value = await (call(*given) if inspect.iscoroutinefunction(call) else run_in_threadpool(call, *given))
        except HyposeError as error:
            return error_response(next((code for kind, code in _STATUS if isinstance(error, kind)), 400), str(error))
        return value if isinstance(value, Response) else answer(value, status)

    return Route(path, endpoint, methods=[method])


async def _body_of(request: Request) -> dict[str, Any]:
    """Read the JSON object of a request.

    Raises: InputError where it breaks off or is too large.
    """
    data = bytearray()
    try:
        async for piece in request.stream():
            data += piece
            if len(data) > MAX_JSON:
                raise InputError(f"The request is larger than {MAX_JSON >> 20} MiB; send less at once.")
    except ClientDisconnect:
        raise InputError("The request broke off; send it again.") from None
    return object_of(data or b"{}", "request")


# ---- fields ----


def object_of(data: str | bytes | bytearray, what: str) -> dict[str, Any]:
    """Parse the JSON object of a message or request, of limited depth.

    what: name of the object, for the message.
    Raises: InputError where the data are no JSON object.
    """
    try:
        value = parse_json(data)
    except (ValueError, RecursionError):
        raise InputError(f"The {what} is no JSON; send an object.") from None
    if not isinstance(value, dict):
        raise InputError(f"The {what} is no JSON object; send one.")
    level: list[Any] = [value]
    for _ in range(_DEEPEST):
        if any(isinstance(v, str) and _HALF_OF_PAIR.search(v) for v in level):
            raise InputError(f"The {what} holds text that is none (half of a character); send Unicode.")
        level = [inner for v in level if isinstance(v, dict | list) for inner in _inside(v)]
        if not level:
            return value
    raise InputError(f"The {what} is nested more than {_DEEPEST} deep; send a flatter object.")


def _inside(value: dict[str, Any] | list[Any]) -> list[Any]:
    return value if isinstance(value, list) else [*value.keys(), *value.values()]


def request_number(value: Any, what: str, low: float, high: float) -> float:
    """Return a number of a request after checking it.

    value: value of the request.
    what: name of the value, for the message.
    low, high: least and largest value.
    Raises: InputError where it is no number from low to high.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"There is no number for {what} in {_short(value)}; give {low:g} to {high:g}.")
    if not low <= value <= high:  # NaN is neither
        raise InputError(f"{_capital(what)} cannot be {value:g}; give {low:g} to {high:g}.")
    return float(value)


def whole(value: Any, what: str, low: int, high: int) -> int:
    """Return a whole number of a request after checking it.

    value: value of the request.
    what: name of the value, for the message.
    low, high: least and largest value.
    Raises: InputError where it is no whole number from low to high.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InputError(f"{_capital(what)} cannot be {_short(value)}; give a whole number from {low} to {high}.")
    return value


def text(value: Any, what: str, longest: int, advice: str) -> str:
    """Return a text of a request after checking it.

    value: value of the request.
    what: name of the value, for the message.
    longest: most letters.
    advice: next step for the user where it is missing.
    Raises: InputError where it is empty, too long or no text.
    """
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"There is no {what}; {advice}.")
    if len(value) > longest:
        raise InputError(f"The {what} has {len(value)} letters; give at most {longest}.")
    return value


def request_choice(value: Any, what: str, allowed: Sequence[str]) -> str:
    """Return a word of a request after checking it.

    value: value of the request.
    what: name of the value, for the message.
    allowed: words of which it must be one.
    Raises: InputError lists the allowed words.
    """
    if not isinstance(value, str) or value not in allowed:
        words = f"{', '.join(allowed[:-1])} or {allowed[-1]}" if len(allowed) > 1 else "".join(allowed)
        raise InputError(f"There is no {what} {_short(value)}; choose {words}.")
    return value


def digits(value: str, what: str) -> int:
    """Parse a whole number from an address or query, from 0 with at most nine digits.

    value: the text.
    what: name of the value, for the message.
    Raises: InputError where it is no such number.
    """
    if not value.isascii() or not value.isdigit() or len(value) > 9:
        raise InputError(f"{_capital(what)} must be a whole number, {_short(value)} is none.")
    return int(value)


def _short(value: Any) -> str:
    return repr(value if not isinstance(value, str) else value[:40])[:40]


def _capital(what: str) -> str:
    return what[:1].upper() + what[1:]


# ---- guard ---------------------------------------------------------------------------------------------------------
# Access to the server: only this computer's own pages, or clients that show the token.
#
# A web page of another site can make a browser send requests to 127.0.0.1. So a WebSocket, and any request that changes
# something, must come from the page that this server served (its Origin is the requested host). The requested host must
# be a name of this server; otherwise a foreign name that resolves to 127.0.0.1 would pass.


_CHANGING = frozenset({"POST", "PUT", "DELETE", "PATCH"})
_POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "worker-src 'self' blob:; media-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Content security policy of all pages: nothing is loaded from elsewhere, whatever a recording or a bug puts into the
page.
"""


class Guard:
    """Application that refuses foreign requests before any other code sees them.

    token: "" where the server listens on this computer only.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection."""
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
        """Return why a request is refused; None where it is allowed."""
        headers = Headers(scope=scope)
        asked = headers.get("host", "")
        name = (urlsplit(f"//{asked}").hostname or "").lower() if asked.isprintable() else ""
        if not self._token and name not in LOOPBACK:
            return HTTPStatus.FORBIDDEN, f"This server does not go by {asked[:80]!r}; open it as http://127.0.0.1."
        changing = scope["type"] == "websocket" or scope["method"] in _CHANGING
        origin = headers.get("origin")
        foreign = origin is not None and urlsplit(origin).netloc.lower() != asked.lower()
        if changing and (foreign or headers.get("sec-fetch-site") in ("cross-site", "same-site")):
            return HTTPStatus.FORBIDDEN, "Pages of other sites may not talk to this server; open its own page."
        query, bearer = scope["query_string"].decode("latin-1"), headers.get("authorization", "")
        secret = bool(self._token) and scope["path"].startswith(("/api/", "/ws/"))
        if secret and not shows_secret(query, bearer, self._token):
            return HTTPStatus.UNAUTHORIZED, "The token is missing or wrong; use the address that `hypose view` printed."
        return None

    def _hardened(self, scope: Scope, send: Send) -> Send:
        """Return a `send` that adds security headers to an HTTP answer; for a WebSocket, `send` itself."""
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
