"""Which side a limb is on by the names of a whole clip, where single views and the frame before are wrong."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.evidence.keypoints import BODY_25
from hypose.tracking.frame_evidence import keypoint_model
from hypose.tracking.keypoint_clip import LIMBS, exchanged_by_names, track_keypoint_clip
from hypose.tracking.left_right import limbs_exchanged
from tests.tracking.test_keypoint_evidence import seen_by

RATE, FRAMES = 25.0, 40
LEGS = [n for n in BODY_25 if n.endswith(("hip", *LIMBS["legs"])) and n != "mid_hip"]


@pytest.fixture(scope="module")
def seen(body, model, walk, small_rig):
    return [seen_by(small_rig, model, body, q) for q in walk]


@pytest.fixture(scope="module")
def model(body):
    return keypoint_model(body, BODY_25)


@pytest.fixture(scope="module")
def walk(body, standing):
    """Poses (T, D) of legs that swing past each other twice, at frames 10 and 30."""
    swing = 0.6 * np.cos(np.pi * np.arange(FRAMES) / 20)
    poses = np.repeat(standing[None], FRAMES, 0)
    poses[:, body.skeleton.dofs_of("left_hip")[0]] += swing
    poses[:, body.skeleton.dofs_of("right_hip")[0]] -= swing
    return body.skeleton.clamp(poses)


def other_sides(seen, views):
    """The legs of some views called by the other side's names."""
    across = list(range(len(BODY_25)))
    for name in LEGS:
        side, part = name.split("_", 1)
        across[BODY_25.index(name)] = BODY_25.index(f"{'right' if side == 'left' else 'left'}_{part}")
    out = []
    for k in seen:
        points = k.points.copy()
        points[views] = points[views][:, across]
        out.append(replace(k, points=points))
    return out


def knees_off(body, poses, walk):
    """(T,) m: how far the farther knee is from where it was."""
    at = [body.skeleton.joint(f"{side}_knee") for side in ("left", "right")]
    return np.linalg.norm(body.joints(poses)[:, at] - body.joints(walk)[:, at], axis=-1).max(1)


def test_a_stretch_on_the_wrong_side_is_found_from_meeting_to_meeting(body, model, walk, seen):
    wrong = walk.copy()
    wrong[11:30] = [limbs_exchanged(body, q) for q in walk[11:30]]
    found, worth = exchanged_by_names(body, model, wrong, seen, "legs")
    assert found[13:28].all() and not found[:9].any() and not found[32:].any()
    assert worth > 20  # about two views of each frame tell
    assert not exchanged_by_names(body, model, wrong, seen, "arms")[0].any()


def test_a_start_on_the_wrong_legs_ends_on_the_right_ones(body, model, walk, seen):
    start = limbs_exchanged(body, walk[0])
    assert knees_off(body, start[None], walk[:1])[0] > 0.3
    found = track_keypoint_clip(body, model, other_sides(seen, [2]), start, RATE)
    assert knees_off(body, found.motion.poses, walk).max() < 0.06


def test_a_start_that_a_person_has_put_right_is_not_exchanged_by_names(body, model, walk, seen):
    called_otherwise = other_sides(seen, [0, 1, 2, 3])
    found, _ = exchanged_by_names(body, model, walk, called_otherwise, "legs")
    assert found[0]
    found, _ = exchanged_by_names(body, model, walk, called_otherwise, "legs", sure_start=True)
    assert not found[0]
