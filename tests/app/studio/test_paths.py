"""The users' paths through the page, in Chromium against the real server (web/tests/*.path.mjs). What a user must read
is asserted by each path itself; `go` fails with what the browser said."""

import shutil

import pytest

from tests.app.studio.browser import PATHS, go
from tests.app.studio.conftest import serving


def _parameter(path):
    head = path.read_text("utf-8").splitlines()[0]
    return pytest.param(
        path, marks=[pytest.mark.slow] if "slow" in head else [], id=path.name.removesuffix(".path.mjs")
    )


@pytest.mark.parametrize("path", [_parameter(p) for p in PATHS])
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
