"""The page of figures: every benchmark has an entry, and nothing kept has no origin."""

import json
import re

import pytest

from benchmarks import pages
from benchmarks.bench_list import benchmarks, run_benchmark
from benchmarks.bench_origin import ROOT, YARDSTICK, beside_yardstick
from benchmarks.bench_report import BenchReport, Row
from benchmarks.bench_tables import Column, Line, Page, cell, least, most, table, verdicts, within
from hypose.errors import InputError

KEPT = pages.documents()


def test_every_benchmark_has_an_entry_and_every_entry_a_benchmark():
    assert set(pages.pages()) == set(benchmarks()) - {"golden"}  # golden.json keeps that one
    text = pages.page_text({})
    for name in pages.pages():
        assert f"### {name}\n" in text and f"`./run bench {name} --keep`" in text


@pytest.mark.parametrize("name", KEPT)
def test_a_kept_document_tells_where_it_comes_from(name):
    document = KEPT[name]
    assert document["name"] == name and not document["settings"]["quick"]
    assert re.fullmatch(r"[0-9a-f]{7,40}", document["commit"])  # no +: the code was committed
    assert re.fullmatch(r"20\d\d-\d\d-\d\dT\d\d:\d\d\+00:00", document["date"])
    assert document["command"].startswith(f"./run bench {name}") and " /" not in document["command"]
    assert {"processor", "cores", "python", "load"} <= set(document["machine"])
    assert document["seconds"] > 0 and document["results"]
    json.dumps(document, allow_nan=False)


@pytest.mark.parametrize("name", KEPT)
def test_kept_speeds_have_a_ratio_of_the_same_run(name):
    for r in KEPT[name]["results"]:
        plain = Row(r["metric"], r["case"], r["value"] or 0.0, r["unit"], baseline=r["baseline"])
        if beside_yardstick(plain, 300.0) != plain:
            raise AssertionError(f"{r['metric']} {r['case']} has no ratio")


ROWS = {
    (m, c): {"metric": m, "case": c, "value": v, "unit": u, "sd": sd, "n": 3, "baseline": b, "ratio": r}
    for m, c, v, u, sd, b, r in (
        ("error_mm", "apf/walk", 50.04, "mm", 3.21, None, None),
        ("error_mm", "hpf/walk", 40.0, "mm", None, "apf/walk", 0.8),
        ("recovery_s", "hpf", None, "s", None, None, None),
        ("ms_per_frame", "fit", 0.25, "ms", None, YARDSTICK, 0.5),
    )
}


def test_a_table_shows_figures_spreads_and_bars():
    columns = (Column("walk", "error_mm", "{}/walk", spread=True), Column("ratio", "error_mm", "{}/walk", ratio=True))
    lines = (
        Line("apf", "apf", (most(45), within(50, 60))),
        Line("hpf", "hpf", (most(0.9, 0, "apf"), least(0.85, 1))),
        Line("gone", "gone", (most(1),)),
    )
    assert table(Page("a", "prose", columns, lines), ROWS).splitlines() == [
        "|  | walk | ratio | bar |",
        "| --- | --- | --- | --- |",
        "| apf | 50 (3.2) |  | walk ≤ 45: **missed**; walk 50 to 60: met |",
        "| hpf | 40 | 0.8 | walk ≤ 0.9 x apf: met; ratio ≥ 0.85: **missed** |",
        "| gone |  |  | walk ≤ 1: not measured |",
    ]


def test_a_speed_stands_with_its_ratio_and_what_never_came_is_missed():
    page = Page(
        "a",
        "prose",
        lines=(Line("fit", "fit", (most(0.3),), "ms_per_frame"), Line("hpf", "hpf", (most(1),), "recovery_s")),
    )
    assert cell(page.columns[0], page.lines[0], ROWS) == f"0.25 ms, 0.5 x {YARDSTICK}"
    assert cell(page.columns[0], page.lines[1], ROWS) == "never"
    assert [met for line in page.lines for _, met in verdicts(page, line, ROWS)] == [True, False]


def test_a_document_says_what_was_called_and_compares_speeds(monkeypatch):
    from benchmarks import bench_list

    rows = (
        Row("ms_per_frame", "a", 2.0, "ms"),
        Row("recovery_s", "a", float("inf"), "s"),
        Row("frames_per_second", "a", 10.0, "1/s"),
    )
    made = bench_list.Benchmark(lambda options: BenchReport(rows, {"x": 1}), "seeds", "data")
    monkeypatch.setattr(bench_list, "benchmarks", lambda: {"a": made})
    monkeypatch.setattr(bench_list, "yardstick", lambda: 500.0)
    document = run_benchmark("a", seeds=2, data=ROOT)
    assert document["command"] == "./run bench a --seeds 2 --data DATA" and document["settings"] == {
        "x": 1,
        "quick": False,
    }
    assert [r["ratio"] for r in document["results"]] == [4.0, None, 0.005]
    assert [r["value"] for r in document["results"]] == [2.0, None, 10.0]


def test_quick_figures_and_figures_of_unknown_code_are_not_kept(monkeypatch):
    with pytest.raises(InputError, match="without --quick"):
        pages.check_keep("sync", True)
    monkeypatch.setattr(pages, "commit", lambda: None)
    with pytest.raises(InputError, match="git checkout"):
        pages.check_keep("sync", False)


def test_keeping_writes_document_picture_and_page(tmp_path, monkeypatch):
    for name, path in (("RESULTS", "results"), ("IMAGES", "images")):
        monkeypatch.setattr(pages, name, tmp_path / path)
        (tmp_path / path).mkdir()
    monkeypatch.setattr(pages, "PAGE", tmp_path / "benchmarks.md")
    report = KEPT["silhouette-scorer"]
    written = pages.keep_report(report)
    assert written == [
        tmp_path / "results/silhouette-scorer.json",
        tmp_path / "images/bench-silhouette-scorer.png",
        tmp_path / "benchmarks.md",
    ]
    assert json.loads(written[0].read_text()) == report and written[1].stat().st_size > 2000
    assert "| [silhouette-scorer](#silhouette-scorer) | 4 of 4 |" in written[2].read_text()
