"""Find words that hypose/ and the pages do not use:  python -m scripts.words [FOLDER ...]

Docstrings, comments and names of the package are read, messages to users are not; of pages all but code.
docs/glossary.md has the words to use instead. Exit code 1 when a word is found.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator

from scripts.size import ROOT

WORDS = ("told", "whoever", "somebody", "nobody", "everybody", "dear", "beside", "anew", "mend", "mended", "mending")
PHRASES = ("what is",)
_TEXT = re.compile(rf"\b({'|'.join((*WORDS, *PHRASES))})\b", re.IGNORECASE)
_NAME = re.compile(rf"(?:^|_)({'|'.join(WORDS)})(?=_|$)")


def found(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the word of each forbidden word in the source text of a module."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield from _in_text(node.value.value, node.lineno)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield from _in_text(token.string, token.start[0])
        elif token.type == tokenize.NAME:
            snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", token.string).lower()
            yield from ((token.start[0], f"{m[1]} (in {token.string})") for m in _NAME.finditer(snake))


def found_in_page(text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the word of each forbidden word in a page, outside of code."""
    for code in (r"```.*?```", r"`[^`\n]*`"):
        text = re.sub(code, lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.DOTALL)
    yield from _in_text(text, 1)


def _in_text(text: str, first: int) -> Iterator[tuple[int, str]]:
    for m in _TEXT.finditer(re.sub(r"\s", " ", text)):
        yield first + text.count("\n", 0, m.start()), m[0]


def main(arguments: Iterable[str] | None = None) -> int:
    """Print the forbidden words of some folders of hypose/; the exit status."""
    parser = argparse.ArgumentParser(description="Words that are not used.")
    parser.add_argument("folders", nargs="*", default=["."], help="folders and files of hypose/")
    lines = []
    for name in parser.parse_args(None if arguments is None else list(arguments)).folders:
        place = ROOT / "hypose" / name
        for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            words = sorted(found(path.read_text(encoding="utf-8")))
            lines += [f"{path.relative_to(ROOT)}:{line}: {word}" for line, word in words]
    for path in sorted([*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md")]):
        words = found_in_page(path.read_text(encoding="utf-8"))
        lines += [f"{path.relative_to(ROOT)}:{line}: {word}" for line, word in words]
    for line in lines:
        print(line)
    return int(bool(lines))


if __name__ == "__main__":
    raise SystemExit(main())
