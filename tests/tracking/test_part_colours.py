"""Colours of a person's parts: learnt where nothing is in doubt, asked where masks cannot tell, silent where they are
all alike."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.compute.part_colours import shown_parts
from hypose.evidence.colours import COLOURS
from hypose.evidence.frame import Colours, Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.inference.hypotheses import Hypotheses
from hypose.synthetic.scenes import camera_rig
from hypose.tracking.arm_workspace import ArmReach, in_practice
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.part_colours import (
    COUNTS,
    PARTS,
    ColourSettings,
    learn_colours,
    pictured_arms,
)
from hypose.tracking.recipes import default
from hypose.tracking.tracker import Tracker, TrackerState

CLOTHES = tuple(100 + 7 * k for k in range(len(PARTS)))
SETTINGS = ColourSettings()


def part_of_face(body):
    names = body.skeleton.joint_names
    part = np.array([next((k for k, own in enumerate(PARTS) if n in own), 1) for n in names])
    return part[body.coarse.face_joint].astype(np.uint8)


@pytest.fixture(scope="module")
def painted(body):
    """painted(pose, index=0): the frame of a pose with a colour of its own for each part; 200 px tall."""
    cameras = camera_rig("humaneva-4").scaled(0.75)

    def paint(pose, index=0):
        part, v = part_of_face(body), body.skin(pose)
        shown = [
            shown_parts(v, body.coarse.faces, part, p, camera.size[::-1])[0]
            for camera, p in zip(cameras, cameras.projections, strict=True)
        ]
        codes = np.array([0, *CLOTHES], np.uint16)[np.stack(shown)]
        masks = [(one > 0).astype(np.uint8) for one in shown]
        colours = Colours(codes, np.ones(len(codes), np.bool_))
        return Frame(index / 25, index, make_silhouettes(masks, cameras), colours=colours)

    return paint


@pytest.fixture(scope="module")
def learnt(body, standing, painted):
    """What is remembered after five frames of the body standing."""
    memory = {}
    for t in range(5):
        frame = prepare(painted(standing, t), body, standing)
        memory = learn_colours(memory, standing, Hypotheses.uniform(standing[None]), frame)
    return memory


@pytest.fixture(scope="module")
def folded(body, standing):
    """The left forearm before the trunk."""
    pose = standing.copy()
    s = body.skeleton
    pose[s.dofs_of("left_shoulder")] += [0.0, 0.0, -1.0]
    pose[s.dofs_of("left_elbow")[0]] += 1.2
    return s.clamp(pose)


def with_elbow(body, pose, by):
    out = pose.copy()
    out[body.skeleton.dofs_of("left_elbow")[0]] += by
    return body.skeleton.clamp(out)


def seen(body, pose, memory, painted):
    return replace(prepare(painted(pose), body, pose), memory=memory)


@pytest.fixture(scope="module")
def left_arm(body):
    return ArmReach(body, ("left_clavicle", "left_shoulder", "left_elbow"), *in_practice(body.skeleton), count=8)


@pytest.mark.parametrize("by", [-0.35, -0.25])
def test_an_arm_is_found_where_its_colours_are(body, folded, painted, learnt, left_arm, by, rng):
    frame = seen(body, folded, learnt, painted)
    wrong = with_elbow(body, folded, by)
    k, pose = body.skeleton.joint("left_wrist"), wrong
    for _ in range(4):  # frame after frame
        found = pictured_arms([left_arm], pose, frame, SETTINGS, rng)
        if found is not None:
            pose, points = found
            assert np.allclose(points.points_world[1], body.joints(pose)[k])
    before, after = (np.linalg.norm(body.joints(q)[k] - body.joints(folded)[k]) for q in (wrong, pose))
    assert before > 0.05 and after < 0.4 * before
    others = np.setdiff1d(np.arange(body.skeleton.dof), left_arm.own)
    assert (pose[others] == wrong[others]).all()


def run(tracker, frames, state):
    estimates = []
    for frame in frames:
        state, estimate = tracker.step(state, frame)
        estimates.append(estimate)
    return state, estimates


def test_without_pictures_nothing_changes(body, standing, frame_of):
    frames = [frame_of(body, standing, t) for t in range(3)]
    with_, without = (Tracker(body, default(body, particles=24, colours=c)) for c in (True, False))
    (state, a), (_, b) = (run(t, frames, t.start(standing)) for t in (with_, without))
    assert state.memory == {}
    assert all((x.pose == y.pose).all() for x, y in zip(a, b, strict=True))


def test_a_saved_state_goes_on_with_the_same_bytes(body, standing, folded, painted):
    frames = [painted(standing + f * (folded - standing), t) for t, f in enumerate(np.linspace(0, 1, 6))]
    tracker = Tracker(body, default(body, particles=24, colours=True))
    state, _ = run(tracker, frames[:3], tracker.start(standing))
    assert state.memory[COUNTS].shape == (4, len(PARTS), COLOURS)
    saved = {k: np.array(v) for k, v in state.to_arrays().items()}
    (a, one), (b, other) = (run(tracker, frames[3:], s) for s in (state, TrackerState.from_arrays(saved)))
    assert all((x.pose == y.pose).all() for x, y in zip(one, other, strict=True))
    assert a.memory[COUNTS].tobytes() == b.memory[COUNTS].tobytes()
