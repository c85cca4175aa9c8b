"""The speed gate: exit status by the ratios, without measuring anything."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

GATE = Path(__file__).parents[2] / "benchmarks" / "gate.py"


@pytest.fixture
def gate(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("gate", GATE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "BASELINE", tmp_path / "baseline.json")
    monkeypatch.setattr(module, "warm_up", lambda: 0.0)
    monkeypatch.setattr(module, "solve", lambda: {"contour-solve contours": 5.0})
    monkeypatch.setattr(sys, "argv", ["gate.py"])
    ratios = {
        "silhouette-scorer 1t": {"ratio": 0.01, "margin": 1.5},
        "contour-solve contours": {"ratio": 4.0, "margin": 1.5},
    }
    module.BASELINE.write_text(json.dumps({"ratios": ratios}))
    return module


def measured(gate, monkeypatch, values):
    values = iter(values)
    monkeypatch.setattr(gate, "scorer", lambda: {"silhouette-scorer 1t": next(values)})


def test_passes_within_the_margin_and_fails_beyond_it(gate, monkeypatch):
    measured(gate, monkeypatch, [0.0149])
    assert gate.main() == 0
    measured(gate, monkeypatch, [0.0151] * 3)
    assert gate.main() == 1


def test_a_busy_moment_is_measured_again(gate, monkeypatch, capsys):
    measured(gate, monkeypatch, [0.05, 0.012])
    assert gate.main() == 0
    assert "attempt 1" in capsys.readouterr().out


def test_update_writes_the_baseline_and_keeps_margins(gate, monkeypatch):
    measured(gate, monkeypatch, [0.5])
    monkeypatch.setattr(sys, "argv", ["gate.py", "--update"])
    assert gate.main() == 0
    written = json.loads(gate.BASELINE.read_text())["ratios"]
    assert written["silhouette-scorer 1t"] == {"ratio": 0.5, "margin": 1.5}


def test_a_figure_without_baseline_fails(gate, monkeypatch):
    gate.BASELINE.unlink()
    measured(gate, monkeypatch, [0.01])
    assert gate.main() == 1


def test_the_committed_baseline_has_a_margin_for_every_ratio():
    document = json.loads(GATE.with_name("baseline.json").read_text())
    assert document["ratios"].keys() == {"silhouette-scorer 1t", "contour-solve contours"}
    assert all(1.2 <= r["margin"] <= 2.5 and r["ratio"] > 0 for r in document["ratios"].values())
