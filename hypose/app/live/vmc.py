"""Poses for programs that move an avatar, by the VMC protocol: bones of a VRM humanoid as OSC messages.

Bones, T pose and divided turns are those of hypose.app.live.humanoid_bones. The protocol speaks Unity's
axes: left-handed, x right, y up, z forwards. The root stays at the origin; the hips carry place and turn.

Source: VMC protocol specification, what a Performer sends to a Marionette (protocol.vmc.info), version 2.7.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from pythonosc.osc_message import OscMessage

from hypose.app.live.humanoid_bones import BONES, bone_turns, rest_offsets
from hypose.app.live.osc import osc_message
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.geometry import Array, quaternion_from_matrix

_NAMES = [name[0].upper() + name[1:] for name in BONES]
_CALIBRATED = 3


def vmc_messages(offsets: Array, turns: Array, seconds: float, tracked: bool) -> list[OscMessage]:
    """One frame. offsets (B, 3) m from each bone's parent to it, of the hips from the origin; turns (B, 3, 3) against
    the parent; both in VRM's axes (x left, y up, z forwards) and the order of BONES. seconds: since the sender began;
    tracked: somebody was seen in this frame, else the pose is one held."""
    quaternions = quaternion_from_matrix(turns) * [1, 1, -1, -1]  # w x y z, x to the other side
    values = np.concatenate([offsets * [-1, 1, 1], quaternions[:, [1, 2, 3, 0]]], 1).tolist()
    bones = [osc_message("/VMC/Ext/Bone/Pos", name, *row) for name, row in zip(_NAMES, values, strict=True)]
    return [
        osc_message("/VMC/Ext/OK", 1, _CALIBRATED, 0, int(tracked)),
        osc_message("/VMC/Ext/T", float(seconds)),
        osc_message("/VMC/Ext/Root/Pos", "root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        *bones,
    ]


def play_motion(
    motion: Motion,
    body: Body,
    send: Callable[[list[OscMessage]], None],
    speed: float = 1.0,
    loop: bool = False,
    wait: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Send a motion with poses at its own pace times `speed`, over and over with `loop`; returns the frames sent.

    Frames whose time has passed already are left out; lost frames hold the last pose and say so. wait and clock are
    those of tests. An InputError when no frame has a pose."""
    if motion.poses is None or not (good := np.isfinite(motion.poses).all(1)).any():
        raise InputError("The motion has no poses, which an avatar needs; play a result of hypose track.")
    filled = motion.poses[np.maximum.accumulate(np.where(good, np.arange(len(motion)), int(good.argmax())))]
    hips, turns = bone_turns(motion.skeleton, filled)
    offsets = rest_offsets(body)
    tracked = good & ~motion.lost.astype(bool)
    due = (motion.times - motion.times[0]) / speed
    length = float(due[-1]) + 1 / (motion.frame_rate * speed)
    begin, n, sent = clock(), 0, 0
    while loop or n < len(motion):
        late = clock() - begin - (n // len(motion)) * length
        k = n % len(motion)
        if late < due[k]:
            wait(float(due[k]) - late)
        elif k + 1 < len(motion) and late > due[k + 1]:
            n += 1
            continue
        offsets[0] = hips[k]
        send(vmc_messages(offsets, turns[k], clock() - begin, bool(tracked[k])))
        n, sent = n + 1, sent + 1
    return sent
