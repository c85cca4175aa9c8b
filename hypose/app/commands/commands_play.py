"""`hypose play`: a result at its own pace to a program that moves an avatar."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hypose.app.commands.console import say
from hypose.app.commands.kept_verdicts import tell_untrusted
from hypose.app.commands.options import number


def play(
    results: Annotated[Path, typer.Argument(help="Results folder of hypose track or hypose fuse, or its motion.npz.")],
    vmc: Annotated[str, typer.Option(help="HOST:PORT that the program listens on.")] = "127.0.0.1:39539",
    speed: Annotated[float, number("How many times as fast as it was.", 0.01, 100)] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Over and over, until Ctrl-C.")] = False,
) -> None:
    """Send a tracked motion to an avatar (VMC protocol): VSeeFace, Warudo, Unity, Unreal, Blender. See docs/live.md."""
    from hypose.app.live.osc import OscTarget
    from hypose.app.live.vmc import play_motion
    from hypose.io.motions.results import load_result, load_result_body
    from hypose.pipeline.posed import pose_fused

    motion = load_result(results)
    if motion.poses is None:  # of depth sensors
        body, motion = pose_fused(motion)
    else:
        motion, body = load_result_body(results)
    tell_untrusted(results)
    target = OscTarget(vmc, "--vmc")
    say(f"{len(motion)} frames at {motion.frame_rate:g} Hz to {vmc}" + (", until Ctrl-C." if loop else "."))
    try:
        play_motion(motion, body, target.send, speed, loop)
    except KeyboardInterrupt:
        raise typer.Exit(130) from None
    finally:
        target.close()
