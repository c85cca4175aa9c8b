"""Write report.html: one file that shows how a run went, with all pictures inside."""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hypose import __version__
from hypose.app.reports.report_parts import html_list, html_table, page, picture_of, subject_rows, summarize
from hypose.app.reports.result_pictures import OverlayRows, PictureRows, Shown, jpeg, still_rows, write_overlay
from hypose.app.studio.view_bundle import ViewResult, gait_values, view_bundle
from hypose.body.motion import sd_per_axis
from hypose.io.files import write_text
from hypose.io.motions.results import json_values, to_json
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.pipeline.assessment import GOOD, UNTRUSTED

_STATIC = Path(__file__).parents[1] / "studio" / "static"
"""Folder in which the front end's build puts report.js and report.css, which show the result in 3D and its
curves; without them a report has figures and pictures only.
"""
PLACE = '<div id="hypose-viewer" class="viewer"><noscript>The view in 3D needs JavaScript.</noscript></div>'
_PICTURES, _MIN_ROWS, _MAX_ROWS = 48, 4, 16  # of the viewer


def write_report(path: Path, result: ViewResult) -> Path:
    """Write the report of a result, with pictures of its recording where there are any; return its path."""
    write_text(path, report_html(result, drawn_of(result)))
    return path


def drawn_of(result: ViewResult) -> OverlayRows:
    """Draw the pictures for a report of a result; there are none without a recording."""
    motion, body, wanted = result.motion, result.body, picture_rows(result, False)
    if (recording := result.recording) is None:
        return OverlayRows()
    if body is None or motion.poses is None:
        wanted = replace(wanted, stills=())
    frames = range(result.first_frame, result.first_frame + len(motion))
    recording = replace(recording, frame_range=(frames.start, frames.stop))
    settings = motion.provenance.get("settings")
    masks = wanted.stills and not (isinstance(settings, Mapping) and settings.get("evidence") == "keypoints")
    with FrameStream(recording, None if masks else FrameSettings(masks=False)) as stream:
        return write_overlay("", recording, stream, [Shown("", motion, body)], wanted)


def picture_rows(result: ViewResult, video: bool) -> PictureRows:
    """Select the rows of a result whose pictures are drawn for its report.

    video: all rows are drawn for the overlay as well.
    Returns: rows of the close-ups (four spread evenly, and the one with the worst fit), and rows of the small pictures
        in the viewer: up to 16, fewer with many views, none where the viewer was not built.
    """
    small: Sequence[int] = ()
    count = 0 if result.recording is None else sum(view.has_pictures for view in result.recording.views)
    if _built() and count:
        small = still_rows(result.motion, max(_MIN_ROWS, min(_MAX_ROWS, _PICTURES // count)))
    return PictureRows(video, still_rows(result.motion), small)


def _built() -> bool:
    return (_STATIC / "report.js").is_file() and (_STATIC / "report.css").is_file()


def report_html(result: ViewResult, drawn: OverlayRows | None = None) -> str:
    """Build the HTML of a result's report: title and figures, the 3D viewer where it was built, and below it the
    parts that need no script.

    drawn: pictures; None: none.
    """
    drawn = drawn or OverlayRows()
    gait = gait_values(result.motion, result.body)
    top, text = _head(result) + _cards(result), _text(result, drawn, gait)
    if not _built():
        return page(result.title, top + text)
    place = f'</div><div class="wide">{PLACE}</div><div class="report">'
    block = base64.b64encode(gzip.compress(view_bundle(result), 6, mtime=0)).decode("ascii")
    scripts = [f'<script type="text/plain" id="hypose-result">{block}</script>']
    if drawn.small:
        files = [[base64.b64encode(f).decode("ascii") for f in views] for views in drawn.small.values()]
        stored = json.dumps({"rows": list(drawn.small), "files": files})
        scripts.append(f'<script type="application/json" id="hypose-pictures">{stored}</script>')
    if gait["figures"]:
        stored = json.dumps(json_values(gait))
        scripts.append(f'<script type="application/json" id="hypose-gait">{stored}</script>')
    code = (_STATIC / "report.js").read_text("utf-8").replace("</script", "<\\/script")
    scripts.append(f"<script>{code}</script>")
    style = (_STATIC / "report.css").read_text("utf-8")
    return page(result.title, top + place + text, f"<style>{style}</style>", "\n".join(scripts))


def _text(what: ViewResult, drawn: OverlayRows, gait: Mapping[str, Any]) -> str:
    m = what.motion
    parts = [""]
    if not what.complete:
        parts.append('<p class="bad">The run was interrupted: this is what was tracked until then.</p>')
    if what.notes:
        parts.append("<h2>Notes</h2>" + html_list(what.notes))
    if what.truth is not None:
        text = f"The recording is synthetic, so the truth is known: {what.truth.mean_mm:.1f} mm mean distance over "
        text += f"{len(what.truth.names)} joints. {what.truth.note}"
        parts.append(f"<h2>Distance to the truth</h2><p>{html.escape(text)}</p>")
    if drawn.stills:
        parts.append("<h2>Pictures</h2>")
        for row, picture in drawn.stills.items():
            parts.append(picture_of(jpeg(picture, 1280, 85), "jpeg", f"Frame {what.first_frame + row}"))
        parts.append(
            '<p class="dim">Tinted: the body. Pink line: edge of the mask. Orange: left limbs, blue: right limbs.</p>'
        )
    if not np.isfinite(m.cost).any():
        parts.append("<p>No silhouettes were used, so that there is no overlap of body and masks.</p>")
    if m.systematic_covariance is not None and np.isfinite(m.joint_sd).any():
        lasting = 1000 * float(np.nanmedian(sd_per_axis(m.systematic_covariance)))
        parts.append(
            f"<p>Of the joints' standard deviation per axis, {lasting:.1f} mm (median) would remain with more frames "
            "and views like these: where the joint is defined to be, errors common to all views, the calibration.</p>"
        )
    parts.append(gait_section(gait))
    if what.body is not None:
        sizes = html_table(((html.escape(n), f"{v:.3f} m") for n, v in subject_rows(what.body)), (), (1,))
        parts.append(f'<h2>Subject</h2>{sizes}<p class="dim">Between joint centres; limbs: mean of both sides.</p>')
    if what.files:
        parts.append("<h2>Files</h2>" + html_table((html.escape(n), html.escape(t)) for n, t, _ in what.files))
    parts.append(_origin(what))
    return "\n".join(parts)


def _head(what: ViewResult) -> str:
    """Build the title, the assessment as a coloured sentence, and a line with recipe and version."""
    recipe, a = str(what.motion.provenance.get("recipe", "unknown")), what.assessment
    tone = "" if a is None else {GOOD: "good", UNTRUSTED: "bad"}.get(a.word, "")
    return (
        f"<h1>{html.escape(what.title)}</h1>"
        + (f'<p class="{tone}">{html.escape(a.sentence)}</p>' if a is not None else "")
        + f'<p class="dim">recipe {html.escape(recipe)} · hypose {__version__}</p>'
    )


def _cards(what: ViewResult) -> str:
    """Build the figures of the result, each with its usual value."""
    s = summarize(what.motion)
    cards = [
        (f"{s.frames}", f"frames, {s.seconds:.1f} s"),
        *([] if what.recording is None else [(str(len(what.recording.rig)), "views")]),
        (f"{s.lost}", "frames lost (a good clip: none)"),
        (f"{s.extrapolated}", "frames extrapolated (a good clip: none)"),
    ]
    if np.isfinite(s.iou):
        cards.append((f"{s.iou:.3f}", f"mean IoU (.85 and more is usual for a good fit; worst {s.worst_iou:.2f})"))
    if np.isfinite(s.sd_mm):
        cards.append((f"{s.sd_mm:.1f} mm", "median joint sd (90 % of joints are within 2.5 of theirs)"))
    if what.truth is not None:
        cards.append((f"{what.truth.mean_mm:.1f} mm", "mean joint error"))
    if what.seconds.get("track"):
        cards.append((f"{s.frames / what.seconds['track']:.1f}", "frames/s tracked"))
    return (
        '<div class="cards">'
        + "".join(f'<div class="card"><b>{a}</b><span>{html.escape(b)}</span></div>' for a, b in cards)
        + "</div>"
    )


def gait_section(gait: Mapping[str, Any]) -> str:
    """Build the HTML of the gait: means with intervals.

    gait: result of `gait_values`.
    Returns: "" where the person does not walk two steps.
    """
    if not gait["figures"]:
        return ""
    rows = [
        (name.replace("_", " "), f"{mean:.3g} {html.escape(unit)}", f"{low:.3g} to {high:.3g}", str(n))
        for name, unit, mean, _, low, high, n in (f.values() for f in gait["figures"])
    ]
    return "<h2>Gait</h2>" + html_table(rows, ("", "mean", "with 90 %", "n"), range(1, 4))


def _origin(what: ViewResult) -> str:
    out = "<h2>How this was made</h2>"
    if what.citation:
        out += f"<p>Method: {html.escape(what.citation)}</p>"
    if what.seconds:
        table = html_table(((html.escape(k), f"{v:.1f} s") for k, v in what.seconds.items()), (), (1,))
        out += f"<details><summary>Time per stage</summary>{table}</details>"
    # the trace of joints that passes moved is on the viewer's line of time, and `hypose explain` prints it
    record = {k: v for k, v in what.motion.provenance.items() if k != "trace"}
    title = "Provenance: settings, versions, inputs with their hashes"
    return out + f"<details><summary>{title}</summary><pre>{html.escape(to_json(record))}</pre></details>"
