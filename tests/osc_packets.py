"""Packets of Open Sound Control as python-osc reads them."""

from pythonosc.osc_packet import OscPacket


def parse_osc(data):
    """(address, values) of every message of a packet."""
    return [(m.message.address, m.message.params) for m in OscPacket(data).messages]
