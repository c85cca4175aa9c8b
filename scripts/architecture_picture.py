"""Draw docs/images/architecture.svg: the data flow of `hypose track`, and the rooms that each step uses.

Steps are the passes of `hypose.pipeline.passes` in their order, between reading and writing; modules and rooms are read
from the names that each step's function uses and from imports. Passes that may move joints are marked.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from html import escape
from typing import NamedTuple

import grimp

from hypose.pipeline import passes

BEFORE = (
    ("hypose.io.recordings.recording", "Read recording.toml and the calibration: Recording."),
    ("hypose.io.recordings.frames", "Decode videos; make masks; read key points: Frame."),
)
AFTER = (("hypose.io.motions.export", "Write motion files."),)
ROOMS = ("io", "evidence", "calibration", "tracking", "inference", "fitting", "body", "cameras", "compute")
"""Rooms in the picture's columns; errors, geometry and json_text are used nearly everywhere."""
_BASICS = ("hypose.body", "hypose.errors", "hypose.geometry", "hypose.pipeline.settings")
"""What nearly every pass uses: not named as the modules of a pass."""

_ROW, _TOP, _BOX, _LEFT, _STEP = 48, 118, 500, 16, 40
_STYLE = """
text { font-family: system-ui, sans-serif; font-size: 13px; fill: #1f2733 }
.small { font-size: 11px; fill: #566273 } .back { fill: #ffffff } .box { fill: #e9eef3; stroke: #8a94a3 }
.moves { fill: #fbe3cf; stroke: #c9701d } .line { stroke: #8a94a3; fill: none } .dot { fill: #2b8a80 }
.head { fill: #8a94a3 }
@media (prefers-color-scheme: dark) {
text { fill: #e7ebf0 } .small { fill: #b3bcc9 } .back { fill: #1e2129 } .box { fill: #2b313c; stroke: #6d7787 }
.moves { fill: #5a3717; stroke: #e08a3c } .dot { fill: #58b5aa } }"""


class Step(NamedTuple):
    """A row of the picture. modules: that do the work; moves: it may move joints."""

    name: str
    caption: str
    modules: tuple[str, ...]
    moves: bool = False


def steps() -> Iterator[Step]:
    """Yield the steps from the recording's files to the motion's."""
    tree = ast.parse(inspect.getsource(passes))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    imported = _imported(tree)
    for module, caption in BEFORE:
        yield Step("", caption, (module,))
    for one in passes.PASSES:
        names = _names(functions[one.__name__], functions)
        modules = dict.fromkeys(imported[n] for n in names if n in imported)
        modules = tuple(m for m in modules if not m.startswith(_BASICS))
        caption = (inspect.getdoc(one) or "").split("\n\n")[0].replace("\n", " ")
        yield Step(one.__name__, caption, modules, one.__name__ in {"track_clip", *passes.REASONS})
    for module, caption in AFTER:
        yield Step("", caption, (module,))


def _imported(tree: ast.Module) -> dict[str, str]:
    """The module that each name imported by `tree` comes from."""
    out = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("hypose"):
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                out[alias.asname or alias.name] = (
                    whole if inspect.ismodule(getattr(passes, alias.asname or alias.name, None)) else node.module
                )
    return out


def _names(function: ast.FunctionDef, functions: dict[str, ast.FunctionDef]) -> list[str]:
    """The names that a function uses, those of the module's own functions that it calls included, in their order."""
    used, left = {}, [function]
    while left:
        for node in ast.walk(left.pop(0)):
            if isinstance(node, ast.Name) and node.id not in used:
                used[node.id] = None
                left += [functions[node.id]] if node.id in functions else []
    return list(used)


def rooms_of(graph: grimp.ImportGraph, modules: tuple[str, ...]) -> set[str]:
    """Return the rooms of some modules, and those from which they import directly."""
    imported = {n for m in modules for n in graph.find_modules_directly_imported_by(m)}
    return {n.split(".")[1] for n in {*modules, *imported} if "." in n}


def picture() -> str:
    """Return the picture as SVG."""
    graph = grimp.build_graph("hypose", cache_dir=None)
    rows = list(steps())
    width, height = _LEFT + _BOX + 24 + _STEP * len(ROOMS), _TOP + _ROW * len(rows) + 8
    across = [_LEFT + _BOX + 34 + _STEP * k for k in range(len(ROOMS))]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'role="img" aria-label="Steps of hypose track and the rooms they use">',
        f"<style>{_STYLE}</style>",
        f'<rect class="back" width="{width}" height="{height}" rx="8"/>',
        f'<rect class="moves" x="{_LEFT}" y="{_TOP - 74}" width="14" height="14" rx="3"/>',
        f'<text class="small" x="{_LEFT + 22}" y="{_TOP - 63}">may move joints; grey: does not</text>',
        f'<text class="small" x="{_LEFT}" y="{_TOP - 36}">pass (hypose.pipeline.passes): what it does</text>',
        f'<text class="small" x="{_LEFT}" y="{_TOP - 20}">modules that do it; dots: rooms that these use</text>',
    ]
    for x, room in zip(across, ROOMS, strict=True):
        parts.append(f'<text class="small" transform="translate({x + 4},{_TOP - 14}) rotate(-55)">{room}</text>')
    for k, step in enumerate(rows):
        y, used = _TOP + _ROW * k, rooms_of(graph, step.modules)
        kind = "moves" if step.moves else "box"
        parts.append(f'<rect class="{kind}" x="{_LEFT}" y="{y}" width="{_BOX}" height="{_ROW - 12}" rx="5"/>')
        caption = f"{step.name}: {step.caption}" if step.name else step.caption
        parts.append(f'<text x="{_LEFT + 10}" y="{y + 15}">{escape(_short(caption, 70))}</text>')
        modules = ", ".join(m.removeprefix("hypose.") for m in step.modules)
        parts.append(f'<text class="small" x="{_LEFT + 10}" y="{y + 30}">{escape(_short(modules, 88))}</text>')
        if k:
            middle = _LEFT + _BOX // 2
            parts.append(f'<path class="line" d="M{middle} {y - 12}v8"/>')
            parts.append(f'<path class="head" d="M{middle - 4} {y - 6}h8l-4 6z"/>')
        level = y + (_ROW - 12) / 2
        parts.append(f'<path class="line" stroke-dasharray="1 4" d="M{_LEFT + _BOX} {level}H{across[-1]}"/>')
        for x, room in zip(across, ROOMS, strict=True):
            if room in used:
                parts.append(f'<circle class="dot" cx="{x}" cy="{level}" r="5"/>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1].rsplit(" ", 1)[0] + " …"
