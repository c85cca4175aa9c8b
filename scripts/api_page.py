"""Make the site's reference of the public interface from docstrings; nothing of it is kept in docs/."""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any

import hypose

_TITLES = {
    "load_recording": "A recording becomes a motion",
    "Motion": "A motion and what is made of it",
    "Body": "Bodies",
    "Camera": "Cameras",
    "Frame": "Frame by frame, with evidence of one's own",
    "recipe": "A method of one's own",
    "read_skeletons": "Depth sensors",
    "make_scene": "Scenes with known truth",
    "HyposeError": "What goes wrong",
}


_WIDTH = 88  # of a signature in one line


def api_page() -> str:
    """The page as Markdown."""
    parts = [
        "# Python interface",
        "What `import hypose` offers. Metres, radians, seconds, pixels; the world is right-handed with z up. Each name "
        "is imported when it is first used. What is not listed here is reached by its module (`hypose.tracking`, "
        "`hypose.io`, ...) and may change between minor versions.",
    ]
    for name in hypose.__all__[1:]:
        if name in _TITLES:
            parts.append(f"## {_TITLES[name]}")
        value = getattr(hypose, name)
        parts.append(f"### {name}\n\n```python\n{_signature(name, value)}\n```")
        parts.append(_described(inspect.getdoc(value) or ""))
        if inspect.ismodule(value) or (inspect.isclass(value) and not issubclass(value, Exception)):
            rows = [f"- `{n}`: {_first(inspect.getdoc(m) or '')}" for n, m in _members(value)]
            parts += ["\n".join(rows)] if rows else []
    return "\n\n".join(parts) + "\n"


def _signature(name: str, value: Any) -> str:
    if inspect.ismodule(value):
        return f"from hypose import {name}"
    if inspect.isclass(value) and issubclass(value, Exception):
        return f"class {name}({value.__bases__[0].__name__})"
    if inspect.isclass(value) and dataclasses.is_dataclass(value):
        parameters, returned = [f"{f.name}: {_type(f.type)}" for f in dataclasses.fields(value)], ""
    else:
        whole = str(inspect.signature(value))
        parameters = [str(p) for p in inspect.signature(value).parameters.values()]
        if any(p.kind is p.KEYWORD_ONLY for p in inspect.signature(value).parameters.values()) and ", *," in whole:
            parameters.insert(whole[: whole.index(" *,")].count(": "), "*")
        returned = whole[whole.rindex(")") + 1 :]
    parameters = [re.sub(r"hypose(\.\w+)+\.", "", p).replace("'", "") for p in parameters]
    returned = re.sub(r"hypose(\.\w+)+\.", "", returned).replace("'", "")
    line = f"{name}({', '.join(parameters)}){returned}"
    return (
        line if len(line) <= _WIDTH else "\n    ".join([f"{name}(", *(f"{p}," for p in parameters)]) + f"\n){returned}"
    )


def _type(annotation: Any) -> str:
    return annotation if isinstance(annotation, str) else getattr(annotation, "__name__", str(annotation))


def _members(value: Any) -> list[tuple[str, Any]]:
    """Public methods and properties that the class itself defines, or what the module does."""
    if inspect.ismodule(value):
        own = {n: m for n, m in vars(value).items() if getattr(m, "__module__", "") == value.__name__}
        return [(n, m) for n, m in own.items() if not n.startswith("_")]
    return [
        (n, m.__func__ if isinstance(m, staticmethod | classmethod) else m)
        for n, m in vars(value).items()
        if not n.startswith("_") and (callable(m) or isinstance(m, property | staticmethod | classmethod))
    ]


def _described(text: str) -> str:
    """A docstring as Markdown: its lines `field: meaning` become a list."""
    text = re.sub(r"\n    +", " ", _plain(text))
    return re.sub(r"(?m)^(\w+(?:, \w+)*): ", lambda m: f"- {m[1]}: " if m[1] == "Raises" else f"- `{m[1]}`: ", text)


def _first(text: str) -> str:
    return _plain(re.split(r"(?<=[.;])\s", " ".join(text.split()), maxsplit=1)[0])


def _plain(text: str) -> str:
    """Docstrings are plain text: what Markdown would take for marks is kept."""
    return text.replace("<", "&lt;").replace("*", "\\*")
