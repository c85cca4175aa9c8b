"""`hypose play`: a result at its own pace to a program that moves an avatar."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hypose.app.commands.console import say
from hypose.app.commands.kept_verdicts import tell_untrusted
from hypose.app.commands.options import number
from hypose.errors import InputError

if TYPE_CHECKING:
    from pythonosc.osc_message import OscMessage

    from hypose.body.body import Body
    from hypose.body.motion import Motion


def play(
    results: Annotated[Path, typer.Argument(help="Results folder of hypose track or hypose fuse, or its motion.npz.")],
    vmc: Annotated[str, typer.Option(help="HOST:PORT that the program listens on.")] = "127.0.0.1:39539",
    speed: Annotated[float, number("How many times as fast as it was.", 0.01, 100)] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Over and over, until Ctrl-C.")] = False,
) -> None:
    """Send a tracked motion to an avatar (VMC protocol): VSeeFace, Warudo, Unity, Unreal, Blender. See docs/live.md."""
    from hypose.app.live.osc import OscTarget
    from hypose.io.motions.bodies import load_result_body
    from hypose.io.motions.results import load_result
    from hypose.pipeline.posed import pose_fused

    motion = load_result(results)
    if motion.poses is None:  # of depth sensors
        body, motion = pose_fused(motion)
    else:
        motion, body = load_result_body(results)
    tell_untrusted(results)
    with contextlib.closing(OscTarget(vmc, "--vmc")) as target:
        say(f"{len(motion)} frames at {motion.frame_rate:g} Hz to {vmc}" + (", until Ctrl-C." if loop else "."))
        try:
            play_motion(motion, body, target.send, speed, loop)
        except KeyboardInterrupt:
            raise typer.Exit(130) from None


def play_motion(
    motion: Motion,
    body: Body,
    send: Callable[[list[OscMessage]], None],
    speed: float = 1.0,
    loop: bool = False,
    wait: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Send a motion with poses at its own pace times `speed`, over and over with `loop`.

    Frames whose time has passed already are left out; lost frames hold the last pose and say so. wait and clock are
    those of tests. An InputError when no frame has a pose."""
    import numpy as np

    from hypose.app.live.vmc import vmc_messages

    if motion.poses is None or not (good := np.isfinite(motion.poses).all(1)).any():
        raise InputError("The motion has no poses, which an avatar needs; play a result of hypose track.")
    held = np.maximum.accumulate(np.where(good, np.arange(len(motion)), int(good.argmax())))
    tracked = good & ~motion.lost.astype(bool)
    due = (motion.times - motion.times[0]) / speed
    length = float(due[-1]) + 1 / (motion.frame_rate * speed)
    begin, n = clock(), 0
    while loop or n < len(motion):
        late = clock() - begin - (n // len(motion)) * length
        k = n % len(motion)
        n += 1
        if late < due[k]:
            wait(float(due[k]) - late)
        elif k + 1 < len(motion) and late > due[k + 1]:
            continue
        send(vmc_messages(body, motion.poses[held[k]], clock() - begin, bool(tracked[k])))
