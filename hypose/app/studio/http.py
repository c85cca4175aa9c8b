"""Talk to pages: read their requests field by field, build answers (JSON without NaN, errors as one sentence), refuse
foreign requests, and send messages by WebSocket (`Topic`).

Every WebSocket message, request and address is read by these functions; their InputErrors are sentences for the page.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import json
import struct
from collections.abc import AsyncIterator, Callable, Hashable, Mapping, MutableMapping, Sequence
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from hypose.app.live.servers import LOOPBACK, shows_secret
from hypose.app.studio.catalog import NotFound
from hypose.app.studio.view_bundle import json_values
from hypose.errors import HyposeError, InputError
from hypose.json_text import parse_json

MAX_JSON = 1 << 20
_SLICE = 1 << 18
"""Bytes of a block that are sent at once."""


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


def data_answer(data: bytes | bytearray | None, kind: str = "application/octet-stream", seconds: int = 0) -> Response:
    """Build the answer with the bytes of a file, or an empty one. It is sent in slices, so that a large block is not
    copied as a whole.

    data: None: the answer is empty.
    kind: type of the file.
    seconds: time for which the browser may keep it, s.
    """
    if data is None:
        return Response(status_code=204)

    async def slices() -> AsyncIterator[memoryview]:
        for at in range(0, len(data), _SLICE):
            yield memoryview(data)[at : at + _SLICE]

    cached = f"private, max-age={seconds}" if seconds else "no-store"
    headers = {"Cache-Control": cached, "Content-Length": str(len(data))}
    return StreamingResponse(slices(), media_type=kind, headers=headers)


def error_response(status: int, sentence: str) -> JSONResponse:
    """Build the answer with an error sentence."""
    return JSONResponse({"error": sentence}, status)


def route(path: str, call: Callable[..., Any], method: str = "GET", status: int = 200) -> Route:
    """Make the route of an address.

    path: path of the address.
    call: gets the request, for POST also its JSON object; returns a response, or a value for a JSON answer. It runs in
        a thread, and what it returns to be awaited runs in the event loop; HyposeErrors become error answers.
    method: GET, POST or DELETE.
    status: status of HTTP for a value.
    """

    async def endpoint(request: Request) -> Response:
        try:
            given = (request, await _body_of(request)) if method == "POST" else (request,)
            value = await run_in_threadpool(call, *given)
            value = await value if inspect.isawaitable(value) else value
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
    """Parse the JSON object of a message or request.

    what: name of the object, for the message.
    Raises: InputError where the data are no JSON object, or hold half of a UTF-16 pair, which no file or terminal
        accepts.
    """
    try:
        value = parse_json(data)
        json.dumps(value, ensure_ascii=False).encode()
    except (ValueError, RecursionError):
        raise InputError(f"The {what} is no JSON in Unicode, or nested too deep; send an object.") from None
    if not isinstance(value, dict):
        raise InputError(f"The {what} is no JSON object; send one.")
    return value


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
_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "content-security-policy": "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
    "connect-src 'self'; worker-src 'self' blob:; media-src 'self' data: blob:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
}
"""Headers of all answers that have no others. By the content security policy nothing is loaded from elsewhere, whatever
a recording or a bug puts into a page.
"""


class Guard:
    """Application that refuses foreign requests before any other code sees them.

    token: "" where the server listens on this computer only.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection."""
        try:
            problem = None if scope["type"] == "lifespan" else self._problem(scope)
        except ValueError:  # an Origin or Host that is no address
            problem = HTTPStatus.BAD_REQUEST, "The request names no proper host."
        if problem is None:
            await self._app(scope, receive, _hardened(send))
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


def _hardened(send: Send) -> Send:
    """Return a `send` that adds security headers to an HTTP answer."""

    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending


# ---- topics ------------------------------------------------------------------------------------------------------
# The studio's WebSockets: /ws/TOPIC, with typed messages in both directions (docs/studio-protocol.md).
#
# A page listens to one topic and sends messages to it. The queue of a slow page is limited: of messages with a key only
# the newest waits, pictures wait until the page has drawn earlier ones, and a page that reads nothing is closed.


MAX_MESSAGE = 1 << 16
"""Largest message from a page, bytes."""
_MOST_PAGES, _MOST_WAITING = 16, 512
"""Most connections, and most messages without a key that wait for one of them."""
IN_FLIGHT = 3
"""Pictures that may be sent before the page has drawn the first of them."""
DEPTH, MAP = 1, 2
"""Types of pictures."""
Message = Mapping[str, Any]


class Topic:
    """Topic that pages listen and send messages to; name: name of the topic, a part of the address. `post` and
    `picture` may be called from any thread, and never wait; all else is called in the server's event loop.

    Attributes:
    pages: connections of the pages that listen.
    """

    name = ""

    def __init__(self) -> None:
        self.pages: list[_Page] = []
        self._loop: asyncio.AbstractEventLoop | None = None

    def hello(self) -> Message:
        """Return the first message to a page."""
        raise NotImplementedError

    async def heard(self, message: dict[str, Any]) -> None:
        """Handle a message of a page; an InputError is sent to that page only."""
        raise InputError("A page has nothing to say here.")

    def post(self, message: Message | str, key: Hashable = None) -> None:
        """Send a message (or its JSON text) to all pages that listen.

        key: key of waiting messages with the same key only the newest is kept; None: all are kept.
        """
        if self.pages:
            self._send(message if isinstance(message, str) else _text(message), key)

    def picture(self, kind: int, seq: int, time: float, data: bytes) -> None:
        """Send a picture to all pages that listen: 16 bytes with type, stream, number and time, then the file. Of each
        type only the newest waits.

        kind: DEPTH or MAP.
        seq: number of the picture, which the page answers.
        time: s.
        data: the file, JPEG or PNG.
        """
        if self.pages:
            self._send(struct.pack("<BBHId", kind, 0, 0, seq & 0xFFFFFFFF, time) + data, kind)

    def _send(self, message: str | bytes, key: Hashable) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            if self._loop is not None:
                self._loop.call_soon_threadsafe(lambda: [page.put(message, key) for page in self.pages])

    async def serve(self, ws: WebSocket) -> None:
        """Handle an accepted connection until either side ends it."""
        self._loop, page = asyncio.get_running_loop(), _Page(ws)
        self.pages.append(page)
        page.put(_text(self.hello()))
        try:
            async with asyncio.TaskGroup() as talking:
                talking.create_task(page.read(self))
                talking.create_task(page.write())
        except* WebSocketDisconnect:
            pass
        finally:
            self.pages.remove(page)


async def serve_topics(topics: Mapping[str, Topic], ws: WebSocket) -> None:
    """Accept a connection to /ws/TOPIC and handle it until either side ends it."""
    topic = topics.get(ws.path_params["topic"])
    await ws.accept()
    if topic is None or sum(len(t.pages) for t in topics.values()) >= _MOST_PAGES:
        await ws.close(1013, "too many connections; close some pages" if topic else "there is no such topic")
    else:
        await topic.serve(ws)


class _Page:
    """Server side of one connection; used in the event loop."""

    def __init__(self, ws: WebSocket) -> None:
        self._ws, self._awake = ws, asyncio.Event()
        self._texts: dict[Hashable, str] = {}
        self._pictures: dict[Hashable, bytes] = {}
        self._unanswered: set[int] = set()

    def put(self, message: str | bytes, key: Hashable = None) -> None:
        """Queue a text, or a picture with its header, which is sent when the page has drawn the last ones.

        key: key of messages with the same one only the newest waits; None: all wait.
        """
        queue: dict[Hashable, Any] = self._texts if isinstance(message, str) else self._pictures
        key = object() if key is None else key
        queue.pop(key, None)
        queue[key] = message
        self._awake.set()

    async def write(self) -> None:
        """Send queued texts, and pictures while the page has drawn enough of the earlier ones, until the page does not
        keep up (WebSocketDisconnect).
        """
        try:
            while len(self._texts) <= _MOST_WAITING:
                while self._texts:
                    await self._ws.send_text(self._texts.pop(next(iter(self._texts))))
                while self._pictures and len(self._unanswered) < IN_FLIGHT:
                    message = self._pictures.pop(next(iter(self._pictures)))
                    self._unanswered.add(struct.unpack_from("<I", message, 4)[0])
                    await self._ws.send_bytes(message)
                await self._awake.wait()
                self._awake.clear()
            await self._ws.close(1013, "the page does not keep up")
        except RuntimeError:  # the connection is closed already
            pass
        raise WebSocketDisconnect(1006)

    async def read(self, topic: Topic) -> None:
        """Pass messages of the page to a topic, until the page ends the connection (WebSocketDisconnect)."""
        while True:
            received = await self._ws.receive()
            if received["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(received.get("code", 1005))
            try:
                if received.get("text") is None:
                    raise InputError("The message is binary; send JSON as text.")
                message = object_of(received["text"], "message")
                if not isinstance(message.get("t"), str):
                    raise InputError('The message has no "t" that says what it is; send one.')
                if message["t"] == "ack":
                    self._unanswered.discard(whole(message.get("seq"), "the picture's number", 0, 2**32 - 1))
                    self._awake.set()
                else:  # a page that leaves must not interrupt a start or an end with its saving
                    await asyncio.shield(topic.heard(message))
            except HyposeError as error:
                self.put(_text({"t": "error", "error": str(error)}))


def _text(message: Message) -> str:
    return json.dumps(json_values(message), separators=(",", ":"))
