"""The users' paths through the page, in Chromium against the real server (web/tests/*.path.mjs). What a user must read
is asserted by each path itself; `go` fails with what the browser said."""

import shutil

import pytest

from tests.app.studio.browser import PATHS, go
from tests.app.studio.conftest import serving


@pytest.mark.slow
@pytest.mark.parametrize("path", PATHS, ids=lambda p: p.name.removesuffix(".path.mjs"))
def test_path(path, page, served, tmp_path):
    root = tmp_path / "root"
    if "folder: empty" in path.read_text("utf-8").splitlines()[0]:
        root.mkdir()
    else:
        shutil.copytree(served, root)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    with serving(root) as client:
        go(path, client.address, root, pictures)
