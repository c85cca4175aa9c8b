"""Safe parsing of JSON that other programs wrote."""

from __future__ import annotations

import json
from typing import Any


def parse_json(text: str | bytes | bytearray) -> Any:
    """Parse JSON as json.loads does, but read integers beyond 64 bits as floats.

    Floats beyond 1.8e308, such as 1e999, become infinite.

    Raises: ValueError or RecursionError, as json.loads does.
    Why: larger integers would overflow in later arithmetic.
    """
    return json.loads(text, parse_int=_integer)


def _integer(digits: str) -> int | float:
    value = int(digits) if len(digits) <= 20 else None
    return value if value is not None and -(2**63) <= value < 2**63 else float(digits)


def is_plain(value: Any) -> bool:
    """Test whether a value stays the same when it is written as JSON and read back."""
    try:
        return json.loads(json.dumps(value)) == value
    except (TypeError, ValueError, RecursionError):
        return False
