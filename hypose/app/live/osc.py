"""Send poses and events by Open Sound Control 1.0, in bundles that fit one packet, and poses to programs that move an
avatar by the VMC protocol, which is made of such messages.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from hypose.body.body import Body
from hypose.body.joint_angles import neutral_frames
from hypose.errors import InputError
from hypose.geometry import Array, quaternion_from_matrix, so3_exp, so3_log
from hypose.io.motions.animation import Y_UP

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


# ---- vmc -----------------------------------------------------------------------------------------------------------
# Bones of a VRM humanoid as OSC messages. At rest an avatar stands in a T pose (arms level, palms down). A rotation of
# one of our joints that two bones share (trunk, neck) is divided between them; hands, toes and fingers do not move. The
# protocol uses Unity's axes: left-handed, x right, y up, z forwards; in VRM x points left.
#
# Sources: VRM Consortium, VRMC_vrm 1.0 (bones and their parents); VMC protocol 2.7 (protocol.vmc.info).


_VRM_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from x left, y backwards, z up
_TRUNK = (
    ("Hips", "", "pelvis", "pelvis", "", 1.0),
    ("Spine", "Hips", "spine", "chest", "pelvis", 1 / 3),
    ("Chest", "Spine", "chest", "chest", "pelvis", 2 / 3),
    ("Neck", "Chest", "neck", "head", "chest", 1 / 2),
    ("Head", "Neck", "head", "head", "chest", 1 / 2),
)
_LIMBS = (
    ("{S}Shoulder", "Chest", "{s}_clavicle", "{s}_clavicle", "chest", 1.0),
    ("{S}UpperArm", "{S}Shoulder", "{s}_shoulder", "{s}_shoulder", "{s}_clavicle", 1.0),
    ("{S}LowerArm", "{S}UpperArm", "{s}_elbow", "{s}_elbow", "{s}_shoulder", 1.0),
    ("{S}Hand", "{S}LowerArm", "{s}_wrist", "{s}_wrist", "{s}_elbow", 0.0),
    ("{S}UpperLeg", "Hips", "{s}_hip", "{s}_hip", "pelvis", 1.0),
    ("{S}LowerLeg", "{S}UpperLeg", "{s}_knee", "{s}_knee", "{s}_hip", 1.0),
    ("{S}Foot", "{S}LowerLeg", "{s}_ankle", "{s}_ankle", "{s}_knee", 1.0),
)
_SIDED = [
    (*(text.format(S=side, s=side.lower()) for text in row[:5]), row[5]) for side in ("Left", "Right") for row in _LIMBS
]
VMC_BONES: tuple[tuple[Any, ...], ...] = (*_TRUNK, *_SIDED)
"""Bones, parents first: name; parent; our joint that gives its position; our joint that rotates it; our joint relative
to which that rotation counts; the bone's share of the rotation.
"""


def vmc_messages(body: Body, pose: Array, seconds: float, tracked: bool) -> list[OscMessage]:
    """Build the messages of one frame.

    pose: (D,) pose of the body.
    seconds: since the sender began, s.
    tracked: the person was seen in this frame; False: the pose is only a guess.

    The root stays at the origin; the hips carry position and rotation.
    """
    skeleton, names = body.skeleton, body.skeleton.joint_names
    frames = dict(neutral_frames(skeleton))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        level = so3_exp(np.array([0.0, sign * np.pi / 2, 0.0]))  # the hanging arm lifted sideways
        for joint in ("shoulder", "elbow", "wrist"):
            frames[f"{side}_{joint}"] = level @ frames[f"{side}_{joint}"]
    rest = {name: _VRM_AXES @ frame for name, frame in frames.items()}
    places = np.zeros((len(names), 3))
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            places[j] = places[parent] + rest[names[parent]] @ skeleton.rest_offsets[j]
    at = {name: places[skeleton.joint(joint)] for name, _, joint, *_ in VMC_BONES}
    rotations, joints = (a[0] for a in skeleton.forward(pose[None]))
    world = {name: rotations[skeleton.joint(name)] @ frame.T for name, frame in rest.items()}
    bones = []
    for name, above, _, joint, against, share in VMC_BONES:
        offset = at[name] - at[above] if above else Y_UP @ joints[skeleton.joint("pelvis")]
        turn = world[against].T @ world[joint] if against else Y_UP @ world[joint]
        w, x, y, z = quaternion_from_matrix(turn if share == 1 else so3_exp(share * so3_log(turn)))
        values = (*(offset * [-1, 1, 1]).tolist(), float(x), -float(y), -float(z), float(w))
        bones.append(osc_message("/VMC/Ext/Bone/Pos", name, *values))
    root = osc_message("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    calibrated = 3
    ok = osc_message("/VMC/Ext/OK", 1, calibrated, 0, int(tracked))
    return [ok, osc_message("/VMC/Ext/T", float(seconds)), root, *bones]
