"""The published comparisons: what their scenes are and how their rows are made of runs."""

import numpy as np
import pytest
from scipy.stats import ttest_rel

from benchmarks.multiview.action_scenes import Outcome
from benchmarks.multiview.paired import paired_rows
from benchmarks.multiview.table_2_3 import PRODUCT, table_rows
from hypose.synthetic.metrics import EVALUATED_JOINTS


def rows_by_name(rows):
    return {(r.metric, r.case): r for r in rows}


def test_the_product_table_takes_the_mean_over_actions_then_the_median_over_seeds():
    def outcome(mm: float) -> Outcome:
        return Outcome(np.full((4, len(EVALUATED_JOINTS)), 1e-3 * mm), 0.1)

    found = {
        ("default", "walk"): [outcome(x) for x in (50, 60, 70)],
        ("default", "box"): [outcome(x) for x in (150, 40, 90)],
        (PRODUCT, "walk"): [outcome(x) for x in (30, 35, 32)],
        (PRODUCT, "box"): [outcome(x) for x in (40, 45, 130)],
    }
    rows = rows_by_name(table_rows(found, ("walk", "box")))
    assert rows["mean_error_mm", "default/walk"].value == pytest.approx(60)
    assert rows["mean_error_mm", "default/all"].value == pytest.approx(80)  # of 100, 50, 80
    own = rows["mean_error_mm", f"{PRODUCT}/all"]
    assert own.value == pytest.approx(40) and own.baseline_value == pytest.approx(80)
    assert rows["lost_share", f"{PRODUCT}/box"].value == 0


def test_paired_differences_have_the_interval_of_students_t():
    errors = {"apf": [50, 70, 60, 80], "hpf": [40, 50, 50, 60], "literal": [90, 100]}
    rows = rows_by_name(paired_rows("error_mm", errors, [("apf", "hpf")], ["walk", "box", "walk", "box"]))
    assert rows["error_mm", "apf"].value == 65 and rows["error_mm", "apf/box"].value == 75
    assert rows["error_mm", "literal"].n == 2 and rows["error_mm", "literal/walk"].value == 90
    low, high = (rows[f"difference_{end}_mm", "apf - hpf"].value for end in ("low", "high"))
    interval = ttest_rel(errors["apf"], errors["hpf"]).confidence_interval(0.95)
    assert (low, high) == pytest.approx((interval.low, interval.high))
    assert rows["difference_mm", "apf - hpf"].value == pytest.approx(15)
