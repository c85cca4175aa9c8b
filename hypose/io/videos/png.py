"""What a PNG says of its own length, before a decoder believes it."""

from __future__ import annotations

import struct

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def is_cut_png(data: bytes) -> bool:
    """True for a PNG whose pieces are longer than the data. OpenCV (4.11 on) makes room for whatever length a piece
    claims: half a gigabyte for a damaged file of a kilobyte."""
    if not data.startswith(SIGNATURE):
        return False
    at, kind = len(SIGNATURE), b""
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if kind == b"IEND":
            break
    return at > len(data) or kind != b"IEND"
