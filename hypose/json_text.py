"""JSON from elsewhere: its numbers may be anything."""

from __future__ import annotations

import json
from typing import Any


def parse_json(text: str | bytes | bytearray) -> Any:
    """Parse JSON as json.loads does, but read integers beyond 64 bits as floats, infinite beyond 1.8e308, as 1e999 is:
    they must not overflow in later arithmetic. ValueError or RecursionError, as json.loads."""
    return json.loads(text, parse_int=_integer)


def _integer(digits: str) -> int | float:
    value = int(digits) if len(digits) <= 20 else None
    return value if value is not None and -(2**63) <= value < 2**63 else float(digits)


def is_plain(value: Any) -> bool:
    """Whether a value can be written as JSON and read back the same."""
    try:
        return json.loads(json.dumps(value)) == value
    except (TypeError, ValueError, RecursionError):
        return False
