"""The public interface: what `import hypose` offers, that it is lazy, and that the types agree."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hypose
from hypose.errors import InputError, extra


def test_every_name_is_there_and_is_documented():
    assert 20 <= len(hypose.__all__) <= 50
    for name in hypose.__all__:
        value = getattr(hypose, name)
        assert name == "__version__" or value.__doc__, name
    assert set(hypose.__all__) <= set(dir(hypose))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = hypose.nonsense


def test_the_stub_names_the_same():
    stub = Path(hypose.__file__).with_suffix(".pyi").read_text()
    names = r" as (?!_)(\w+)$", r"^(\w+):", r"^(\w+) = _\1$"  # a name that another stands for is assigned
    typed = {name for pattern in names for name in re.findall(pattern, stub, re.MULTILINE)}
    assert typed == {*hypose.__all__, "__all__"}
    for module, source, name in re.findall(r"^from (\S+) import (\w+) as (\w+)$", stub, re.MULTILINE):
        assert getattr(importlib.import_module(module), source) is getattr(hypose, name.removeprefix("_"))


def test_importing_it_imports_nothing_else():
    code = "import sys, hypose; print([m for m in sys.modules if m.startswith(('hypose.', 'numpy', 'importlib.meta'))])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_the_command_line_begins_without_numpy():
    code = "import sys, hypose.app.cli; print([m for m in sys.modules if m in ('numpy', 'cv2', 'numba', 'dask')])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_what_is_not_installed_is_told_with_what_brings_it():
    assert extra("json", "A test", "none") is json
    with pytest.raises(
        InputError, match=r'^A test needs un-there, which is not installed; run: pip install "hypose\[x\]"\.$'
    ):
        extra("un_there", "A test", "x", "un-there")


@pytest.mark.parametrize("raised", ["ImportError('libx.so.1: cannot open')", "RuntimeError('libx.so.1: cannot open')"])
def test_what_is_installed_but_cannot_be_loaded_is_told_with_the_reason(tmp_path, monkeypatch, raised):
    (tmp_path / "hypose_tests_broken.py").write_text(f"raise {raised}")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        InputError, match=r"needs broken, which cannot be loaded \(\w+: libx.so.1: .*, or use another\.$"
    ):
        extra("hypose_tests_broken", "A test", "x", "broken", "use another")
