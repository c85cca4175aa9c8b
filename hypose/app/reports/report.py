"""report.html: one file that tells how a run went; pictures and plots are inside, nothing is loaded from elsewhere."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hypose import __version__
from hypose.app.jobs.truth import Truth
from hypose.app.reports import plots
from hypose.app.reports.gait_plot import gait_section
from hypose.app.reports.overlay import still_rows, write_overlay
from hypose.app.reports.report_viewer import PLACE, Viewer, make_viewer
from hypose.app.reports.result_pictures import Image
from hypose.app.reports.summary import subject_rows, summarize
from hypose.app.studio.view_bundle import Rivals, ViewResult, pictured
from hypose.app.studio.view_pictures import ViewPictures
from hypose.body.body import Body
from hypose.body.motion import Motion, sd_per_axis
from hypose.cameras.camera import CameraRig
from hypose.io.motions.results import to_json
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import Recording
from hypose.pipeline.camera_worth import camera_worth

# The colours are those of web/src/ui/theme.css, which is part of a report only where the front end was built.
_STYLE = """
:root { color-scheme: light; --bg: #eef1f4; --panel: #fff; --raised: #f3f6f8; --line: #d5dde4; --ink: #15202a;
  --dim: #566470; --bad: #b9262b; }
@media (prefers-color-scheme: dark) { :root { color-scheme: dark; --bg: #0d1115; --panel: #141a20; --raised: #1c242c;
  --line: #2a343e; --ink: #e7edf2; --dim: #9aa8b5; --bad: #ff7b7e; } }
body { margin: 0; background: var(--bg); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif; }
.report { max-width: 1080px; margin: 0 auto; padding: 24px; font-size: 15px; } .wide { padding: 0 16px; }
.report h1 { font-size: 24px; margin: 0 0 2px; }
.report h2 { font-size: 17px; margin: 34px 0 6px; padding-bottom: 4px; border-bottom: 1px solid var(--line); }
.report p { margin: 6px 0; } .dim { color: var(--dim); } .bad { color: var(--bad); font-weight: 600; }
.report .cards { display: flex; flex-wrap: wrap; gap: 10px; margin: 16px 0 0; }
.report .card { border: 1px solid var(--line); border-radius: 6px; padding: 8px 14px; min-width: 110px;
  background: var(--panel); }
.report .card b { display: block; font-size: 21px; font-weight: 600; }
.report .card span { color: var(--dim); font-size: 13px; }
.report table { border-collapse: collapse; font-size: 14px; }
.report td, .report th { padding: 3px 14px 3px 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
.report td.n { text-align: right; font-variant-numeric: tabular-nums; }
.report img, .report svg { max-width: 100%; height: auto; } .report figure { margin: 12px 0; }
.report figure svg { background: #fff; border-radius: 6px; }
.report figcaption { color: var(--dim); font-size: 13px; } .report details { margin: 8px 0; }
.report pre { background: var(--raised); padding: 10px; overflow-x: auto; font-size: 12px; }
.report .two { display: flex; flex-wrap: wrap; gap: 24px; align-items: flex-start; }
"""
# A report can load nothing, whatever is in it.
_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


@dataclass(frozen=True)
class ReportInput:
    """What a report shows. title; motion, body, rig; stills: (caption, picture BGR); files: (name, what it is); notes:
    sentences; citation of the method; seconds per stage; truth of a synthetic recording; complete: every frame was
    tracked; recording: whose pictures the viewer shows, and its first frame that belongs to the motion;
    rivals: other poses of a track with one camera."""

    title: str
    motion: Motion
    body: Body | None
    rig: CameraRig | None
    stills: Sequence[tuple[str, Image]] = ()
    files: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()
    citation: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    truth: Truth | None = None
    complete: bool = True
    recording: Recording | None = None
    first_frame: int = 0
    rivals: Rivals | None = None


def from_result(result: ViewResult, recording: Recording | None) -> ReportInput:
    """The report of a result that lies in a folder, with the recording it belongs to."""
    stills = _stills(result, recording) if recording is not None else ()
    return ReportInput(
        title=result.title,
        motion=result.motion,
        body=result.body,
        rig=result.rig,
        stills=stills,
        files=[(name, what) for name, what, _ in result.files],
        notes=result.notes,
        citation=result.citation,
        seconds=result.seconds,
        truth=result.truth,
        complete=result.complete,
        recording=recording,
        first_frame=result.first_frame,
        rivals=result.rivals,
    )


def _stills(result: ViewResult, recording: Recording) -> list[tuple[str, Image]]:
    """The stills of a result."""
    motion, body = result.motion, result.body
    if body is None or motion.poses is None:
        return []
    frames = range(result.first_frame, result.first_frame + len(motion))
    shown = replace(recording, frame_range=(frames.start, frames.stop))
    rows = still_rows(motion)
    with FrameStream(shown) as stream:
        made = write_overlay("", shown, stream, motion, body, frames=frames, stills=rows, video=False)
    return [(f"Frame {frames[r]}", made[r]) for r in rows]


def write_report(path: str | Path, what: ReportInput) -> Path:
    """Write the report whole or not at all; returns its path."""
    from hypose.io.files import write_text

    write_text(path, report_html(what))
    return Path(path)


def report_html(what: ReportInput) -> str:
    """The page."""
    viewer = _viewer(what)
    top = _head(what) + _cards(what)
    if viewer is None:
        return page(what.title, top + _text(what))
    place = f'</div><div class="wide">{PLACE}</div><div class="report">'
    return page(what.title, top + place + _text(what), viewer)


def _viewer(what: ReportInput) -> Viewer | None:
    """The View screen for this report, None when the front end was not built."""
    m, recording = what.motion, what.recording
    seen = pictured(recording) if recording is not None else []
    result = ViewResult(
        title=what.title,
        motion=m,
        body=what.body,
        rig=what.rig,
        image_shifts=[v.image_shift for v in recording.views] if recording is not None else (),
        pictures=seen,
        first_frame=what.first_frame,
        files=[(name, text, 0) for name, text in what.files],
        notes=what.notes,
        citation=what.citation,
        seconds=what.seconds,
        truth=what.truth,
        complete=what.complete,
        rivals=what.rivals,
    )
    if recording is None or not seen:
        return make_viewer(result, None)
    with closing(ViewPictures(recording, what.first_frame, len(m))) as pictures:
        return make_viewer(result, pictures)


def _text(what: ReportInput) -> str:
    """Everything below the viewer: what can be read and printed without a script."""
    m = what.motion
    parts = [""]
    if not what.complete:
        parts.append('<p class="bad">The run was interrupted: this is what was tracked until then.</p>')
    if what.notes:
        parts.append("<h2>Notes</h2><ul>" + "".join(f"<li>{html.escape(n)}</li>" for n in what.notes) + "</ul>")
    if what.truth is not None:
        text = f"The recording is synthetic, so the truth is known: {what.truth.mean_mm:.1f} mm mean distance over "
        text += f"{len(what.truth.names)} joints. {what.truth.note}"
        parts.append(f"<h2>Distance to the truth</h2><p>{html.escape(text)}</p>")
        parts.append(_figure(plots.error_plot(m, what.truth), "Left: over time. Right: mean per joint."))
    if what.stills:
        parts.append("<h2>Pictures</h2>")
        parts += [_still(caption, picture) for caption, picture in what.stills]
        parts.append(
            '<p class="dim">Tinted: the body. Pink line: edge of the mask. Orange: left limbs, blue: right limbs.</p>'
        )
    parts.append("<h2>How well the body fits the images</h2>")
    if np.isfinite(m.cost).any():
        caption = (
            "Intersection over union of the body's silhouette and the mask, mean over the views; 1 is a perfect fit."
        )
        parts.append(_figure(plots.fit_plot(m), caption))
    else:
        parts.append("<p>No silhouettes were used, so there is no overlap to show.</p>")
    if np.isfinite(m.joint_sd).any():
        caption = "Standard deviation per axis of the joints' positions as the tracker sees it, median of each region."
        if m.systematic_covariance is not None:
            lasting = 1000 * float(np.nanmedian(sd_per_axis(m.systematic_covariance)))
            caption += (
                f" Of it {lasting:.1f} mm (median) would remain with more frames and more views like these: where the "
                "joint is defined to be, errors common to all views, the calibration."
            )
        parts.append(_figure(plots.sd_plot(m), caption))
    if m.poses is not None and np.isfinite(m.poses).any():
        caption = (
            "Names and signs as in OpenSim's full-body model (Rajagopal 2016), degrees; all angles are in angles.csv."
        )
        parts.append("<h2>Joint angles</h2>" + _figure(plots.angle_plot(m), caption))
    parts.append(gait_section(m, what.body))
    parts.append('<div class="two"><div><h2>Seen from above</h2>')
    parts.append(_figure(plots.top_view_plot(m, what.rig or (), what.truth), "Metres; cameras are squares.") + "</div>")
    parts.append(f"<div><h2>Subject</h2>{_subject(what.body)}</div></div>" if what.body is not None else "</div>")
    if what.rig is not None:
        parts.append(_cameras(m, what.rig))
    if what.files:
        rows = "".join(f"<tr><td>{html.escape(n)}</td><td>{html.escape(t)}</td></tr>" for n, t in what.files)
        parts.append(f"<h2>Files</h2><table>{rows}</table>")
    parts.append(_origin(what))
    return "\n".join(parts)


def page(title: str, body: str, viewer: Viewer | None = None) -> str:
    """An HTML page of the reports' looks; `body` is HTML, the title plain text. With a viewer `body` holds its
    place."""
    style, scripts = (f"<style>{viewer.style}</style>", viewer.body) if viewer is not None else ("", "")
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">'
        f"<style>{_STYLE}</style>{style}</head>\n"
        f'<body>\n<div class="report">{body}\n</div>\n{scripts}</body></html>\n'
    )


def _head(what: ReportInput) -> str:
    recipe = str(what.motion.provenance.get("recipe", "unknown"))
    return (
        f"<h1>{html.escape(what.title)}</h1>"
        f'<p class="dim">recipe {html.escape(recipe)} · hypose {html.escape(__version__)}</p>'
    )


def _cards(what: ReportInput) -> str:
    s = summarize(what.motion)
    cards = [(f"{s.frames}", f"frames, {s.seconds:.1f} s")]
    if what.rig is not None:
        cards.append((str(len(what.rig)), "views"))
    cards.append((f"{s.lost}", "frames lost"))
    cards.append((f"{s.extrapolated}", "frames extrapolated"))
    if np.isfinite(s.iou):
        cards.append((f"{s.iou:.3f}", f"mean IoU (worst {s.worst_iou:.2f})"))
    if np.isfinite(s.sd_mm):
        cards.append((f"{s.sd_mm:.1f} mm", "median joint sd"))
    if what.truth is not None:
        cards.append((f"{what.truth.mean_mm:.1f} mm", "mean joint error"))
    if what.seconds.get("track"):
        cards.append((f"{s.frames / what.seconds['track']:.1f}", "frames/s tracked"))
    return '<div class="cards">' + "".join(_card(a, b) for a, b in cards) + "</div>"


def _card(value: str, label: str) -> str:
    return f'<div class="card"><b>{html.escape(value)}</b><span>{html.escape(label)}</span></div>'


def _figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"


def _still(caption: str, picture: Image) -> str:
    h, w = picture.shape[:2]
    if w > 1280:
        picture = np.asarray(cv2.resize(picture, (1280, round(h * 1280 / w)), interpolation=cv2.INTER_AREA), np.uint8)
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
    text = base64.b64encode(data).decode("ascii")
    alt = html.escape(caption)
    return f'<figure><img alt="{alt}" src="data:image/jpeg;base64,{text}"><figcaption>{alt}</figcaption></figure>'


def _subject(body: Body) -> str:
    cells = "".join(f'<tr><td>{html.escape(n)}</td><td class="n">{v:.3f} m</td></tr>' for n, v in subject_rows(body))
    return f'<table>{cells}</table><p class="dim">Between joint centres; limbs: mean of both sides.</p>'


def _cameras(motion: Motion, rig: CameraRig) -> str:
    """What each camera adds; "" of one camera."""
    worth, best = camera_worth(motion, rig)
    if best is None:
        return ""
    rows = "".join(
        f'<tr><td>{html.escape(w.name)}</td><td class="n">x {w.times:.2f}</td><td class="n">{w.thin:.0%}</td></tr>'
        for w in worth
    )
    head = "<tr><th>without</th><th>standard deviations</th><th>joints with fewer than two left</th></tr>"
    text = "Standard deviations are geometry: where the cameras stand and what is in their pictures; limbs that cover "
    x, y, z = best.place.tolist()
    text += (
        f"each other are not counted. One more camera would help most at x = {x:.1f} m, y = {y:.1f} m, {z:.1f} m high: "
    )
    text += f"x {best.times:.2f}."
    return f'<h2>What each camera adds</h2><table>{head}{rows}</table><p class="dim">{html.escape(text)}</p>'


def _origin(what: ReportInput) -> str:
    record: dict[str, Any] = dict(what.motion.provenance)
    out = "<h2>How this was made</h2>"
    if what.citation:
        out += f"<p>Method: {html.escape(what.citation)}</p>"
    if what.seconds:
        rows = "".join(
            f'<tr><td>{html.escape(k)}</td><td class="n">{v:.1f} s</td></tr>' for k, v in what.seconds.items()
        )
        out += f"<details><summary>Time per stage</summary><table>{rows}</table></details>"
    text = html.escape(to_json(record))
    title = "Provenance: settings, versions, inputs with their hashes"
    return out + f"<details><summary>{title}</summary><pre>{text}</pre></details>"
