"""JSON from elsewhere: its numbers may be anything."""

from __future__ import annotations

import json
from typing import Any


def parse_json(text: str | bytes | bytearray) -> Any:
    """What json.loads gives, but integers beyond 64 bits are floats, infinite beyond 1.8e308, as 1e999 is in JSON: a
    number nobody means must not overflow where it is counted with. ValueError or RecursionError, as json.loads."""
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
