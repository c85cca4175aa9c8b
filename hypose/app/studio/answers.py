"""Answers of the server: JSON in which nothing is NaN, errors as one sentence, bodies of requests within bounds."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse

from hypose.app.studio.asked import object_of
from hypose.app.studio.catalog import NotFound
from hypose.app.studio.view_bundle import plain
from hypose.errors import HyposeError, InputError

MAX_JSON = 1 << 20
_BODY_S = 30.0
"""s that a request may take from one piece of its body to the next."""
_SLICE = 1 << 18
"""Bytes of a block that are sent at once."""
Endpoint = Callable[[Request], Awaitable[Response]]


class NotNow(InputError):
    """What was asked for cannot be done in the present state."""


class TooLarge(InputError):
    """More was sent than is taken."""


class TooSlow(InputError):
    """What was announced did not come."""


def answer(value: Any, status: int = 200) -> JSONResponse:
    """JSON; numpy values become plain ones, NaN becomes null. Never kept by the browser: files change."""
    return JSONResponse(plain(value), status, headers={"Cache-Control": "no-store"})


def block_answer(block: bytes | bytearray) -> Response:
    """A block of a result (`view_bundle`). It goes slice after slice, as the page takes them: whole, it would lie twice
    more in memory on its way."""

    async def slices() -> AsyncIterator[memoryview]:
        for at in range(0, len(block), _SLICE):
            yield memoryview(block)[at : at + _SLICE]

    headers = {"Cache-Control": "no-store", "Content-Length": str(len(block))}
    return StreamingResponse(slices(), media_type="application/octet-stream", headers=headers)


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
        except TooSlow as error:
            return refusal(408, str(error))
        except TooLarge as error:
            return refusal(413, str(error))
        except HyposeError as error:
            return refusal(400, str(error))

    return guarded


async def body_of(request: Request) -> dict[str, Any]:
    """The JSON object of a request."""
    data = bytearray()
    async for chunk in pieces_of(request):
        data += chunk
        if len(data) > MAX_JSON:
            raise TooLarge(f"The request is larger than {MAX_JSON >> 20} MiB; send less at once.")
    return object_of(data or b"{}", "request")


async def pieces_of(request: Request) -> AsyncIterator[bytes]:
    """The body of a request, piece after piece; TooSlow when one does not come, InputError when it breaks off."""
    pieces = aiter(request.stream())
    while True:
        try:
            async with asyncio.timeout(_BODY_S):
                piece = await anext(pieces)
        except StopAsyncIteration:
            return
        except ClientDisconnect:
            raise InputError("The request broke off; send it again.") from None
        except TimeoutError:
            raise TooSlow(f"Nothing came of the request's body for {_BODY_S:.0f} s; send it again.") from None
        yield piece
