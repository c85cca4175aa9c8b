"""Make docs/licences.md: the licence of every package that hypose, an extra or its page uses, directly or not.

Python packages are read from what is installed, packages of the page from web/node_modules. Versions are left out: the
page changes when a package or a licence does.
"""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
_NOT_SHIPPED = ("dev", "oracles")
_KNOWN = {"ezc3d": "MIT", "python-osc": "public domain (Unlicense)", "rerun-sdk": "MIT OR Apache-2.0"}
"""Licences that metadata do not name, or of packages without a wheel for every system."""
_HEAD = """# Licences

hypose is under the BSD 3-clause licence. Its data come from MakeHuman and are in the public domain (CC0; see
`hypose/assets/LICENSE-assets.md`). The detector's models, fetched on request, are MediaPipe's (Apache 2.0).
`make docs` writes this page from the installed packages. Nothing here is copied into hypose except the JavaScript
libraries of the page, which are built into it."""


def licences_page() -> str:
    """Return the page as Markdown."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {k: v for k, v in project["optional-dependencies"].items() if k not in _NOT_SHIPPED}
    core = _all_needed(project["dependencies"])
    lines = [_HEAD, "", "| package | for | licence |", "| --- | --- | --- |"]
    lines += [f"| {name} | hypose | {_licence(name, d)} |" for name, d in sorted(core.items())]
    for extra, requirements in sorted(extras.items()):
        for name, d in sorted(_all_needed(requirements).items()):
            if name not in core:
                lines.append(f"| {name} | hypose[{extra}] | {_licence(name, d)} |")
    package = json.loads((ROOT / "web" / "package.json").read_text(encoding="utf-8"))
    lock = json.loads((ROOT / "web" / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    for name in sorted(package["dependencies"]):
        lines.append(f"| {name} | the page | {lock[f'node_modules/{name}'].get('license', 'see package')} |")
    return "\n".join(lines) + "\n"


def _all_needed(requirements: list[str]) -> dict[str, Distribution | None]:
    """The named packages and all that these need; None for one that is not installed."""
    found: dict[str, Distribution | None] = {}
    left = [Requirement(r) for r in requirements]
    while left:
        wanted = left.pop()
        name = canonicalize_name(wanted.name)
        if name in found and not wanted.extras:
            continue
        try:
            package = distribution(name)
        except PackageNotFoundError:
            found[name] = None
            continue
        found[name] = package
        needed = [Requirement(r) for r in package.requires or []]
        extras = ({"extra": extra} for extra in ("", *wanted.extras))
        left += [r for extra in extras for r in needed if r.marker is None or r.marker.evaluate(extra)]
    return found


def _licence(name: str, found: Distribution | None) -> str:
    if name in _KNOWN:
        return _KNOWN[name]
    if found is None:
        return "not installed here"
    about = found.metadata.json
    classified = [c.split(" :: ")[-1] for c in about.get("classifier", []) if c.startswith("License :: ")]
    named = ", ".join(c for c in classified if c != "OSI Approved")
    text = str(about.get("license_expression") or named or about.get("license") or "see package")
    return text.splitlines()[0][:60].replace("|", "/")
