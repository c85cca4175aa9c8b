"""Shape from silhouettes: known shapes are found again, rows have the derivatives they claim, filters keep to the
prior of Table 2.1."""

import tomllib

import numpy as np
import pytest

from benchmarks.papers.layered_anthropometry import (
    K,
    powell_start,
    shape_energy,
)
from hypose.body.anthropometry import SHAPE_FACTORS, body_of, entity, sizes_of
from hypose.errors import EvidenceError, InputError
from hypose.evidence.terms import contour_term
from hypose.pipeline.subject import (
    SubjectOptions,
    estimate_subject,
    find_subject,
    load_subject,
    save_subject,
)
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.shape_refinement import Known, ShapeSettings, refine_shape


def shape(**factors):
    x = np.zeros(len(SHAPE_FACTORS))
    for name, value in factors.items():
        x[entity(name.replace("_", " "))] = value
    return x


@pytest.fixture(scope="module")
def moving(body, standing):
    """Four different poses of a person who bends elbows and knees."""
    poses = np.repeat(standing[None], 4, 0)
    d = body.skeleton.dofs_of
    for k, (bend, lift) in enumerate(((0.0, 0.0), (0.8, 0.9), (0.4, 1.3), (1.0, 0.5))):
        poses[k, d("left_elbow")] += bend
        poses[k, d("right_elbow")] += 0.9 * (1 - bend)
        poses[k, d("left_shoulder")[1]] -= lift
        poses[k, d("right_shoulder")[1]] += 1.2 - lift
        poses[k, d("left_knee")] += 0.7 * bend
        poses[k, d("left_hip")[0]] -= 0.6 * bend
        poses[k, d("right_knee")] += 0.6 * (1 - bend)
        poses[k, 5] += 0.8 * k
    return body.skeleton.clamp(poses)


def test_shape_of_another_body_is_found_from_motion(body, moving, frame_of, rng):
    true = shape(
        scale=0.04, thigh_length=-0.06, shank_length=0.05, forearm_length=0.06, waist_width=0.15, thigh_girth=0.12
    )
    person = body_of(body, true)
    frames = [frame_of(person, q, k) for k, q in enumerate(moving)]
    starts = moving.copy()
    starts[:, 6:] += rng.normal(0, 0.04, starts[:, 6:].shape)
    starts[:, :3] += rng.normal(0, 0.01, (len(starts), 3))
    starts = body.skeleton.clamp(starts)
    contours = [[contour_term(f.silhouettes)] for f in frames]
    fit = refine_shape(body, starts, contours, known=Known(height=person.stature))
    want, got = person.segment_lengths(), fit.body.segment_lengths()
    for name in ("upper_arm", "forearm", "thigh", "shank"):
        assert got[f"left_{name}"] == pytest.approx(want[f"left_{name}"], abs=0.015), name
    assert fit.log_factors[entity("waist width")] == pytest.approx(0.15, abs=0.07)
    error = np.linalg.norm(fit.body.joints(fit.poses) - person.joints(moving), axis=-1).mean()
    before = np.linalg.norm(body.joints(starts) - person.joints(moving), axis=-1).mean()
    assert error < 0.4 * before
    assert np.linalg.eigvalsh(fit.covariance).min() > 0
    # evidence can only take uncertainty away
    assert (
        fit.covariance[entity("thigh length"), entity("thigh length")] < SHAPE_FACTORS[entity("thigh length")].sd ** 2
    )


def test_height_and_mass_are_kept(body, moving, frame_of):
    quick = ShapeSettings(iterations=(2, 3), coarse=(2.0, 1.0))
    contours = [[contour_term(frame_of(body, moving[0]).silhouettes)]]
    taller = refine_shape(body, moving[:1], contours, known=Known(height=body.stature + 0.02), options=quick)
    free = refine_shape(body, moving[:1], contours, options=quick)
    assert taller.body.stature > free.body.stature + 0.002
    heavy = refine_shape(body, moving[:1], contours, known=Known(mass=100.0), options=quick)
    assert heavy.body.coarse.volume > free.body.coarse.volume


def test_subject_from_the_hull_alone(body, standing, frame_of, tmp_path):
    person = body_of(body, shape(scale=0.05, thigh_girth=0.1, clothing=0.1))
    frames = [frame_of(person, standing, k) for k in range(3)]
    options = SubjectOptions("standing", frames=2, rate=25.0, passes=2)
    told = []
    found = estimate_subject(lambda i: frames[i], 3, options, lambda done, total: told.append((done, total)))
    assert told == sorted(told) and told[-1] == (9, 9)
    assert found.body.stature == pytest.approx(person.stature, abs=0.03)
    assert np.nanmin(found.iou) > 0.88 and np.nanmean(found.iou) > np.nanmean(found.iou_before)
    assert np.abs(found.body.joints(found.start) - person.joints(standing)).max() < 0.12
    assert found.sizes.girths["waist"] < sizes_of(found.body).girths["waist"]
    # written, read back, and used for the next recording of the person
    saved, toml = save_subject(tmp_path / "anna", found, 'the "first"')
    document = tomllib.loads(toml.read_text())
    assert document["sizes"]["stature"]["cm"] == pytest.approx(100 * found.naked.stature, abs=0.01)
    assert 0 < document["sizes"]["thigh"]["sd"] < 5 and set(document["factors"]) == {e.name for e in SHAPE_FACTORS}
    for path in (saved, toml, saved.parent):
        np.testing.assert_array_equal(load_subject(path).fine.vertices, found.body.fine.vertices)
    again = find_subject(lambda i: frames[i], 3, SubjectOptions(body=load_subject(saved), start="standing"))
    np.testing.assert_array_equal(again.body.coarse.vertices, found.body.coarse.vertices)
    assert np.abs(again.body.joints(again.start) - person.joints(standing)).max() < 0.12
    with pytest.raises(InputError, match="nobody"):
        load_subject(tmp_path / "nobody.npz")


def test_a_single_view_is_refused(body, standing, frame_of):
    frame = frame_of(body, standing, 0, dead=(1, 2, 3))
    with pytest.raises(EvidenceError, match="two views"):
        estimate_subject(lambda i: frame, 3)


# --- the thesis' filter -------------------------------------------------------------------------------------------


def test_powell_lowers_the_energy(body, standing, frame_of):
    person = body_of(body, shape(scale=0.05))
    frame = prepare(frame_of(person, standing), body, standing)
    start = standing.copy()
    start[body.skeleton.dofs_of("left_shoulder")[1]] -= 0.15
    found = powell_start(body, start, frame, evaluations=60)
    before = shape_energy(body, np.concatenate([np.zeros(K), start]), frame)
    assert shape_energy(body, found, frame) < 0.75 * before
