"""Packets of Open Sound Control as python-osc reads them, and a port that takes packets."""

import contextlib
import socket

from pythonosc.osc_packet import OscPacket


def parse_osc(data):
    """(address, values) of every message of a packet."""
    return [(m.message.address, m.message.params) for m in OscPacket(data).messages]


@contextlib.contextmanager
def udp_sink(packets):
    """The address HOST:PORT of a UDP port of this computer; at the end the packets that came are in the list."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        sink.bind(("127.0.0.1", 0))
        sink.setblocking(False)
        yield f"127.0.0.1:{sink.getsockname()[1]}"
        with contextlib.suppress(BlockingIOError):
            while True:
                packets.append(sink.recv(65536))
