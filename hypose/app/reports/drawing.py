"""The last step of every tracking job: overlay.mp4 and report.html."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hypose.app.commands.console import ProgressCall
from hypose.app.reports.overlay import still_rows
from hypose.app.reports.report import ReportInput, write_report
from hypose.app.reports.result_pictures import Image
from hypose.app.reports.summary import DESCRIPTIONS
from hypose.io.motions.results import ResultsFolder

OverlayCall = Callable[[Path, Sequence[int]], Mapping[int, Image]]
"""Draws the motion to a path (when a film is wanted), and returns the pictures of the given rows."""


def draw(
    results: ResultsFolder,
    about: ReportInput,
    overlay: OverlayCall,
    written: Sequence[Path],
    *,
    video: bool,
    caption: str = "Frame {}",
    progress: ProgressCall,
) -> list[Path]:
    """Overlay and report of a finished motion; returns their paths. about: the report but for its stills and files;
    written: the files there are already; video: overlay.mp4 is wanted; caption: of a still, {} its frame's number."""
    rows = still_rows(about.motion)
    path, report = results.file("overlay.mp4"), results.file("report.html")
    stills = overlay(path, rows)
    out = [path] if video else []
    progress("report", 0, 1)
    files = [(p.name, DESCRIPTIONS.get(p.name, "")) for p in [*written, *out, report]]
    shown = [(caption.format(about.first_frame + r), stills[r]) for r in rows]
    write_report(report, replace(about, stills=shown, files=files))
    progress("report", 1, 1)
    return [*out, report]
