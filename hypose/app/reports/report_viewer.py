"""The View screen inside a report: page, result and some pictures in one file that opens from disk.

The scripts are those that the studio's front end builds (web/src/report.ts). Where they were not built the report has
its plots and pictures only.
"""

from __future__ import annotations

import base64
import gzip
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.app.studio.view_bundle import ViewResult, view_bundle
from hypose.app.studio.view_pictures import ViewPictures
from hypose.errors import HyposeError

STATIC = Path(__file__).parents[1] / "studio" / "static"
"""Where the front end's build puts report.js and report.css."""
_PICTURES = 48
_MIN_ROWS, _MAX_ROWS = 4, 16
_WIDTH = 480


@dataclass(frozen=True)
class Viewer:
    """style: CSS; body: HTML with scripts, for the end of a page that holds an element with the id PLACE."""

    style: str
    body: str


PLACE = '<div id="hypose-viewer" class="viewer"><noscript>The view in 3D needs JavaScript.</noscript></div>'


def make_viewer(result: ViewResult, pictures: ViewPictures | None) -> Viewer | None:
    """The viewer of a result, None when the front end was not built."""
    script, style = STATIC / "report.js", STATIC / "report.css"
    if not script.is_file() or not style.is_file():
        return None
    block = base64.b64encode(gzip.compress(view_bundle(result), 6, mtime=0)).decode("ascii")
    code = script.read_text("utf-8").replace("</script", "<\\/script")
    parts = [f'<script type="text/plain" id="hypose-result">{block}</script>']
    if pictures is not None:
        stored = json.dumps(_stored(result, pictures))
        parts.append(f'<script type="application/json" id="hypose-pictures">{stored}</script>')
    parts.append(f"<script>{code}</script>")
    return Viewer(style.read_text("utf-8"), "\n".join(parts))


def stored_rows(frames: int, views: int, worst: int | None = None) -> list[int]:
    """Rows whose pictures go into a report: evenly spread, fewer when there are many views, and the worst."""
    count = min(frames, max(_MIN_ROWS, min(_MAX_ROWS, _PICTURES // max(1, views))))
    rows = set(np.linspace(0, frames - 1, count).astype(int).tolist())
    return sorted(rows | ({worst} if worst is not None else set()))


def _stored(result: ViewResult, pictures: ViewPictures) -> dict[str, object]:
    cost = result.motion.cost
    worst = int(np.nanargmax(cost)) if np.isfinite(cost).any() else None
    rows, files = [], []
    for row in stored_rows(len(result.motion), len(result.pictures), worst):
        try:
            found = pictures.files(row, _WIDTH)
        except HyposeError:
            break  # a video that ends early: what was read until then is shown
        rows.append(row)
        files.append([base64.b64encode(f).decode("ascii") for f in found])
    return {"rows": rows, "files": files}
