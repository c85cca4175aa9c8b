"""The comparison with the kept figures of the golden clips, without tracking any."""

import json

import pytest

from benchmarks import bench_list, golden
from benchmarks.bench_report import BenchReport, Row

TOLERANCES = {"mean_error_mm": {"more": 0.3}, "verdict": {}, "time_ratio": {"times": 1.25}}
OLD = {"mean_error_mm": 20.0, "verdict": 1.0, "time_ratio": 40.0}


def lines(**changed):
    return list(golden.beyond({"walk": OLD}, {"walk": {**OLD, **changed}}, TOLERANCES))


def test_what_is_within_the_tolerance_or_better_passes():
    assert lines() == lines(mean_error_mm=20.3, time_ratio=50.0) == lines(mean_error_mm=5.0, time_ratio=1.0) == []


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"mean_error_mm": 20.4}, "walk: mean_error_mm 20.4, kept 20, at most 20.3"),
        ({"time_ratio": 51.0}, "walk: time_ratio 51, kept 40, at most 50"),
        ({"verdict": 0.0}, "walk: verdict good, kept look"),
        ({"verdict": 2.0}, "walk: verdict not to be trusted, kept look"),
    ],
)
def test_one_line_says_what_is_beyond(changed, said):
    assert lines(**changed) == [said]


@pytest.fixture
def measured(monkeypatch, tmp_path):
    """measured(error, failed) makes what the next run of `golden` measures; the kept file is one of its own."""
    monkeypatch.setattr(golden, "KEPT", tmp_path / "golden.json")
    tolerances = {m: TOLERANCES[m] for m in ("mean_error_mm", "time_ratio")}
    golden.KEPT.write_text(json.dumps({"tolerances": tolerances, "golden": {}, "other": {}}))

    def set_to(error, failed=None, clips="golden", time=40.0):
        settings = {"clips": clips, "quick": False, "skipped": ["uu4cam"], "failed": failed or {}}
        rows = (Row("mean_error_mm", "walk", error, "mm"), Row("time_ratio", "walk", time, "1"))
        made = BenchReport(rows, settings)
        known = {"golden": {"": bench_list.Benchmark(lambda options: made, "other")}}
        monkeypatch.setattr(bench_list, "benchmarks", lambda: known)

    return set_to


def test_the_command_keeps_and_compares_each_set_of_clips(bench, measured):
    measured(20.0)
    code, said, _ = bench("golden")
    assert code == 1 and "walk: mean_error_mm 20, nothing is kept" in said and "SKIPPED: uu4cam" in said
    assert bench("golden", "--keep")[0] == 0 and bench("golden")[0] == 0
    measured(20.5)
    code, said, _ = bench("golden")
    assert code == 1 and "WORSE: walk: mean_error_mm 20.5, kept 20, at most 20.3" in said and "--keep" in said
    measured(30.0, clips="other")
    assert bench("golden", "--other", "--keep")[0] == 0
    kept = golden.document()
    assert kept["golden"]["walk"]["mean_error_mm"] == 20.0 and kept["other"]["walk"]["mean_error_mm"] == 30.0


def test_a_clip_that_is_refused_fails_even_when_the_rest_is_kept(bench, measured):
    measured(20.0, {"box": "No person was found."})
    assert bench("golden", "--keep")[0] == 1
    code, said, _ = bench("golden")
    assert code == 1 and "WORSE: box: No person was found." in said
