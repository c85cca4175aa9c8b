"""The public interface: what `import hypose` offers, that it is lazy, and that the types agree."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hypose


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
    typed = set(re.findall(r" as (\w+)$", stub, re.MULTILINE)) | set(re.findall(r"^(\w+):", stub, re.MULTILINE))
    assert typed == {*hypose.__all__, "__all__"}
    for module, source, name in re.findall(r"^from (\S+) import (\w+) as (\w+)$", stub, re.MULTILINE):
        assert getattr(importlib.import_module(module), source) is getattr(hypose, name)


def test_importing_it_imports_nothing_else():
    code = "import sys, hypose; print([m for m in sys.modules if m.startswith(('hypose.', 'numpy', 'importlib.meta'))])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_the_command_line_begins_without_numpy():
    code = "import sys, hypose.app.cli; print([m for m in sys.modules if m in ('numpy', 'cv2', 'numba', 'dask')])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
