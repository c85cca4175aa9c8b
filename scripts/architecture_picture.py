"""Draw docs/images/architecture.svg: the stages of `hypose track` from top to bottom, and the rooms each imports from.

Stages and their captions are listed here in the order of the data; which rooms a stage uses is read from its imports.
"""

from __future__ import annotations

from html import escape

import grimp

STAGES = (
    ("hypose.io.recordings.recording", "read recording.toml and calibration"),
    ("hypose.io.recordings.frames", "decode videos; masks, key points: Frame"),
    ("hypose.pipeline.input_checks", "check the inputs"),
    ("hypose.pipeline.first_frame", "find body and start pose: TrackedSubject"),
    ("hypose.tracking.tracker", "track frame by frame: FrameEstimate"),
    ("hypose.pipeline.left_right", "pass: exchanged sides, tracked again"),
    ("hypose.pipeline.backward_pass", "pass: lost arms, backwards"),
    ("hypose.tracking.smooth_motion", "pass: solve all frames together: Motion"),
    ("hypose.pipeline.frame_anomalies", "mark repeated and jumping pictures"),
    ("hypose.tracking.error_model", "probability that a joint is wrong"),
    ("hypose.tracking.covariance_calibration", "standard deviations that hold"),
    ("hypose.pipeline.assessment", "verdict and its reasons"),
    ("hypose.io.motions.export", "write motion files"),
)
ROOMS = ("io", "evidence", "calibration", "tracking", "inference", "fitting", "body", "cameras", "compute")
"""Rooms in the picture's columns; errors, geometry and json_text are used nearly everywhere."""

_ROW, _TOP, _BOX, _LEFT, _STEP = 46, 96, 330, 16, 46
_STYLE = """
text { font-family: system-ui, sans-serif; font-size: 13px; fill: #1f2733 }
.small { font-size: 11px; fill: #566273 } .back { fill: #ffffff } .box { fill: #e3f1ef; stroke: #2b8a80 }
.line { stroke: #8a94a3; fill: none } .dot { fill: #2b8a80 } .head { fill: #8a94a3 }
@media (prefers-color-scheme: dark) {
text { fill: #e7ebf0 } .small { fill: #a9b3c1 } .back { fill: #1e2129 } .box { fill: #17413d; stroke: #58b5aa }
.dot { fill: #58b5aa } }"""


def rooms_of(graph: grimp.ImportGraph, module: str) -> set[str]:
    """Return the rooms from which a module, or the modules in a package, import directly."""
    if module not in graph.modules:
        raise SystemExit(f"scripts/architecture_picture.py lists {module}, which is gone: list its successor.")
    modules = {module} | graph.find_descendants(module)
    imported = {n for m in modules for n in graph.find_modules_directly_imported_by(m)}
    return {n.split(".")[1] for n in imported} - {module.split(".")[1]}


def picture() -> str:
    """Return the picture as SVG."""
    graph = grimp.build_graph("hypose", cache_dir=None)
    width = _LEFT + _BOX + 24 + _STEP * len(ROOMS)
    height = _TOP + _ROW * len(STAGES) + 8
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'role="img" aria-label="Stages of hypose track and the rooms they import from">',
        f"<style>{_STYLE}</style>",
        f'<rect class="back" width="{width}" height="{height}" rx="8"/>',
        f'<text class="small" x="{_LEFT}" y="{_TOP - 14}">stage, and the module that does it</text>',
    ]
    across = [_LEFT + _BOX + 40 + _STEP * k for k in range(len(ROOMS))]
    for x, room in zip(across, ROOMS, strict=True):
        parts.append(f'<text class="small" transform="translate({x + 4},{_TOP - 14}) rotate(-55)">{room}</text>')
    for k, (module, caption) in enumerate(STAGES):
        y, used = _TOP + _ROW * k, rooms_of(graph, module)
        parts.append(f'<rect class="box" x="{_LEFT}" y="{y}" width="{_BOX}" height="{_ROW - 12}" rx="5"/>')
        parts.append(f'<text x="{_LEFT + 10}" y="{y + 14}">{escape(caption)}</text>')
        parts.append(f'<text class="small" x="{_LEFT + 10}" y="{y + 28}">{module.removeprefix("hypose.")}</text>')
        if k:
            middle = _LEFT + _BOX // 2
            parts.append(f'<path class="line" d="M{middle} {y - 12}v8"/>')
            parts.append(f'<path class="head" d="M{middle - 4} {y - 6}h8l-4 6z"/>')
        level = y + (_ROW - 12) / 2
        parts.append(f'<path class="line" stroke-dasharray="1 4" d="M{_LEFT + _BOX} {level}H{across[-1]}"/>')
        own = module.split(".")[1]
        for x, room in zip(across, ROOMS, strict=True):
            if room in used or room == own:
                fill = 'class="dot"' if room in used else 'class="line" stroke-width="2"'
                parts.append(f'<circle {fill} cx="{x}" cy="{level}" r="5"/>')
    return "\n".join([*parts, "</svg>"]) + "\n"
