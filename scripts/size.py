"""Hold the project to its ceilings of size:  python -m scripts.size [--print] [--lower] [--json FILE]

The ceilings are in pyproject.toml, [tool.hypose.size], and may only fall. Exit code 1 above one of them. --print shows
all numbers, --lower writes those that have fallen as ceilings, --json writes them as the rows of a benchmark.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
LITERAL_ROOMS = ("tracking", "evidence", "quality", "pipeline")
"""Rooms of hypose/ whose numbers belong into classes called ...Settings, or into files called tuning..."""
PLAIN = {0, 1, 2, 0.5}
"""Numbers, of either sign, that need no name."""
MOST_PARAMETERS = 8
COMPUTE = "hypose/compute/"
CLOSURES = {"closure_tracker": "hypose.tracking.tracker", "closure_run": "hypose.pipeline.run"}
EVIDENCE = "hypose/evidence/"
CUES = {"silhouettes", "masks", "mask", "keypoints", "depth", "colours", "joints", "sensor_joints"}
"""Names of cues; only EVIDENCE may ask whether one of them is there."""
Trees = Mapping[str, ast.Module]
"""Syntax trees by the file's path from the root."""


def parsed(folder: str) -> dict[str, ast.Module]:
    """Parse the Python files of a folder of the project."""
    files = sorted((ROOT / folder).rglob("*.py"))
    return {f.relative_to(ROOT).as_posix(): ast.parse(f.read_text(encoding="utf-8")) for f in files}


def statements(files: Trees) -> int:
    """Count the statements of files."""
    return sum(isinstance(node, ast.stmt) for tree in files.values() for node in ast.walk(tree))


def literals(node: ast.AST) -> int:
    """Count the numbers that are neither plain nor in a class of settings."""
    if isinstance(node, ast.ClassDef) and node.name.endswith("Settings"):
        return 0
    own = isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in PLAIN
    return own + sum(map(literals, ast.iter_child_nodes(node)))


def public_names(tree: ast.Module) -> Iterator[str]:
    """Yield the public functions, classes and constants that a file defines."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        else:
            names = []
        yield from (n for n in names if not n.startswith("_"))


def twice(files: Trees) -> list[str]:
    """List the public names that two files define; compute, where kernels have wrappers, counts as one file."""
    rooms: dict[str, set[str]] = {}
    for path, tree in files.items():
        rooms.setdefault(COMPUTE if path.startswith(COMPUTE) else path, set()).update(public_names(tree))
    count = Counter(name for names in rooms.values() for name in names)
    return sorted(name for name, n in count.items() if n > 1)


def long_signatures(files: Trees) -> list[str]:
    """List functions, methods too, of more than MOST_PARAMETERS parameters; kernels are left out."""
    return [
        f"{path}:{node.lineno} {node.name}"
        for path, tree in files.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and not (path.startswith(COMPUTE) and node.decorator_list)
        and _parameters(node.args) > MOST_PARAMETERS
    ]


def cue_questions(files: Trees) -> list[str]:
    """List where code outside EVIDENCE compares a cue with None."""
    found = []
    for path, tree in files.items():
        for node in ast.walk(tree) if not path.startswith(EVIDENCE) else ():
            if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Is | ast.IsNot):
                asked = node.left.value if isinstance(node.left, ast.NamedExpr) else node.left
                name, _, _ = ast.unparse(asked)[::-1].partition(".")
                if name[::-1] in CUES and ast.unparse(node.comparators[0]) == "None":
                    found.append(f"{path}:{node.lineno} {ast.unparse(node)}")
    return found


def _parameters(given: ast.arguments) -> int:
    several = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    return sum(a.arg not in ("self", "cls") for a in several)


def sizes() -> dict[str, int]:
    """Count everything that has a ceiling."""
    package = parsed("hypose")
    rooms = tuple(f"hypose/{room}/" for room in LITERAL_ROOMS)
    graph = grimp.build_graph("hypose", exclude_type_checking_imports=True, cache_dir=None)
    return {
        "statements": statements(package),
        "files": len(package),
        "tests": statements(parsed("tests")),
        "benchmarks": statements(parsed("benchmarks")),
        "literals": sum(literals(t) for p, t in package.items() if p.startswith(rooms) and "/tuning" not in p),
        "twice": len(twice(package)),
        **{name: len(graph.find_upstream_modules(module)) + 1 for name, module in CLOSURES.items()},
        "parameters": len(long_signatures(package)),
        "cue_questions": len(cue_questions(package)),
    }


def above(found: Mapping[str, int], ceilings: Mapping[str, int]) -> list[str]:
    """Say which numbers are above their ceilings, or have none."""
    return [
        f"size: {name} is {n}, the ceiling is {ceilings.get(name, 'missing')}"
        for name, n in found.items()
        if n > ceilings.get(name, -1)
    ]


def lowered(text: str, found: Mapping[str, int]) -> str:
    """Lower the ceilings in the text of pyproject.toml to what was found; none is raised."""
    head, mark, rest = text.partition("[tool.hypose.size]\n")
    for name, n in found.items():
        rest = re.sub(rf"(?m)^{name} = (\d+)", lambda m, k=name, v=n: f"{k} = {min(v, int(m[1]))}", rest, count=1)
    return head + mark + rest


def main(arguments: Iterable[str] | None = None) -> int:
    """Count, compare, print; the exit status."""
    parser = argparse.ArgumentParser(description="Ceilings of size.")
    parser.add_argument("--print", action="store_true", help="show all numbers and their ceilings")
    parser.add_argument("--lower", action="store_true", help="write the numbers that have fallen as ceilings")
    parser.add_argument("--json", type=Path, help="write the numbers to this file as rows of a benchmark")
    asked = parser.parse_args(None if arguments is None else list(arguments))
    project, found = ROOT / "pyproject.toml", sizes()
    text = project.read_text(encoding="utf-8")
    ceilings = tomllib.loads(text)["tool"]["hypose"]["size"]
    if asked.print:
        for name, n in found.items():
            print(f"{name:16} {n:6}  ceiling {ceilings.get(name, 'missing')}")
    if asked.json:
        rows = [{"metric": name, "case": "all", "value": n, "unit": "1"} for name, n in found.items()]
        asked.json.write_text(json.dumps({"name": "size", "results": rows}, indent=2) + "\n", encoding="utf-8")
    if asked.lower:
        project.write_text(lowered(text, found), encoding="utf-8")
    lines = above(found, ceilings)
    for line in lines:
        print(line)
    return int(bool(lines))


if __name__ == "__main__":
    raise SystemExit(main())
