"""Pages of figures: every benchmark is on one, and nothing kept has no origin."""

import json
import re

import pytest

from benchmarks import pages
from benchmarks.bench_list import benchmarks, find_benchmark, kept_name
from benchmarks.targets import TARGETS, Figure

KEPT = pages.documents()


def test_every_benchmark_is_on_the_page_and_every_shown_figure_is_kept():
    every = {kept_name(name, case) for name, cases in benchmarks().items() for case in cases}
    assert {b.name for b in TARGETS} == every - {"golden"}  # golden.json keeps that one
    for benchmark in TARGETS:
        if benchmark.name in KEPT:
            rows = pages.rows_of(KEPT[benchmark.name])
            assert [f for f in benchmark.figures if (f.metric, f.case) not in rows] == []


@pytest.mark.parametrize("name", KEPT)
def test_a_kept_document_tells_where_it_comes_from(name):
    document = KEPT[name]
    assert document["name"] == name and not document["settings"]["quick"]
    assert re.fullmatch(r"[0-9a-f]{7,40}", document["commit"])  # no +: the code was committed
    assert re.fullmatch(r"20\d\d-\d\d-\d\dT\d\d:\d\d\+00:00", document["date"])
    base, case, _ = find_benchmark(name)
    called = f"./run bench {base} --case {case}" if case else f"./run bench {base}"
    assert document["command"].startswith(called) and " /" not in document["command"]
    assert {"processor", "cores", "python", "load"} <= set(document["machine"])
    assert document["seconds"] > 0 and document["results"]
    json.dumps(document, allow_nan=False)


ROWS = {
    ("error_mm", "apf"): {"value": 50.0, "ratio": None},
    ("error_mm", "hpf"): {"value": 40.0, "ratio": 0.8},
    ("error_mm", "never"): {"value": None, "ratio": None},
}


@pytest.mark.parametrize(
    ("figure", "met"),
    [
        (Figure("error_mm", "apf"), None),
        (Figure("error_mm", "apf", at_most=45), False),
        (Figure("error_mm", "apf", at_least=50, at_most=60), True),
        (Figure("error_mm", "hpf", at_most=0.9, of="apf"), True),
        (Figure("error_mm", "hpf", at_least=0.85, ratio=True), False),
        (Figure("error_mm", "never", at_most=1), False),
        (Figure("error_mm", "gone", at_most=1), None),
    ],
)
def test_a_target_is_met_or_missed(figure, met):
    assert figure.met(ROWS) is met
