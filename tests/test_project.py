"""The project as a whole: set-up decisions, what is installed, and rules for every file of the package."""

import ast
import importlib.util
import inspect
import os
import re
import signal
import subprocess
import sys
import tomllib
import zipfile
from collections import Counter
from dataclasses import fields
from pathlib import Path

import grimp
import pytest

import hypose
from hypose.app.cli import app
from hypose.app.studio.job_kinds import JOB_KINDS, form_of
from hypose.options import declared
from hypose.pipeline.track_options import RECIPE_NAMES, TrackOptions
from hypose.tracking.recipes import RECIPES
from tests import missing
from tests.conftest import HANG_S

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "hypose"
SOURCES = sorted(PACKAGE.rglob("*.py"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def _load_bootstrap():
    spec = importlib.util.spec_from_file_location("bootstrap", ROOT / "scripts" / "bootstrap.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


bootstrap = _load_bootstrap()


def _imported(node):
    """Full names of the modules that a statement imports, relative imports left out."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []


DEBIAN = bootstrap.Machine(
    python="/usr/bin/python3",
    version=(3, 11, 2),
    prefix="/usr",
    base_prefix="/usr",
    conda_prefix=None,
    conda_name=None,
    venv=True,
    ensurepip=True,
    pip=(23, 0),
    uv=None,
)


# --- scripts/bootstrap.py ---


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, ["venv", "venv-without-pip", "borrowed-uv"]),
        ({"uv": "/usr/bin/uv"}, ["uv", "venv", "venv-without-pip", "borrowed-uv"]),
        ({"ensurepip": False}, ["venv-without-pip", "borrowed-uv"]),  # Debian without python3-venv
        ({"ensurepip": False, "pip": (20, 3)}, ["borrowed-uv"]),  # pip without --python
        ({"venv": False}, ["borrowed-uv"]),
        ({"pip": None}, ["venv"]),
        ({"pip": None, "ensurepip": False, "uv": "/usr/bin/uv"}, ["uv"]),
    ],
)
def test_ways_to_make_an_environment(change, expected):
    assert bootstrap.ways_to_make_environment(DEBIAN._replace(**change)) == expected


def test_no_way_to_make_an_environment_names_the_package_to_install():
    with pytest.raises(bootstrap.SetupError, match=r"/usr/bin/python3 has neither pip.*apt install python3-venv"):
        bootstrap.ways_to_make_environment(DEBIAN._replace(pip=None, ensurepip=False))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, False),
        ({"prefix": "/home/me/venv"}, True),
        ({"prefix": "/conda/envs/x", "base_prefix": "/conda/envs/x", "conda_prefix": "/conda/envs/x/"}, True),
        (
            {"prefix": "/conda", "base_prefix": "/conda", "conda_prefix": "/conda", "conda_name": "base"},
            False,
        ),
        ({"conda_prefix": "/conda/envs/x"}, False),  # conda is active, but this is the system's Python
    ],
)
def test_active_environment_is_used_except_conda_base(change, expected):
    assert bootstrap.uses_current_environment(DEBIAN._replace(**change)) is expected


def test_installing_never_targets_the_systems_python():
    for way in ("uv", "pip", "outer-pip"):
        command = bootstrap.install_command(way, DEBIAN._replace(uv="/usr/bin/uv"), "/x/.venv/bin/python", None)
        assert "/x/.venv/bin/python" in command
        assert not {"--break-system-packages", "--user", "--system"} & set(command)


def test_caches_and_temporary_files_stay_in_the_folder():
    result = bootstrap.contained({"HOME": "/home/me", "PYTHONHOME": "/odd", "TMPDIR": "/tmp"})
    assert result.pop("HOME") == "/home/me"
    assert result.pop("PIP_RETRIES") == "2"
    assert "PYTHONHOME" not in result
    assert {"TMPDIR", "HYPOSE_CACHE_DIR", "MPLCONFIGDIR", "PIP_CACHE_DIR", "XDG_CACHE_HOME"} <= set(result)
    assert all(Path(value).is_relative_to(ROOT / ".cache") for value in result.values())


def test_old_python_is_told_so(monkeypatch, capsys):
    monkeypatch.setattr(bootstrap, "look", lambda: DEBIAN._replace(version=(3, 9, 18)))
    monkeypatch.setattr(bootstrap, "newer_python", lambda: None)
    assert bootstrap.main(["demo"]) == 1
    error = capsys.readouterr().err
    assert "Python 3.11 or newer is needed" in error
    assert "3.9.18" in error
    assert "make PYTHON=" in error
    assert len(error.strip().splitlines()) == 1


def test_bootstrap_is_readable_by_an_old_python_and_needs_no_package():
    source = (ROOT / "scripts" / "bootstrap.py").read_text("utf-8")
    tree = ast.parse(source, feature_version=(3, 6))
    top_level = {name.split(".")[0] for node in tree.body for name in _imported(node)}
    assert top_level <= set(sys.stdlib_module_names) - {"__future__", "dataclasses", "tomllib"}


def test_unknown_commands_go_to_hypose_and_test_to_pytest():
    assert bootstrap.commands_of("test", ["-n0"], "/e", "p") == [["p", "-m", "pytest", "-n0"]]
    assert [command[1:] for command in bootstrap.commands_of("track", ["rec"], "/e", "p")] == [["track", "rec"]]


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C reaches processes differently on Windows")
def test_ctrl_c_leaves_the_program_time_to_save_its_work():
    # a program that is started in the background may have been told to ignore Ctrl-C, and its children with it
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    child = f"""
{heed}
import time
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    time.sleep(0.6)
    print("saved", flush=True)
"""
    parent = f"""
{heed}
import os, sys
sys.path.insert(0, {str(ROOT / "scripts")!r})
import bootstrap
print(bootstrap.run([sys.executable, "-c", {child!r}], None, dict(os.environ)))
"""
    with subprocess.Popen(
        [sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        os.killpg(process.pid, signal.SIGINT)
        output, _ = process.communicate(timeout=HANG_S)
    assert output.split() == ["saved", "0"]


# --- options ---


def _commands(group, before=""):
    """(name, what declares its options) of every command."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        if hasattr(command, "declares"):
            yield before + name, command.declares
        else:
            yield from _commands(command, f"{before}{name} ")


def test_every_option_is_declared_once():
    """Every parameter of a command is an Option, in a class where there are many, and no other declares the same."""
    commands = dict(_commands(app))
    for name, declares in commands.items():
        given = set(inspect.signature(declares).parameters)
        undeclared = given - {option.name for option in declared(declares)} - {f.name for f in fields(TrackOptions)}
        assert not undeclared, f"{name}: {undeclared} has no Option"
    helps = Counter()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "Option":
                helps[ast.unparse(node.args[0])] += 1
    assert not [text for text, n in helps.items() if n > 1], "share the declaration, in hypose/options.py"


def test_pages_and_tables_offer_options_that_commands_have():
    for kind in JOB_KINDS:
        assert all(option.option.help for option in form_of(kind))
    assert RECIPE_NAMES == tuple(RECIPES)


# --- what is installed ---


def test_version_is_the_same_everywhere():
    if hypose.__version__ == "0+unknown":
        missing.skip("the installed version", "make setup")
    assert hypose.__version__ == PROJECT["version"]


def test_every_module_imports_without_the_developers_packages():
    program = """
import importlib, sys
developers = {"pytest", "hatchling", "bvhio", "opensim", "ruff", "importlinter"}
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in developers:
            raise ModuleNotFoundError(name + " is not a dependency of hypose")
sys.meta_path.insert(0, Absent())
for name in sys.argv[1:]:
    importlib.import_module(name)
"""
    modules = [path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".") for path in SOURCES]
    modules = [name.removesuffix(".__init__") for name in modules if not name.endswith(".__main__")]
    command = [sys.executable, "-c", program, *modules]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_folder_of_code_is_a_package():
    # Without __init__.py a folder imports all the same, but the import contracts do not see it.
    bare = {path.parent for path in SOURCES if not (path.parent / "__init__.py").exists()}
    assert sorted(folder.relative_to(ROOT).as_posix() for folder in bare) == []


def test_no_modules_import_each_other_in_a_circle():
    graph = grimp.build_graph("hypose", cache_dir=None)
    left = {m: set(graph.find_modules_directly_imported_by(m)) for m in graph.modules}
    while free := [m for m, imported in left.items() if not imported & left.keys()]:
        for m in free:
            del left[m]
    assert not left, f"these, or some of them, import each other: {sorted(left)}"


def test_every_imported_package_is_declared():
    distributions = {
        "cv2": "opencv-python-headless",
        "skimage": "scikit-image",
        "distributed": "dask",
        "pythonosc": "python-osc",
        "yaml": "pyyaml",
    }
    extras = {k: v for k, v in PROJECT["optional-dependencies"].items() if k not in ("dev", "oracles")}
    requirements = PROJECT["dependencies"] + [line for lines in extras.values() for line in lines]
    declared = {re.split(r"[<>=!~;\[ ]", line)[0].lower() for line in requirements}
    for source in SOURCES:
        for node in ast.walk(ast.parse(source.read_text("utf-8"))):
            for name in _imported(node):
                top = name.split(".")[0]
                if top != "hypose" and top not in sys.stdlib_module_names:
                    distribution = distributions.get(top, top.replace("_", "-"))
                    where = source.relative_to(ROOT)
                    assert distribution in declared, f"{where} imports {top}: not in pyproject's dependencies"


def test_wheel_holds_code_assets_and_the_command(tmp_path):
    builder = missing.module("hatchling.builders.wheel", "what the wheel holds", "pip install hatchling")
    (wheel,) = builder.WheelBuilder(str(ROOT)).build(directory=str(tmp_path))
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        entry_points = archive.read(f"hypose-{PROJECT['version']}.dist-info/entry_points.txt").decode()
    on_disk = [p for p in (PACKAGE / "assets").rglob("*") if p.is_file() and "__pycache__" not in p.parts]
    wanted = {p.relative_to(ROOT).as_posix() for p in [*SOURCES, *on_disk, PACKAGE / "py.typed"]}
    assert wanted <= names
    assert f"hypose-{PROJECT['version']}.dist-info/licenses/LICENSE" in names
    assert not any(name.startswith(("tests/", "scripts/")) for name in names)
    assert "hypose = hypose.app.__main__:main" in entry_points


# --- rules for every file ---


def test_no_large_file_is_tracked():
    try:
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        missing.skip("which files are tracked", "run the tests in a git checkout")
    files = [ROOT / name for name in listed.stdout.split("\0") if name]
    assert [p.relative_to(ROOT).as_posix() for p in files if p.is_file() and p.stat().st_size > 2**20] == []


UNSAFE = r"""(?mx) ^\s*(?:import|from)\s+(?:pickle|cPickle|dill|cloudpickle|marshal|shelve|joblib)\b
    | (?<![.\w])(?:eval|exec)\( | allow_pickle\s*=\s*(?!False\b)"""
"""What runs code that is found in data: pickle and its kin, eval, exec."""


def test_no_data_is_executed():
    found = [
        f"{path.relative_to(PACKAGE).as_posix()} {what.strip()}"
        for path in SOURCES
        for what in re.findall(UNSAFE, path.read_text("utf-8"))
    ]
    # compiled kernels, which numba keeps in no other form: hypose's own files, checked before they are loaded; and
    # OpenCap's calibrations, of which an unpickler makes arrays of numbers and nothing else
    assert sorted(found) == [
        "compute/compiled.py from pickle",
        "io/calibrations/calibration_formats.py import pickle",
    ]
