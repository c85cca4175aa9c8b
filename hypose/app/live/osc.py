"""Open Sound Control 1.0, as much as is sent: messages of integers, floats, doubles and text, in bundles."""

from __future__ import annotations

import struct
from collections.abc import Sequence

MAX_BUNDLE = 1400
"""Bytes: fits one Ethernet packet."""


def osc_message(address: str, *values: int | float | str | bytes) -> bytes:
    """One message: int -> i, float -> f, str -> s, bytes of length 8 -> d (see `double`)."""
    tags, data = ",", b""
    for v in values:
        if isinstance(v, bytes):
            tags, data = tags + "d", data + v
        elif isinstance(v, str):
            tags, data = tags + "s", data + _text(v)
        elif isinstance(v, int):
            tags, data = tags + "i", data + struct.pack(">i", v)
        else:
            tags, data = tags + "f", data + struct.pack(">f", v)
    return _text(address) + _text(tags) + data


def double(value: float) -> bytes:
    """A 64-bit float for `osc_message`: times do not fit 32 bits."""
    return struct.pack(">d", value)


def osc_bundles(messages: Sequence[bytes]) -> list[bytes]:
    """Messages in as few bundles (to be handled at once) as packets of 1400 bytes allow."""
    head = b"#bundle\0" + struct.pack(">Q", 1)
    out, now = [], head
    for m in messages:
        if len(now) + 4 + len(m) > MAX_BUNDLE and now != head:
            out.append(now)
            now = head
        now += struct.pack(">i", len(m)) + m
    return [*out, now] if now != head else out


def _text(text: str) -> bytes:
    data = text.encode("utf-8") + b"\0"
    return data + b"\0" * (-len(data) % 4)
