"""Poses and events by Open Sound Control 1.0, in bundles that fit a packet."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterable, Sequence

from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from hypose.errors import InputError
from hypose.geometry import Array

MAX_BUNDLE = 1400  # bytes: fits one Ethernet packet


def osc_message(address: str, *values: int | float | str, types: str = "") -> OscMessage:
    """One message: int -> i, float -> f, str -> s where types, one letter a value, does not say otherwise."""
    made = OscMessageBuilder(address)
    for k, value in enumerate(values):
        made.add_arg(value, types[k : k + 1] or None)
    return made.build()


def osc_bundles(messages: Iterable[OscMessage]) -> list[bytes]:
    """Messages in as few bundles (to be handled at once) as packets of 1400 bytes allow."""
    made, size = list[OscBundleBuilder](), MAX_BUNDLE
    for m in messages:
        if size + 4 + m.size > MAX_BUNDLE:
            made, size = [*made, OscBundleBuilder(IMMEDIATELY)], 16
        made[-1].add_content(m)
        size += 4 + m.size
    return [b.build().dgram for b in made]


def people_osc(
    number: int, time: float, latency: float, people: Iterable[tuple[int, Sequence[str], Array, Array]], there: int
) -> list[OscMessage]:
    """/hypose/frame n time latency_ms people, then /hypose/person/ID/JOINT x y z sd. time, latency s; people: id, names
    of joints (J), joints (J, 3) m, sd (J) m; there: how many of them are where they are said to be."""
    out = [osc_message("/hypose/frame", number & 0x7FFFFFFF, time, 1000.0 * latency, there, types="idfi")]
    for who, names, joints, sd in people:
        rows = zip(names, joints.tolist(), sd.tolist(), strict=True)
        out += [osc_message(f"/hypose/person/{who}/{name}", *xyz, s) for name, xyz, s in rows]
    return out


class OscTarget:
    """A UDP address, HOST:PORT, that messages are sent to. Nothing waits: what no one takes is lost, and the next frame
    counts. An InputError when there is no such address; option: what the user gave it as."""

    def __init__(self, address: str, option: str = "--osc") -> None:
        host, colon, port = address.rpartition(":")
        try:
            if not colon or not host or not 1 <= int(port) <= 65535:
                raise ValueError
            where = host.strip("[]"), int(port)
            (family, kind, _, _, self._address), *_ = socket.getaddrinfo(*where, 0, socket.SOCK_DGRAM)
            self._socket = socket.socket(family, kind)
        except (ValueError, OSError):
            raise InputError(f"{option} {address} cannot be reached; give HOST:PORT, as 127.0.0.1:9000.") from None
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):  # else what goes to all of a network is lost without a word
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, messages: Sequence[OscMessage]) -> None:
        """Messages, in bundles."""
        for bundle in osc_bundles(messages):
            self.put(bundle)

    def put(self, datagram: bytes) -> None:
        """Bytes as they are."""
        with contextlib.suppress(OSError):  # no one has to listen
            self._socket.sendto(datagram, self._address)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()
