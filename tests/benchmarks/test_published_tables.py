"""The published comparisons: what their scenes are and how their rows are made of runs."""

import numpy as np
import pytest

from benchmarks.multiview import table_2_4
from benchmarks.multiview.action_scenes import Outcome
from benchmarks.multiview.table_2_3 import table_rows
from hypose.synthetic.metrics import EVALUATED_JOINTS


def rows_by_name(rows):
    return {(r.metric, r.case): r for r in rows}


def test_table_2_3_takes_the_mean_over_actions_then_the_median_over_seeds():
    def outcome(mm: float) -> Outcome:
        return Outcome(np.full((4, len(EVALUATED_JOINTS)), 1e-3 * mm), 0.1)

    found = {
        ("apf", "walk"): [outcome(x) for x in (50, 60, 70)],
        ("apf", "box"): [outcome(x) for x in (150, 40, 90)],
        ("hpf-apo", "walk"): [outcome(x) for x in (30, 35, 32)],
        ("hpf-apo", "box"): [outcome(x) for x in (40, 45, 130)],
    }
    rows = rows_by_name(table_rows(found, ("walk", "box")))
    assert rows["mean_error_mm", "apf/walk"].value == pytest.approx(60)
    assert rows["mean_error_mm", "apf/all"].value == pytest.approx(80)  # of 100, 50, 80
    apo = rows["mean_error_mm", "hpf-apo/all"]
    assert apo.value == pytest.approx(40) and apo.baseline_value == pytest.approx(80)
    assert rows["lost_share", "hpf-apo/box"].value == 0


def test_table_2_4_averages_extremities_and_actions():
    def outcome(mm: float) -> table_2_4.ExtremityOutcome:
        return table_2_4.ExtremityOutcome(np.full((3, 5), 1e-3 * mm), 0.1)

    detected = table_2_4.Detected([], np.array([0.5, 0.7, 1.0]), np.array([0.03, 0.04, np.nan]), 0.02)
    found, all_detected = {}, {}
    for seed in ("0", "1", "2"):
        for k, action in enumerate(table_2_4.ACTIONS):
            found[action, seed] = {
                p: outcome(30 + 10 * k + int(seed) * (n + 1)) for n, p in enumerate(table_2_4.PRESETS)
            }
            all_detected[action, seed] = detected
    rows = rows_by_name(table_2_4.table_rows(found, all_detected))
    assert rows["extremity_error_mm", "apf"].value == pytest.approx(41)
    assert rows["extremity_error_mm", "dd-hpf+"].value == pytest.approx(44)
    assert rows["extremity_error_mm", "hpf/punch"].baseline_value == pytest.approx(51)
    assert rows["detection_recall", "right_hand"].value == pytest.approx(0.7)
    assert np.isnan(rows["detection_error_mm", "head"].value)
