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


@pytest.mark.parametrize(
    ("values", "status"),
    [([0.0149], 0), ([0.0151] * 3, 1), ([0.05, 0.012], 0)],  # a busy moment is measured again
)
def test_a_ratio_beyond_its_margin_fails(gate, monkeypatch, values, status):
    measured(gate, monkeypatch, values)
    assert gate.main() == status


def test_update_writes_the_baseline_and_keeps_margins(gate, monkeypatch):
    measured(gate, monkeypatch, [0.5])
    monkeypatch.setattr(sys, "argv", ["gate.py", "--update"])
    assert gate.main() == 0
    written = json.loads(gate.BASELINE.read_text())["ratios"]
    assert written["silhouette-scorer 1t"] == {"ratio": 0.5, "margin": 1.5}
