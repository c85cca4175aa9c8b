"""Settings that come from a file or a user lie within bounds, or are refused in one sentence."""

from __future__ import annotations

from collections.abc import Mapping

from hypose.errors import InputError


def check(what: str, settings: object, bounds: Mapping[str, tuple[float, float]]) -> None:
    """InputError when an attribute of the settings is outside its bounds (inclusive) or no number."""
    for name, (low, high) in bounds.items():
        value = getattr(settings, name)
        if not low <= value <= high:  # NaN is not within either
            raise InputError(f"{what} {name} is {value}; it must be {low} to {high}.")
