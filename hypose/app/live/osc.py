"""Send poses and events by Open Sound Control 1.0, in bundles that fit one packet."""

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
    """Build one message: int -> i, float -> f, str -> s, unless `types` gives another letter for a value."""
    made = OscMessageBuilder(address)
    for k, value in enumerate(values):
        made.add_arg(value, types[k : k + 1] or None)
    return made.build()


def osc_bundles(messages: Iterable[OscMessage]) -> list[bytes]:
    """Pack messages into as few bundles (with immediate time tags) as packets of 1400 bytes allow."""
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
    """Build the messages of a frame: /hypose/frame n time latency_ms people, then /hypose/person/ID/JOINT x y z sd.

    number: number of the frame.
    time, latency: s.
    people: per person the identifier, names of joints (J), joints (J, 3) m, sd (J) m.
    there: number of people who are not lost.
    """
    out = [osc_message("/hypose/frame", number & 0x7FFFFFFF, time, 1000.0 * latency, there, types="idfi")]
    for who, names, joints, sd in people:
        rows = zip(names, joints.tolist(), sd.tolist(), strict=True)
        out += [osc_message(f"/hypose/person/{who}/{name}", *xyz, s) for name, xyz, s in rows]
    return out


class OscTarget:
    """UDP address HOST:PORT to which messages are sent; messages that are not received are lost, and nothing waits for
    them.

    option: name of the option that gave the address, for messages.
    Raises: InputError where there is no such address.
    """

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
        with contextlib.suppress(OSError):  # without it broadcasts are lost silently
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, messages: Sequence[OscMessage]) -> None:
        """Send messages in bundles of at most 1400 bytes."""
        for bundle in osc_bundles(messages):
            self.put(bundle)

    def put(self, datagram: bytes) -> None:
        """Send bytes unchanged."""
        with contextlib.suppress(OSError):  # there may be no receiver
            self._socket.sendto(datagram, self._address)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
