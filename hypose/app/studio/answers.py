"""Answers of the server: JSON in which nothing is NaN, errors as one sentence, bodies of requests within bounds."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from hypose.app.studio.catalog import NotFound
from hypose.app.view_bundle import plain
from hypose.errors import HyposeError, InputError
from hypose.json_text import parse_json

MAX_JSON = 1 << 20
Endpoint = Callable[[Request], Awaitable[Response]]


class NotNow(InputError):
    """What was asked for cannot be done in the present state."""


class TooLarge(InputError):
    """More was sent than is taken."""


def answer(value: Any, status: int = 200) -> JSONResponse:
    """JSON; numpy values become plain ones, NaN becomes null. Never kept by the browser: files change."""
    return JSONResponse(plain(value), status, headers={"Cache-Control": "no-store"})


def refusal(status: int, sentence: str) -> JSONResponse:
    """An error as the page shows it."""
    return JSONResponse({"error": sentence}, status)


def told(endpoint: Endpoint) -> Endpoint:
    """The endpoint, with its errors as answers."""

    async def guarded(request: Request) -> Response:
        try:
            return await endpoint(request)
        except NotFound as error:
            return refusal(404, str(error))
        except NotNow as error:
            return refusal(409, str(error))
        except TooLarge as error:
            return refusal(413, str(error))
        except HyposeError as error:
            return refusal(400, str(error))

    return guarded


async def body_of(request: Request) -> dict[str, Any]:
    """The JSON object of a request."""
    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > MAX_JSON:
            raise TooLarge(f"The request is larger than {MAX_JSON >> 20} MiB; send less at once.")
    try:
        value = parse_json(data or b"{}")
    except (ValueError, RecursionError):
        raise InputError("The request is no JSON; send an object.") from None
    if not isinstance(value, dict):
        raise InputError("The request is no JSON object; send one.")
    return value


def whole(text: str, what: str) -> int:
    """A whole number out of an address or a query."""
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise InputError(f"{what} must be a whole number, {text[:20]!r} is none.")
    return int(text)
