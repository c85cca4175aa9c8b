"""Long benchmarks are measured part by part, and what was measured is kept."""

import numpy as np
import pytest

from benchmarks.bench_report import BenchOptions
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


@pytest.mark.parametrize("text", ['{"scores": [1', "[1, 2]"])
def test_a_damaged_part_is_named(tmp_path, text):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.json is no part of a benchmark"):
        BenchOptions(parts=tmp_path).part("a", dict)
