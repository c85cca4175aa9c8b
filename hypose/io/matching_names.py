"""Names of views, cameras, files and folders that mean the same camera."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any


def match_names(wanted: Sequence[str], available: Sequence[str]) -> list[int | None]:
    """Index in `available` for each wanted name: the same name; else the same letters and digits without
    decoration (cam01_json, ext_cam01_img, Cam-01); else the only one with the same number. None where nothing
    fits uniquely."""

    def unique(key: Any) -> list[int | None]:
        keys = [key(a) for a in available]
        counts = [key(w) for w in wanted]
        return [
            keys.index(k) if k not in (None, "") and keys.count(k) == 1 and counts.count(k) == 1 else None
            for k in counts
        ]

    out: list[int | None] = [None] * len(wanted)
    for key in (lambda n: n, _bare, _number):
        for i, found in enumerate(unique(key)):
            if out[i] is None and found is not None and found not in out:
                out[i] = found
    return out


def _bare(name: str) -> str:
    return "".join(c for c in re.sub(r"(^(ext|int)_|_(json|img|imgs|ext)$)", "", name.lower()) if c.isalnum())


def _number(name: str) -> int | None:
    """The last number of a name (cam_01 -> 1, trial2_cam03 -> 3)."""
    numbers = re.findall(r"\d+", name)
    return int(numbers[-1]) if numbers else None
