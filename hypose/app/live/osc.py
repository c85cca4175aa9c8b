"""Open Sound Control 1.0, as much as is sent: messages of integers, floats, doubles and text, in bundles."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterable, Sequence

from hypose.errors import InputError
from hypose.geometry import Array

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


def people_osc(
    number: int,
    time: float,
    latency: float,
    people: Iterable[tuple[int, Sequence[str], Array, Array]],
    there: int,
) -> list[bytes]:
    """/hypose/frame n time latency_ms people, then /hypose/person/ID/JOINT x y z sd. time, latency s; people: id, names
    of joints (J), joints (J, 3) m, sd (J) m; there: how many of them are where they are said to be."""
    out = [osc_message("/hypose/frame", number & 0x7FFFFFFF, double(time), 1000.0 * latency, there)]
    for who, names, joints, sd in people:
        rows = zip(names, joints.tolist(), sd.tolist(), strict=True)
        out += [osc_message(f"/hypose/person/{who}/{name}", *xyz, s) for name, xyz, s in rows]
    return out


def _text(text: str) -> bytes:
    data = text.encode("utf-8") + b"\0"
    return data + b"\0" * (-len(data) % 4)


class OscTarget:
    """A UDP address, HOST:PORT, that messages are sent to. Nothing waits: what nobody takes is lost, and the next frame
    counts. An InputError when there is no such address; option: what the user gave it as."""

    def __init__(self, address: str, option: str = "--osc") -> None:
        host, colon, port = address.rpartition(":")
        try:
            if not colon or not host or not 1 <= int(port) <= 65535:
                raise ValueError
            family, kind, _, _, self._address = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)[
                0
            ]
            self._socket = socket.socket(family, kind)
        except (ValueError, OSError):
            raise InputError(
                f"{option} {address} cannot be reached; give HOST:PORT, for example 127.0.0.1:9000."
            ) from None
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):  # else what goes to all of a network is lost without a word
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, messages: Sequence[bytes]) -> None:
        """Messages of `osc_message`, in bundles."""
        for bundle in osc_bundles(messages):
            self.put(bundle)

    def put(self, datagram: bytes) -> None:
        """Bytes as they are."""
        with contextlib.suppress(OSError):  # nobody has to listen
            self._socket.sendto(datagram, self._address)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()
