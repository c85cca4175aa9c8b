"""Packets of Open Sound Control 1.0, read as the specification says."""

import struct


def parse_osc(data):
    """An independent reading of OSC 1.0 packets."""

    def text(at):
        end = data.index(b"\0", at)
        return data[at:end].decode(), (end + 4) & ~3

    if data.startswith(b"#bundle\0"):
        out, at = [], 16
        while at < len(data):
            (size,) = struct.unpack_from(">i", data, at)
            out += parse_osc(data[at + 4 : at + 4 + size])
            at += 4 + size
        return out
    address, at = text(0)
    tags, at = text(at)
    values = []
    for tag in tags[1:]:
        if tag == "s":
            value, at = text(at)
        else:
            kind, size = {"i": (">i", 4), "f": (">f", 4), "d": (">d", 8)}[tag]
            (value,), at = struct.unpack_from(kind, data, at), at + size
        values.append(value)
    assert len(data) % 4 == 0 and at == len(data)
    return [(address, values)]
