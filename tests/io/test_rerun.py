"""Rerun recordings: what is written of a motion, and one sentence where Rerun is not installed."""

import importlib
import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hypose.errors import InputError
from hypose.io.motions.export import export_motion
from tests import missing


@pytest.fixture
def rerun(monkeypatch):
    """A stand-in for Rerun whose recording stream writes a file and notes what is logged."""
    module = MagicMock()
    module.RecordingStream.return_value.save.side_effect = lambda path: Path(path).write_bytes(b"RRF2")
    monkeypatch.setitem(sys.modules, "rerun", module)
    return module


def test_what_is_written(tmp_path, small_motion, small_body, rerun):
    (path,) = export_motion(small_motion, small_body, tmp_path, ["rrd"])
    assert path.name == "motion.rrd" and [p.name for p in tmp_path.iterdir()] == ["motion.rrd"]
    stream = rerun.RecordingStream.return_value
    stream.log.assert_any_call("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    seconds = [c.kwargs["duration"] for c in stream.set_time.call_args_list if c.args == ("time",)]
    np.testing.assert_allclose(seconds, small_motion.times)
    for joints, call in zip(small_motion.joints, rerun.Points3D.call_args_list, strict=True):
        seen = np.isfinite(joints).all(1)
        np.testing.assert_allclose(call.args[0], joints[seen])
        assert len(call.kwargs["labels"]) == seen.sum()
    for t, call in enumerate(rerun.Ellipsoids3D.call_args_list):
        covariance = small_motion.joint_covariance[t]
        known = np.isfinite(small_motion.joints[t]).all(1) & np.isfinite(covariance).all((1, 2))
        turn = Rotation.from_quat(call.kwargs["quaternions"]).as_matrix()
        back = np.einsum("jab,jb,jcb->jac", turn, call.kwargs["half_sizes"] ** 2 / 6.2514, turn)  # chi-square, 90 %
        np.testing.assert_allclose(back, covariance[known], atol=1e-8)


def test_the_real_package_reads_it(tmp_path, small_motion, small_body):
    missing.module("rerun", "Rerun recordings", "pip install 'hypose[rerun]'")
    (path,) = export_motion(small_motion, small_body, tmp_path, ["rrd"])

    def viewer(*words):
        own = {**os.environ, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path), "XDG_DATA_HOME": str(tmp_path)}
        return subprocess.run([sys.executable, "-m", "rerun", *words], capture_output=True, text=True, env=own)

    said = viewer("rrd", "verify", str(path))
    assert said.returncode == 0, said.stderr
    shown = viewer("rrd", "print", str(path))
    for place in ("/person/joints", "/person/bones", "/person/regions_90", "/person/body"):
        assert place in shown.stdout


def test_without_rerun_one_sentence_before_anything_is_written(tmp_path, small_motion, small_body, monkeypatch):
    def absent(name):
        raise ModuleNotFoundError(name, name=name)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(
        InputError, match=r'needs rerun-sdk, which is not installed; run: pip install "hypose\[rerun\]"\.'
    ):
        export_motion(small_motion, small_body, tmp_path / "out", ["trc", "rrd"])
    assert not (tmp_path / "out").exists()
