"""Examples run, commands in the documentation exist with their options, and the generated reference is up to date."""

import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import replace

import click
import pytest

import hypose
from benchmarks.robustness.small_recordings import small_scene, write_masks
from hypose.app.batch import read_table
from hypose.app.cli import app
from hypose.io.calibrations.calibration_text import write_calibration
from hypose.io.sensors.skeleton_streams import format_line
from scripts.api_page import api_page
from tests.conftest import HANG_S, ROOT
from tests.depth_sensors import reports

PAGES = sorted([*ROOT.glob("docs/*.md"), ROOT / "README.md"])


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


@pytest.mark.slow
def test_live_fusion(tmp_path, rng):
    path, lines = example("live_fusion.py")
    reported = reports(rng, 1.5, epochs={k: [(0.0, 0.0)] for k in range(3)})
    (tmp_path / "s.jsonl").write_text("\n".join(format_line(replace(r, arrival=None)) for r in reported))
    said = run(path, tmp_path / "s.jsonl")
    assert said.count(" s:") > 20 and "by 3" in said and lines <= 6


def test_examples_use_public_names_only():
    for path in ROOT.glob("examples/python/*.py"):
        text = path.read_text()
        assert "import hypose" in text or "from hypose import" in text, path.name
        assert not re.search(r"hypose\.\w+\.\w+ import|import hypose\.", text), path.name


def test_convert_calibration(tmp_path):
    write_calibration(small_scene(1, 2).rig, tmp_path / "a.toml")
    said = run(ROOT / "examples/python/convert_calibration.py", tmp_path / "a.toml", tmp_path / "b" / "intri.yml")
    assert said.startswith("4 cameras: cam1") and (tmp_path / "b" / "extri.yml").is_file()


@pytest.mark.slow
def test_read_results(tmp_path):
    write_masks(small_scene(1, 6), tmp_path / "walk")
    run("-m", "hypose", "track", tmp_path / "walk", "--no-overlay", "--formats", "csv")
    assert "6 of 6 frames; right knee" in run(
        ROOT / "examples/python/read_results.py", tmp_path / "walk" / "results" / "default"
    )


def test_the_table_of_recordings_can_be_read():
    assert len(read_table(ROOT / "examples/cluster/study.csv")) == 4


def test_the_reference_has_every_name():
    text = api_page()
    for name in hypose.__all__[1:]:
        assert f"### {name}\n\n```python\n" in text, name
    assert "<" not in re.sub(r"```.*?```", "", text, flags=re.DOTALL).replace("&lt;", "")


def test_every_page_is_in_the_site():
    # the file is YAML of the simplest kind
    text = (ROOT / "mkdocs.yml").read_text()
    named = set(re.findall(r"[\w-]+\.md", text[text.index("nav:") :]))
    assert named == {p.name for p in ROOT.glob("docs/**/*.md")} | {"api.md"}  # generated


def test_links_between_pages_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[\w-]+)?\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def commands():
    """(page, words) of every `hypose ...` line in a shell block of the documentation."""
    for page in PAGES:
        for block in re.findall(r"```(?:sh|bash|)\n(.*?)```", page.read_text(), re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                found = re.match(r"\s*(?:\S*/)?hypose\s+(.*)", line.split("  #")[0].split(" && ")[-1])
                if found and "COMMAND" not in line:
                    yield page.name, shlex.split(found[1], comments=True)


@pytest.mark.parametrize(("page", "words"), list(commands()), ids=lambda x: x if isinstance(x, str) else " ".join(x))
def test_commands_in_the_documentation_exist(page, words):
    command = app
    while isinstance(command, click.Group):
        assert words and words[0] in command.list_commands(None), words
        command, words = command.get_command(None, words[0]), words[1:]
    known = {o for p in command.params for o in (*p.opts, *p.secondary_opts)}
    given = {w.partition("=")[0] for w in words if re.match(r"--[a-z]", w)}
    assert given <= known, f"{page}: {given - known}"


def test_every_command_is_in_the_table_of_the_documentation():
    table = re.findall(r"^\| `hypose ([a-z-]+)", (ROOT / "docs" / "index.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(table) == sorted(app.list_commands(None))


def test_toml_in_the_documentation_is_toml():
    for page in PAGES:
        for block in re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL):
            tomllib.loads(block)
