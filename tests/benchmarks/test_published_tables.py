"""The published comparisons: what their scenes are and how their rows are made of runs."""

import pytest
from scipy.stats import ttest_rel

from benchmarks.multiview.paired import paired_rows


def rows_by_name(rows):
    return {(r.metric, r.case): r for r in rows}


def test_paired_differences_have_the_interval_of_students_t():
    errors = {"apf": [50, 70, 60, 80], "hpf": [40, 50, 50, 60], "literal": [90, 100]}
    rows = rows_by_name(paired_rows("error_mm", errors, [("apf", "hpf")], ["walk", "box", "walk", "box"]))
    assert rows["error_mm", "apf"].value == 65 and rows["error_mm", "apf/box"].value == 75
    assert rows["error_mm", "literal"].n == 2 and rows["error_mm", "literal/walk"].value == 90
    low, high = (rows[f"difference_{end}_mm", "apf - hpf"].value for end in ("low", "high"))
    interval = ttest_rel(errors["apf"], errors["hpf"]).confidence_interval(0.95)
    assert (low, high) == pytest.approx((interval.low, interval.high))
    assert rows["difference_mm", "apf - hpf"].value == pytest.approx(15)
