"""What a monocular track is measured by."""

import numpy as np
import pytest

from benchmarks.bench_report import BenchOptions
from benchmarks.one_camera.mono_benchmarks import ABLATIONS, ARM, BODY, mono_arm
from benchmarks.one_camera.mono_runs import KEPT_FRAMES, MonoRun, pictures, solve_scene, track_scene
from benchmarks.synthetic.mono_scenes import arm_scene


def run(errors, pixels, kind="arm"):
    t, m = errors.shape
    there = np.ones((t, m), dtype=bool)
    return MonoRun("x", kind, errors, errors, pixels, errors.mean(1), there, there, np.ones(t), np.ones((t, 5)))


def test_a_track_is_kept_when_it_ends_near_the_truth() -> None:
    near, far = np.full((40, 3), 0.05), np.full((40, 3), 0.30)
    assert run(near, 100 * near).kept
    assert not run(far, 10 * far).kept  # near in the picture, far in space
    left = near.copy()
    left[-KEPT_FRAMES:] = 0.4
    assert not run(left, 100 * left).kept
    assert not run(near, np.full((40, 3), 20.0), "body").kept
    assert run(near, np.full((40, 3), 20.0), "arm").kept


def test_ablations_change_one_thing_each() -> None:
    changed = {name: ablation(BODY) for name, ablation in ABLATIONS.items()}
    assert len(set(changed.values())) == len(ABLATIONS)
    assert BODY not in changed.values()
    assert changed["single"].search.hypotheses == 1
    assert changed["gaussian"].edge.form == changed["gaussian"].flow.form == "gaussian"
    assert not changed["no_flow"].flow.use
    assert changed["no_velocity"].velocity == 0
    assert (ARM.search.hypotheses, ARM.search.directions) == (3, 1)


def test_an_arm_is_followed_for_a_moment() -> None:
    scene = arm_scene(101)
    got = track_scene(scene, ARM, pictures(scene, 0.4))
    assert got.errors.shape == (9, 3)
    assert got.kept
    assert got.mean < 0.08
    assert got.inside.shape == got.errors.shape
    assert (got.oracle <= got.errors.mean(1) + 1e-9).all()
    again, whole = solve_scene(scene, ARM, pictures(scene, 0.4))
    np.testing.assert_array_equal(got.errors, again.errors)
    assert whole.errors.shape == got.errors.shape
    assert whole.mean < 0.08


@pytest.mark.slow
def test_the_arm_benchmark_names_its_rows() -> None:
    rows = mono_arm(BenchOptions(quick=True, seeds=1, first_seed=101)).rows
    assert {r.case for r in rows if r.metric == "kept_track"} == {
        "robust_3",
        "robust_1",
        "gaussian_1",
        "robust_3/whole_clip",
        "robust_1/whole_clip",
    }
