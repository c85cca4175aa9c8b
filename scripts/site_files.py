"""Hook of mkdocs: pages that are made at each build, and copies of files outside docs/ to which pages link."""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from scripts.api_page import api_page
from scripts.commands_page import commands_page
from scripts.formats_page import formats_page

MADE = {"api.md": api_page, "commands.md": commands_page, "formats.md": formats_page}
"""Pages by name that are not kept, so that they cannot become outdated."""
_OUTSIDE = re.compile(r"\]\(\.\./(CHANGELOG\.md|CONTRIBUTING\.md|examples/[^)#]+|benchmarks/results/[^)#]+)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made, and the files that pages link to, as if they were in docs/."""
    root = Path(config.config_file_path).parent
    for name, page in MADE.items():
        files.append(File.generated(config, name, content=page()))
    for page in list(files.documentation_pages()):
        for name in _OUTSIDE.findall(page.content_string):
            if files.get_file_from_path(name) is None:
                files.append(File.generated(config, name, abs_src_path=str(root / name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with its links as seen from docs/ and, in the changelog, from above it."""
    return _OUTSIDE.sub(r"](\1", markdown).replace("](docs/", "](")


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page whose long names in tables may be broken after / : . and _ only."""
    return re.sub(r"(?<=<code>)[^<]{28,}(?=</code>)", lambda m: re.sub(r"([/:._]+)", r"\1<wbr>", m[0]), html)
