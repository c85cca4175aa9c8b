from dataclasses import replace

import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.evidence.association import people_of
from hypose.evidence.keypoints import BODY_25
from hypose.evidence.one_person import moves_as, one_person, view_tracks
from hypose.geometry import se3, so3_exp
from tests.evidence.scenes import ring

FRAMES = 40
TWIN = [
    BODY_25.index(n.replace("left", "x").replace("right", "left").replace("x", "right")) if "_" in n else i
    for i, n in enumerate(BODY_25)
]
_HALF = {
    "shoulder": (0.18, 0, 1.45), "elbow": (0.25, 0, 1.15), "wrist": (0.27, 0.1, 0.90), "hip": (0.12, 0, 0.95),
    "knee": (0.13, 0, 0.50), "ankle": (0.13, 0, 0.08), "eye": (0.03, 0.1, 1.65), "ear": (0.07, 0, 1.63),
    "big_toe": (0.13, 0.2, 0.02), "small_toe": (0.17, 0.18, 0.02), "heel": (0.13, -0.05, 0.02),
}  # fmt: skip


def standing():
    """(25, 3) m: somebody upright at the origin, facing +y."""
    out = np.zeros((25, 3))
    for i, name in enumerate(BODY_25):
        side, _, part = name.partition("_")
        if side in ("left", "right"):
            x, y, z = _HALF[part]
            out[i] = (-x if side == "left" else x, y, z)
    for name, at in (("nose", (0, 0.12, 1.6)), ("neck", (0, 0, 1.45)), ("mid_hip", (0, 0, 0.95))):
        out[BODY_25.index(name)] = at
    return out


def walking(start, way, size=1.0, pace=0.4, frames=FRAMES):
    """(T, 25, 3) m: from a place on, `way` metres per frame, arms and legs swinging."""
    t = np.arange(frames)
    out = np.repeat(standing()[None] * size, frames, 0)
    for i, name in enumerate(BODY_25):
        if name.split("_", 1)[-1] in ("wrist", "elbow", "ankle", "knee", "heel", "big_toe"):
            out[:, i, 1] += 0.2 * np.sin(pace * t) * (1 if name.startswith("left") else -1)
    angle = np.arctan2(way[0], way[1])
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return out @ turn.T + np.array([*start, 0.0]) + t[:, None, None] * np.array([*way, 0.0])


def seen_by(rig, people, rng, noise=1.0):
    """Per frame and view the people (P, 25, 3), in random order."""
    out = []
    for t in range(len(people[0])):
        frame = []
        for camera in rig:
            found = np.stack([np.c_[camera.project_pinhole(p[t]), np.full(25, 0.9)] for p in people])
            found[..., :2] += rng.normal(0, noise, found[..., :2].shape)
            frame.append(found[rng.permutation(len(people))])
        out.append(frame)
    return out


A = walking((-1.2, 0.0), (0.05, 0.01))
B = walking((1.2, 0.4), (-0.05, 0.0), 1.08, pace=0.63)
RIG = ring(4, radius=4.0)


def error(person, truth):
    return np.nanmean(np.linalg.norm(person.world - truth[person.first : person.last + 1], axis=-1))


def test_two_people_who_pass_each_other_keep_their_identity():
    people = people_of(seen_by(RIG, [A, B], np.random.default_rng(0)), BODY_25, RIG)
    assert len(people) == 2
    for person in people:
        assert person.first == 0 and person.last == FRAMES - 1 and person.seen.all()
        assert min(error(person, A), error(person, B)) < 0.02
    assert {bool(error(p, A) < 0.02) for p in people} == {True, False}


def test_whom_one_view_alone_sees_is_nobody():
    rng = np.random.default_rng(1)
    frames = seen_by(RIG, [A], rng)
    bystander = seen_by(CameraRig((RIG[2],)), [B], rng)
    frames = [[*f[:2], np.concatenate([f[2], b[0]]), f[3]] for f, b in zip(frames, bystander, strict=True)]
    (person,) = people_of(frames, BODY_25, RIG)
    assert error(person, A) < 0.02
    found = one_person(frames, BODY_25, RIG)
    assert found.people and not found.apart and "only one view" in found.notes[0]


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_exchanged_sides_in_one_view_are_mended(share):
    rng = np.random.default_rng(2)
    frames = seen_by(RIG, [A], rng, noise=0.5)
    truth = [f[1].copy() for f in frames]
    for f in frames:
        if rng.random() < share:
            f[1] = f[1][:, TWIN]
    (person,) = people_of(frames, BODY_25, RIG)
    assert error(person, A) < 0.02
    mended = np.array([np.abs(p[1] - t[0])[:, :2].max(1) for p, t in zip(person.points, truth, strict=True)])
    sides = np.array([np.linalg.norm(t[0] - t[0, TWIN], axis=-1) for t in truth])
    assert (mended[sides > 12.0] < 1.0).mean() > 0.95


@pytest.mark.parametrize("beside_px", [None, (10.0, 0.0)])  # another camera's; 0.1 m: near enough to be followed
def test_a_view_whose_key_points_are_another_cameras_or_pass_by_is_left_out_and_said(beside_px):
    frames = seen_by(RIG, [A], np.random.default_rng(4))
    for f in frames:
        f[2] = f[1] if beside_px is None else f[2] + [*beside_px, 0.0]
    found = one_person(frames, BODY_25, RIG)
    assert found.people[0].seen.all() == (beside_px is not None)
    assert found.apart == (2,) and "c3" in found.notes[0]
    assert not found.points[:, 2, :, 2].any() and found.points[:, [0, 1, 3], :, 2].all()


def test_who_returns_is_the_same_person():
    frames = seen_by(RIG, [A], np.random.default_rng(5))
    for f in frames[8:30]:
        f[:] = [None] * 4
    found = one_person(frames, BODY_25, RIG)
    assert found.people and found.people[0].first == 0 and found.people[0].last == FRAMES - 1


def _moved(rig, view, degrees):
    cameras = list(rig)
    turn = se3(so3_exp(np.radians([0, degrees, 0])), np.zeros(3))
    cameras[view] = replace(cameras[view], camera_from_world=turn @ cameras[view].camera_from_world)
    return CameraRig(tuple(cameras))


@pytest.mark.parametrize("views", [(2,), (0, 1, 2, 3)])
def test_a_wrong_calibration_still_shows_one_person(views):
    """The doctor needs the same person in all views, of cameras that are not where they are said to be."""
    rng = np.random.default_rng(7)
    b = walking((0.8, -0.9), (-0.01, 0.03), pace=0.55)
    frames = seen_by(RIG, [A, b], rng)
    wrong = RIG
    for n, c in enumerate(views):
        wrong = _moved(wrong, c, 25.0 + 9 * n)
    found = one_person(frames, BODY_25, wrong, keep_misfits=True)
    for truth in (A, b):
        apart = [
            np.abs(found.points[:, c, :, :2] - camera.project_pinhole(truth)).max(-1).mean()
            for c, camera in enumerate(RIG)
        ]
        if max(apart) < 10:
            break
    else:
        pytest.fail("the views show different people")


def test_one_body_in_two_uncalibrated_views():
    swaying = B + np.sin(0.3 * np.arange(FRAMES))[:, None, None] * np.array([0.0, 0.5, 0.0])
    frames = seen_by(RIG, [A, swaying], np.random.default_rng(9), noise=0.3)
    views = [view_tracks([f[c] for f in frames], 20) for c in (0, 1)]
    assert all((v[0] >= 0).all() for v in views)
    of = [[np.stack([f[c][t[i]] for i, f in enumerate(frames)]) for t in v[:2]] for c, v in enumerate(views)]
    table = np.array([[moves_as(a, b) for b in of[1]] for a in of[0]])
    same = min(table[0, 0] + table[1, 1], table[0, 1] + table[1, 0])
    assert table.sum() - same > 3 * same
