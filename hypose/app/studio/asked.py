"""What others send, read field by field: an object of bounded depth, and fields of a type and a range.

Every WebSocket, request and address is read by these functions; their InputErrors are sentences for the page.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from hypose.errors import InputError
from hypose.json_text import parse_json

_DEEPEST = 16
_HALF_OF_PAIR = re.compile(r"[\ud800-\udfff]")
"""JSON can say half of a pair of UTF-16, which no text, file or terminal takes."""


def object_of(data: str | bytes | bytearray, what: str) -> dict[str, Any]:
    """The JSON object of a message or request; what: how it is called in the InputError."""
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


def number(value: Any, what: str, low: float, high: float) -> float:
    """A number from low to high."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"There is no number for {what} in {_short(value)}; give {low:g} to {high:g}.")
    if not low <= value <= high:  # NaN is neither
        raise InputError(f"{_capital(what)} cannot be {value:g}; give {low:g} to {high:g}.")
    return float(value)


def whole(value: Any, what: str, low: int, high: int) -> int:
    """A whole number from low to high."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InputError(f"{_capital(what)} cannot be {_short(value)}; give a whole number from {low} to {high}.")
    return value


def text(value: Any, what: str, longest: int, advice: str) -> str:
    """A text that says something; advice: what is to be done when there is none."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"There is no {what}; {advice}.")
    if len(value) > longest:
        raise InputError(f"The {what} has {len(value)} letters; give at most {longest}.")
    return value


def choice(value: Any, what: str, allowed: Sequence[str]) -> str:
    """One of some words."""
    if not isinstance(value, str) or value not in allowed:
        words = f"{', '.join(allowed[:-1])} or {allowed[-1]}" if len(allowed) > 1 else "".join(allowed)
        raise InputError(f"There is no {what} {_short(value)}; choose {words}.")
    return value


def digits(value: str, what: str) -> int:
    """A whole number out of an address or a query: from 0, of at most nine digits."""
    if not value.isascii() or not value.isdigit() or len(value) > 9:
        raise InputError(f"{_capital(what)} must be a whole number, {_short(value)} is none.")
    return int(value)


def _short(value: Any) -> str:
    return repr(value if not isinstance(value, str) else value[:40])[:40]


def _capital(what: str) -> str:
    return what[:1].upper() + what[1:]
