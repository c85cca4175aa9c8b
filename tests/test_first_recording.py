"""docs/first-recording.md as a newcomer follows it: every command as it stands there, on the recording made up."""

import re
import shlex

import numpy as np
import pytest

from hypose.app.cli import run_cli
from hypose.io.motions.results import load_motion
from hypose.pipeline.comparison import compare_with_truth
from tests import missing
from tests.conftest import ROOT

PAGE = (ROOT / "docs/first-recording.md").read_text()


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.long
def test_from_four_videos_and_a_board_to_opensim(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for block in blocks("sh"):
        words = shlex.split(block)
        with pytest.raises(SystemExit) as stopped:
            run_cli(words[1:])
        assert stopped.value.code in (None, 0), f"{block}: {capsys.readouterr().err}"
        if words[1] == "calibrate":
            (tmp_path / "session/recording.toml").write_text(blocks("toml")[0])
    results = tmp_path / "session/results/default"
    motion = load_motion(results / "motion.npz")
    assert not motion.lost.any()
    # the board's place on the floor is the origin of the truth as well
    assert np.median(compare_with_truth(tmp_path / "session/truth.npz", motion, 0).distances) < 0.03
    opensim = missing.module("opensim", "agreement with OpenSim", "pip install opensim")
    angles = opensim.TimeSeriesTable(str(results / "motion.mot"))
    markers = opensim.TimeSeriesTableVec3(str(results / "motion.trc"))
    assert angles.getNumRows() == markers.getNumRows() == len(motion)
    assert "knee_angle_r" in angles.getColumnLabels() and "left_knee" in markers.getColumnLabels()
