"""What the page works out without a browser: web/tests/*.unit.mjs, each run by Node."""

import subprocess

import pytest

from tests import missing
from tests.app.studio.browser import WEB, build
from tests.conftest import HANG_S


@pytest.mark.parametrize("path", sorted((WEB / "tests").glob("*.unit.mjs")), ids=lambda p: p.name.split(".")[0])
def test_unit(path):
    builder = build()
    if not (WEB / "node_modules" / "esbuild").is_dir():
        missing.skip("the studio's page", "python hatch_build.py, with a network")
    try:
        node, _ = builder.find_node()
    except builder.PageError as error:
        missing.skip("the studio's page", f"have Node ({str(error).replace(';', ',')})")
    done = subprocess.run([node, str(path)], cwd=WEB, capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 0, f"{path.name}:\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
