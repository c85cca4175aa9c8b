"""Long benchmarks are measured part by part, and what was measured is kept."""

import json

import numpy as np
import pytest

from benchmarks.bench_report import BenchOptions
from benchmarks.depth_gestures.gesture_scores import Judged
from hypose.errors import InputError


def test_a_part_is_measured_once(tmp_path):
    options, measured = BenchOptions(parts=tmp_path / "parts"), []

    def measure():
        measured.append(1)
        return {"scores": np.array([0.25, 1e-17])}

    first = options.part("table.0.tee", measure)
    assert options.part("table.0.tee", measure) == {"scores": first["scores"].tolist()}
    assert len(measured) == 1
    options.part("table.1.tee", measure)
    BenchOptions(parts=tmp_path / "parts", quick=True).part("table.0.tee", measure)  # smaller: another part
    assert len(measured) == 3


def test_without_a_folder_nothing_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert BenchOptions().part("a", lambda: {"x": 1}) == {"x": 1} and not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", ['{"scores": [1', "[1, 2]"])
def test_a_damaged_part_is_named(tmp_path, text):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.json is no part of a benchmark"):
        BenchOptions(parts=tmp_path).part("a", dict)


def test_judgements_survive_json():
    shown = np.array([True, False, True])
    judged = Judged(np.array([0.1, 3.0, 0.7]), np.array([2.0, np.inf, 11.0]), np.array([0.01, np.inf, 0.03]), shown)
    plain = {k: v if isinstance(v, list) else v.tolist() for k, v in judged.plain().items()}
    again = Judged.of(json.loads(json.dumps(plain, allow_nan=False)))
    for name in ("scores", "errors_px", "errors_m", "shown"):
        np.testing.assert_array_equal(getattr(judged, name), getattr(again, name))
    assert (again.ap(), again.ap_metres(), again.auc()) == (judged.ap(), judged.ap_metres(), judged.auc())
