"""Examples run, commands in the documentation exist with their options, and the generated reference is up to date."""

import ast
import importlib.util
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import replace

import click
import pytest

from benchmarks.bench_list import find_benchmark
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.app.batch import read_table
from hypose.app.cli import app
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.sensors.skeleton_files import format_line
from scripts import docs
from scripts.commands_page import commands_page
from scripts.words import found_in_page
from tests.conftest import HANG_S, ROOT
from tests.depth_sensors import reports

PAGES = sorted([*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md")])
MADE = {"api.md", "commands.md", "formats.md"}  # by the site's build


def run(path, *arguments):
    done = subprocess.run([sys.executable, path, *arguments], capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 0, done.stderr
    return done.stdout


def example(name):
    """Where an example is, and how many lines it has that are neither empty nor its first words."""
    path = ROOT / "examples/python" / name
    code = path.read_text().split('"""', 2)[2]
    return path, sum(bool(line.strip()) for line in code.splitlines())


@pytest.mark.slow
def test_own_masks():
    assert run(ROOT / "examples/python/own_masks.py").count("right wrist at") == 5


@pytest.mark.slow
def test_limb_maps():
    assert "0.00 at the right pose" in run(ROOT / "examples/python/limb_maps.py")


@pytest.mark.slow
def test_own_evidence_improves_a_scene():
    path, lines = example("own_evidence.py")
    without, with_it = (float(x) for x in re.findall(r"arms (\d+) mm", run(path)))
    # 0.4 of what two cameras alone give (49 mm); in a clip half as long chance decides whether they lose an arm
    assert with_it < 24 and with_it < 0.5 * without and lines <= 40


@pytest.mark.slow
def test_own_recipe(tmp_path):
    path, lines = example("own_recipe.py")
    write_masks(small_scene(1, 3), tmp_path / "walk")
    said = run(path, tmp_path / "walk")
    assert said.startswith("3 frames") and float(said.split()[-1]) > 0.7 and lines <= 12


def test_bearings_only():
    path, lines = example("bearings_only.py")
    off = [float(x) for x in re.findall(r": (\d+) m off", run(path))]
    assert len(off) == 90 and off[0] > 1000 > 250 > max(off[-10:]) and lines <= 30


def test_layered_filter_on_a_toy(tmp_path):
    said = run(ROOT / "examples/python/layered_filter_on_a_toy.py", tmp_path / "tip.svg")
    layered, plain = (float(x) for x in re.findall(r": (\d+) mm", said))
    assert layered < 0.8 * plain and layered < 25 and (tmp_path / "tip.svg").read_text().count("<polyline") == 3


@pytest.mark.slow
def test_live_fusion(tmp_path, rng):
    path, lines = example("live_fusion.py")
    reported = reports(rng, 1.5, epochs={k: [(0.0, 0.0)] for k in range(3)})
    (tmp_path / "s.jsonl").write_text("\n".join(format_line(replace(r, arrival=None)) for r in reported))
    said = run(path, tmp_path / "s.jsonl")
    assert said.count(" s:") > 20 and "by 3" in said and lines <= 6


def test_examples_use_public_names_only():
    for path in set(ROOT.glob("examples/python/*.py")) - {ROOT / "examples/python/limb_maps.py"}:  # a cue from within
        text = path.read_text()
        assert "import hypose" in text or "from hypose import" in text, path.name
        assert not re.search(r"hypose\.\w+\.\w+ import|import hypose\.", text), path.name


def test_convert_calibration(tmp_path):
    write_calibration(small_scene(1, 2).rig, tmp_path / "a.toml")
    said = run(ROOT / "examples/python/convert_calibration.py", tmp_path / "a.toml", tmp_path / "b.toml")
    assert said.startswith("4 cameras: cam1") and (tmp_path / "b.toml").is_file()


@pytest.mark.slow
def test_read_results(tmp_path):
    write_masks(small_scene(1, 6), tmp_path / "walk")
    run("-m", "hypose", "track", tmp_path / "walk", "--no-overlay", "--formats", "csv")
    assert "6 of 6 frames; right knee" in run(
        ROOT / "examples/python/read_results.py", tmp_path / "walk" / "results" / "default"
    )


def test_the_table_of_recordings_can_be_read():
    assert len(read_table(ROOT / "examples/cluster/study.csv")) == 4


def test_links_between_pages_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[\w-]+)?\)", page.read_text()):
            assert target in MADE or (page.parent / target).exists(), f"{page.name}: {target}"


def commands(program):
    """(page, words) of every line of shell code, and of every piece of code in a text, that calls a program."""
    for page in PAGES:
        text = page.read_text()
        blocks = re.findall(r"```(?:sh|bash|)\n(.*?)```", text, re.DOTALL)
        said = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
        lines = "\n".join(blocks).replace("\\\n", " ").splitlines() + [
            s for s in said if "COMMAND" not in s and "..." not in s
        ]
        for line in lines:
            for part in line.split("  #")[0].split(" && "):
                if found := re.match(rf"\s*(?:\S*/)?{program} +(.*)", part):
                    yield page.name, shlex.split(found[1], comments=True)


@pytest.mark.parametrize(
    ("page", "words"), list(commands("hypose")), ids=lambda x: x if isinstance(x, str) else " ".join(x)
)
def test_commands_in_the_documentation_exist(page, words):
    command = app
    while isinstance(command, click.Group) and words:
        assert words[0] in command.list_commands(None), words
        command, words = command.get_command(None, words[0]), words[1:]
    known = {o for p in command.params for o in (*p.opts, *p.secondary_opts, "--help")}
    given = {w.partition("=")[0] for w in words if re.match(r"--[a-z]", w)}
    assert given <= known, f"{page}: {given - known}"


def test_commands_for_developers_exist():
    for _, words in commands("./run"):
        if words[0] == "bench" and words[1] != "NAME":
            find_benchmark(words[1], words[words.index("--case") + 1] if "--case" in words else "")
    targets = re.findall(r"^\t|^\.PHONY: (.*)", (ROOT / "Makefile").read_text(), re.MULTILINE)[0].split()
    assert {words[0] for _, words in commands("make")} <= {*targets}
    for page, words in commands("python"):
        if words[0] == "-m" and words[1] != "venv":
            assert importlib.util.find_spec(words[1]), f"{page}: {words}"


def test_files_that_the_architecture_names_exist():
    text = (ROOT / "docs/developers.md").read_text()
    named = re.findall(r"`((?:hypose|tests|web|benchmarks)/[\w/.]+)`", text)
    assert len(named) > 30 and [n for n in named if "NAME" not in n and not (ROOT / n).exists()] == []
    where = {file: (ROOT / file).read_text() for file in named if (ROOT / file).is_file()}
    for name, file in re.findall(r"`([A-Za-z_]+)`, `([\w/]+\.\w+)`", text):
        assert re.search(rf"\b{name}\b", where[file]), f"{name} is not in {file}"


def test_the_page_of_commands_has_every_command_and_option():
    text = commands_page()
    for name in app.list_commands(None):
        assert f"### hypose {name}\n" in text and f"(#hypose-{name})" in text
    assert "| `--evidence " in text and "#### hypose gesture train" in text


def test_pages_of_figures_have_the_kept_numbers():
    assert docs.main(["--check"]) == 0


def test_pages_use_plain_words():
    assert [f"{p.name}:{n}: {w}" for p in PAGES for n, w in found_in_page(p.read_text())] == []


def test_python_in_the_documentation_imports_names_that_exist():
    for page in PAGES:
        for block in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hypose"):
                    module = importlib.import_module(node.module)
                    assert [a.name for a in node.names if not hasattr(module, a.name)] == [], page.name


def test_modules_and_names_in_the_documentation_exist():
    for page in PAGES:
        for module, name in re.findall(r"`(hypose(?:\.[a-z]\w*)+)(?:[:.](\w+))?(?:\([^`]*\))?`", page.read_text()):
            path = ROOT / module.replace(".", "/")
            if not name and not path.is_dir() and not path.with_suffix(".py").is_file():  # a function
                module, _, name = module.rpartition(".")
            assert not name or hasattr(importlib.import_module(module), name), f"{page.name}: {module}:{name}"


def test_toml_in_the_documentation_is_toml():
    for page in PAGES:
        for block in re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL):
            tomllib.loads(block)
