"""Rerun recordings: what is written of a motion, and one sentence where Rerun is not installed."""

import importlib
import os
import subprocess
import sys
import types

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hypose.errors import InputError
from hypose.io.motions.export import export_motion
from tests import missing


class _Stream:
    """What a recording stream was told, in place of a file."""

    def __init__(self, name, recording_id):
        self.times, self.logged = [], []

    def save(self, path):
        with open(path, "wb") as file:
            file.write(b"RRF2")

    def set_time(self, timeline, **value):
        self.times.append((timeline, value))

    def log(self, place, what, static=False):
        self.logged.append((place, what, static))

    def flush(self):
        pass

    disconnect = flush


@pytest.fixture
def streams(monkeypatch):
    made = []

    def stream(*given, **named):
        made.append(_Stream(*given, **named))
        return made[-1]

    archetype = lambda name: lambda *given, **named: (name, given, named)  # noqa: E731
    module = types.ModuleType("rerun")
    module.RecordingStream = stream
    module.ViewCoordinates = types.SimpleNamespace(RIGHT_HAND_Z_UP="z up")
    for name in ("LineStrips3D", "Points3D", "Ellipsoids3D", "Mesh3D"):
        setattr(module, name, archetype(name))
    monkeypatch.setitem(sys.modules, "rerun", module)
    return made


def test_what_is_written(tmp_path, small_motion, small_body, streams):
    (path,) = export_motion(small_motion, small_body, tmp_path, ["rrd"])
    assert path.name == "motion.rrd" and [p.name for p in tmp_path.iterdir()] == ["motion.rrd"]
    (stream,) = streams
    assert ("/", "z up", True) in stream.logged
    seconds = [value["duration"] for timeline, value in stream.times if timeline == "time"]
    np.testing.assert_allclose(seconds, small_motion.times)
    points = [what for place, what, _ in stream.logged if place == "person/joints"]
    for joints, (_, (given,), named) in zip(small_motion.joints, points, strict=True):
        seen = np.isfinite(joints).all(1)
        np.testing.assert_allclose(given, joints[seen])
        assert len(named["labels"]) == seen.sum()
    for t, (_, _, named) in enumerate(w for place, w, _ in stream.logged if place == "person/regions_90"):
        covariance = small_motion.joint_covariance[t]
        known = np.isfinite(small_motion.joints[t]).all(1) & np.isfinite(covariance).all((1, 2))
        turn = Rotation.from_quat(named["quaternions"]).as_matrix()
        back = np.einsum("jab,jb,jcb->jac", turn, named["half_sizes"] ** 2 / 6.2514, turn)  # chi-square, 90 % of 3
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
