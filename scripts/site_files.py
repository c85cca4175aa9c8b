"""Hook of mkdocs: pages link to files outside docs/ (examples, kept figures, the changelog); the site gets copies."""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_OUTSIDE = re.compile(r"\]\(\.\./(CHANGELOG\.md|CONTRIBUTING\.md|examples/[^)#]+|benchmarks/results/[^)#]+)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The files that pages lead to, as if they were in docs/."""
    root = Path(config.config_file_path).parent
    for page in list(files.documentation_pages()):
        for name in _OUTSIDE.findall(page.content_string):
            if files.get_file_from_path(name) is None:
                files.append(File.generated(config, name, abs_src_path=str(root / name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The links, as seen from docs/ and, in the changelog, from above it."""
    return _OUTSIDE.sub(r"](\1", markdown).replace("](docs/", "](")
