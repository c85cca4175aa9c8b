"""How the commands declare numbers: what an option may be is said where it is declared, and refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import typer

from hypose.errors import InputError

HEIGHT = (0.4, 2.8)
"""m: of a person whom the trackers know."""
MOST_FRAMES = 10**9
LARGEST_SEED = 2**63 - 1


def number(
    text: str, least: float, most: float, *names: str, above: bool = False, unit: str = "", **more: Any
) -> typer.models.OptionInfo:
    """An option that is a number from `least` to `most`, both included (above: least itself is not). text: its help;
    unit: for the sentence that refuses others, NaN among them; names, more: as for typer.Option."""
    return typer.Option(*names, help=text, callback=_within(least, most, above, unit), **more)


def _within(
    least: float, most: float, above: bool, unit: str
) -> Callable[[typer.CallbackParam, float | None], float | None]:
    allowed = f"more than {least} and at most {most}" if above else f"{least} to {most}"
    if most in (MOST_FRAMES, LARGEST_SEED):  # which only keep numbers from overflowing later
        allowed = f"{least} or more"

    def check(param: typer.CallbackParam, value: float | None) -> float | None:
        # said as a range that a number lies in, for NaN lies in none
        if value is None or (least <= value <= most and not (above and value == least)):
            return value
        shown = f"{value:g}" if isinstance(value, float) else str(value)
        raise InputError(f"{param.opts[-1]} {shown} is not possible; give {allowed}{unit and ' ' + unit}.")

    return check


Threads = Annotated[int | None, number("Processor threads; the result does not depend on it. [default: all]", 1, 256)]
Seed = Annotated[int, number("Of every random draw; the same seed gives the same result.", 0, LARGEST_SEED)]
Seconds = Annotated[float, number("Length of the recording.", 0, 3600, above=True, unit="seconds")]
