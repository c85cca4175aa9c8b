"""The published comparisons: what their scenes are and how their rows are made of runs."""

import json
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from benchmarks.bench_report import BenchOptions
from benchmarks.multiview import court, table_2_4
from benchmarks.multiview.action_scenes import Outcome, median_row
from benchmarks.multiview.table_2_3 import table_rows
from hypose.io.motions.results import to_json
from hypose.synthetic.metrics import EVALUATED_JOINTS, JointErrors


def rows_by_name(rows):
    return {(r.metric, r.case): r for r in rows}


def test_the_median_over_seeds_leaves_out_what_is_missing():
    row = median_row("m", "c", [1.0, 5.0, 2.0, float("nan")], "mm")
    assert (row.value, row.n) == (2.0, 3)
    assert np.isnan(median_row("m", "c", [float("nan")], "mm").value)


def test_table_2_3_takes_the_mean_over_actions_then_the_median_over_seeds():
    def outcome(mm: float) -> Outcome:
        return Outcome(JointErrors(np.full((4, len(EVALUATED_JOINTS)), 1e-3 * mm), EVALUATED_JOINTS), 0.1)

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


def test_outcomes_survive_json():
    distances = np.array([[0.1, np.nan, 1e-17], [0.3, 0.2, 0.1]])
    outcome = Outcome(JointErrors(distances, ("a", "b", "c")), 0.25)
    again = Outcome.of(json.loads(to_json(outcome.plain())))
    np.testing.assert_array_equal(again.errors.distances, distances)
    assert again.errors.names == ("a", "b", "c") and again.seconds_per_frame == 0.25


def test_table_2_4_is_made_of_kept_parts(tmp_path, monkeypatch):
    measured = []

    def run(action, seed, seconds):
        measured.append((action, seed))
        outcome = table_2_4.ExtremityOutcome(np.full((3, 5), 0.01 * (seed + 1)), 0.1)
        seen = table_2_4.Detected([], np.array([0.5, 0.7, 1.0]), np.array([0.03, 0.04, np.nan]), 0.02)
        return dict.fromkeys(table_2_4.PRESETS, outcome), seen

    monkeypatch.setattr(table_2_4, "run_scene", run)
    two, three = (table_2_4.table_2_4(BenchOptions(seeds=n, parts=tmp_path)) for n in (2, 3))
    assert sorted(measured) == sorted((a, s) for a in table_2_4.ACTIONS for s in (0, 1, 2))  # each once
    assert rows_by_name(two.rows)["extremity_error_mm", "apf"].value == pytest.approx(15)
    found = rows_by_name(three.rows)
    assert found["extremity_error_mm", "apf"].value == pytest.approx(20)
    assert found["seconds_per_frame", "hpf"].ratio == 1 and np.isnan(found["detection_error_mm", "head"].value)


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


def test_ixmas_people_leave_hands_and_face_bare_in_other_colours_than_their_clothes():
    for seed in range(6):
        scene = table_2_4.ixmas_scene("wave", seed, 0.2)
        color, part = scene._outfits[0].color, scene.subject.main_joint
        hand = color[part == 8].mean(0)
        for joint in (7, 11, 2, 13):  # forearms, chest, thigh
            cloth = color[part == joint].mean(0)
            same_hue = np.abs(np.log(hand / hand.sum()) - np.log(cloth / cloth.sum())).max()
            assert same_hue > 0.15 or cloth.sum() < 0.5 * hand.sum()


def test_the_annotated_ends_of_body_and_subject_agree():
    """The tracker's body at the given start: hands, head and feet within 5 cm of the truth, by the same definition."""
    from benchmarks.multiview.action_scenes import known_subject

    scene = table_2_4.ixmas_scene("punch", 0, 0.2)
    start = known_subject(scene)
    distance = np.linalg.norm(table_2_4.estimated_ends(start.body, start.start) - table_2_4.true_ends(scene, 0), axis=1)
    assert distance.max() < 0.05


def test_the_absent_person_is_in_no_mask_and_the_other_one_is():
    scene, present = court.court_scene("away", 1, 2.4)
    assert (~present).sum() == 15
    away = int(np.flatnonzero(~present)[2])
    assert all(scene.clean_mask(c, away).sum() == 0 for c in range(4))
    assert all(scene.clean_mask(c, 0).sum() > 0 for c in range(4))
    only_other = replace(scene, corruption=replace(scene.corruption, desync=(0,), blobs=0.0))
    frame = next(islice(only_other.mask_frames(0.5), away, None))
    assert frame.silhouettes is not None and frame.silhouettes.areas.max() > 50


def test_recovery_counts_from_the_return_and_must_last():
    present = np.array([True] * 5 + [False] * 5 + [True] * 15)
    errors = np.full(25, 0.05)
    errors[10:13] = 0.5
    assert court._recovery(errors, present, 25.0) == pytest.approx(3 / 25)
    errors[16] = 0.5  # found, lost again two frames later, found for good
    assert court._recovery(errors, present, 25.0) == pytest.approx(7 / 25)
    assert court._recovery(np.full(25, 0.5), present, 25.0) == float("inf")
    assert np.isnan(court._recovery(errors, np.ones(25, bool), 25.0))


def test_a_court_s_person_is_small():
    scene, _ = court.court_scene("serve", 2, 0.2)
    rows = np.flatnonzero(scene.clean_mask(0, 0).any(1))
    assert 55 < np.ptp(rows) < 110
