"""Write the generated pages of docs/:  python -m scripts.docs [--check]

benchmarks.md and accuracy.md from kept figures, licences.md from installed packages, and images/architecture.svg from
imports. --check writes nothing; exit code 1 when a number of a page of figures differs, whatever its words. The pages
api.md, commands.md and formats.md are made by the site's build (scripts/site_files.py).
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable
from pathlib import Path

from benchmarks import pages
from scripts.architecture_picture import picture
from scripts.licences import licences_page

DOCS = Path(__file__).parent.parent / "docs"


def different(kept: str, made: str) -> list[str]:
    """Return the lines of `made` whose numbers are not in the same line of `kept`, by order."""
    old, new = kept.splitlines(), made.splitlines()
    numbers = [[re.findall(r"\d[\d.]*", line) for line in lines] for lines in (old, new)]
    numbers = [[n for n in lines if n] for lines in numbers]
    if numbers[0] == numbers[1]:
        return []
    shown = [line for line in new if re.search(r"\d", line)]
    return [line for k, line in enumerate(shown) if k >= len(numbers[0]) or numbers[0][k] != numbers[1][k]] or shown[:1]


def main(arguments: Iterable[str] | None = None) -> int:
    """Write or check the pages; the exit status."""
    parser = argparse.ArgumentParser(description="Generated pages of docs/.")
    parser.add_argument("--check", action="store_true", help="compare numbers of kept pages, write nothing")
    check = parser.parse_args(None if arguments is None else list(arguments)).check
    status = 0
    for name, text in pages.written().items():
        if not check:
            (DOCS / name).write_text(text, encoding="utf-8")
        elif lines := different((DOCS / name).read_text(encoding="utf-8"), text):
            print(f"docs/{name} has other numbers than the kept figures; run make docs. First: {lines[0]}")
            status = 1
    if not check:
        (DOCS / "licences.md").write_text(licences_page(), encoding="utf-8")
        (DOCS / "images" / "architecture.svg").write_text(picture(), encoding="utf-8")
    return status


if __name__ == "__main__":
    raise SystemExit(main())
