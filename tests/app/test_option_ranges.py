"""Every number that a command takes has a range, and what lies outside is refused in one sentence before any work."""

import click
import pytest

from hypose.app import cli
from hypose.options import declared

_NOWHERE = {
    "demo": ("--out", "FULL"),
    "calibrate": ("--points", "nowhere"),
    "keypoints": ("nowhere",),
    "correct": ("nowhere", "nowhere"),
    "synth": ("FULL",),
    "gesture train": ("FULL/model.npz", "--gesture", "wave", "--source", "nowhere"),
    "gesture eval": ("nowhere", "nowhere"),
}
"""Arguments with which a command ends before it works, where one name of nothing does not do."""
VALUES = ("-3", "nan", "1e300")
MORE = ("0", "inf", "-inf", "-1e300", str(10**30), str(-(10**30)), "", "three", "٣", "1_0")
"""For one option of each type: all are read by the same function."""


def commands(group=cli.app, before=""):
    """(name, command) of every command."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        yield from commands(command, f"{name} ") if isinstance(command, click.Group) else [(before + name, command)]


def numeric_options():
    """(command, option, its declaration) of every option whose type is a number."""
    for name, command in commands():
        for option in declared(command.declares):
            if option.kind in (int, float):
                yield name, option.flag, option


NUMBERS = list(numeric_options())
assert len(NUMBERS) > 50


@pytest.mark.parametrize(("command", "option", "of"), NUMBERS)
def test_a_number_out_of_range_is_one_sentence(hypose, tmp_path, monkeypatch, command, option, of):
    assert of.option.least is not None, "declare what it may be"
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("years of work")
    monkeypatch.chdir(tmp_path)
    rest = [a.replace("FULL", "full") for a in _NOWHERE.get(command, ("nowhere",))]
    for value in (*VALUES, *(MORE if option in ("--samples", "--threshold") else ())):
        code, _, err = hypose(*command.split(), *rest, option, value)
        assert code == 2, (value, err)
        assert "Traceback" not in err and "should not have happened" not in err, (value, err)
        if value not in ("0", "1_0", "٣"):
            assert option in err.splitlines()[-1] or option in ("--floor", "--offset") and value == "-3", (value, err)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["full", "thesis.txt"]


KEPT_OPTIONS = 'smooth = false\noverlay = false\nheight = 1.7\nrecipe = "hpf"\nhypotheses = 7\nsubject = "mine"\n'


def test_a_recording_keeps_options_of_track_which_the_command_line_overrides(tmp_path, monkeypatch):
    (tmp_path / "recording.toml").write_text(f"[track]\n{KEPT_OPTIONS}")
    made = []
    monkeypatch.setattr("hypose.app.jobs.person_job.track_command", made.append)
    for more in ((), ("--height", "1.8", "--recipe", "sir")):
        with pytest.raises(SystemExit, match="0"):
            cli.run_cli(["track", str(tmp_path), *more])
    kept, given = made
    assert (kept.smooth, kept.overlay, kept.height, kept.recipe, kept.particles) == (False, False, 1.7, "hpf", 7)
    assert kept.subject == str(tmp_path / "mine") and kept.report
    assert (given.height, given.recipe, given.particles) == (1.8, "sir", 7)


@pytest.mark.parametrize("line", ["hight = 1.7", "height = 30", 'recipe = "best"', "smooth = 3", 'out = "elsewhere"'])
def test_a_wrong_option_in_a_recording_is_named_with_the_file(hypose, tmp_path, line):
    (tmp_path / "recording.toml").write_text(f"[track]\n{line}\n")
    code, _, err = hypose("track", str(tmp_path))
    assert code == 2 and f"{tmp_path / 'recording.toml'}, track" in err and line.split()[0] in err
