"""Colours of a person's parts: learnt where nothing is in doubt, asked where masks cannot tell, silent where they are
all alike."""

from dataclasses import replace

import numpy as np
import pytest

from hypose import compute
from hypose.compute.zbuffer import rasterize
from hypose.evidence.colours import COLOURS, colour_codes
from hypose.evidence.frame import Colours, Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.inference.hypotheses import Hypotheses
from hypose.synthetic.rigs import rig
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.part_colours import (
    COUNTS,
    PARTS,
    ColourSettings,
    LearnColours,
    colour_scores,
    table_of,
)
from hypose.tracking.pictured_arms import pictured_arms
from hypose.tracking.reach_table import arm_reach, in_practice
from hypose.tracking.recipes import default
from hypose.tracking.tracker import Tracker, TrackerState

HAND, TRUNK = 4, 1
CLOTHES = tuple(100 + 7 * k for k in range(len(PARTS)))
SETTINGS = ColourSettings()


def part_of_face(body):
    names = body.skeleton.joint_names
    part = np.array([next((k for k, own in enumerate(PARTS) if n in own), 1) for n in names])
    joint = body.coarse.main_joint[body.coarse.faces]
    return part[np.where(joint[:, 1] == joint[:, 2], joint[:, 1], joint[:, 0])].astype(np.uint8)


@pytest.fixture(scope="module")
def painted(body):
    """painted(pose, index=0, clothes): the frame of a pose with a colour of its own for each part; 200 px tall."""
    cameras = rig("humaneva-4").scaled(0.75)

    def paint(pose, index=0, clothes=CLOTHES):
        part, v = part_of_face(body), body.skin(pose)
        shown = [
            compute.shown_parts(v, body.coarse.faces, part, p, camera.size[::-1])[0]
            for camera, p in zip(cameras, cameras.projections, strict=True)
        ]
        codes = np.array([0, *clothes], np.uint16)[np.stack(shown)]
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
        memory = LearnColours()(memory, standing, Hypotheses.uniform(standing[None]), frame)
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


def seen(body, pose, memory, painted, clothes=None):
    frame = painted(pose) if clothes is None else painted(pose, clothes=clothes)
    return replace(prepare(frame, body, pose), memory=memory)


def test_light_and_shade_change_the_brightness_alone():
    bright = np.array([[[60, 90, 160], [30, 60, 40], [120, 100, 90]]], np.uint8)
    codes = colour_codes(bright).astype(int)
    assert len(set(codes.ravel().tolist())) == 3 and codes.max() < COLOURS
    assert np.array_equal(codes % 256, colour_codes((bright * 0.6).astype(np.uint8)).astype(int) % 256)


def test_the_part_in_front_is_that_of_the_nearest_face(body, folded, small_rig):
    part, v = part_of_face(body), body.skin(folded)
    for camera in small_rig:
        p = camera.K @ camera.camera_from_world[:3]
        shown, (rows, columns) = compute.shown_parts(v, body.coarse.faces, part, p, camera.size[::-1])
        z = v @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
        _, face, _ = rasterize(camera.project_pinhole(v), z, body.coarse.faces, camera.size)
        expected = np.where(face < 0, 0, 1 + part[face])
        assert (shown != expected).sum() <= 0.02 * (expected > 0).sum()  # edges of parts
        assert (shown > 0).sum() == (shown[rows, columns] > 0).sum()


def test_sums_are_those_over_the_pixels(body, folded, standing, frame_of, rng):
    frame = prepare(frame_of(body, folded), body, folded)
    table = rng.normal(size=(4, len(PARTS), COLOURS)).astype(np.float32)
    poses, part = np.stack([folded, standing]), part_of_face(body)
    codes = rng.integers(COLOURS, size=frame.masks.masks.shape).astype(np.uint16)
    sums, rims = compute.colour_sums(body.skin(poses), body.coarse.faces, part, frame.masks, codes, table)
    assert not rims.any()  # no edges were given
    for n, pose in enumerate(poses):
        for c, p in enumerate(frame.masks.projections):
            shown, _ = compute.shown_parts(body.skin(pose), body.coarse.faces, part, p, codes[c].shape)
            there = (shown > 0) & (frame.masks.masks[c] > 0)
            assert sums[n, c] == pytest.approx(
                table[c, shown[there] - 1, codes[c][there]].sum(dtype=np.float64), rel=1e-5
            )


def test_each_part_has_its_colour_and_no_other(learnt):
    table = table_of(learnt[COUNTS], SETTINGS)
    for c in range(4):
        assert table[c, TRUNK, 100 + 7 * TRUNK] > 0.5 > -1.0 > table[c, TRUNK, 100 + 7 * HAND]
        assert table[c, HAND, 100 + 7 * HAND] > 1.0 and table[c, HAND, 100 + 7 * TRUNK] < -0.5
    assert np.abs(table).max() <= SETTINGS.most


def test_nothing_is_learnt_from_what_is_in_doubt(body, standing, folded, painted, learnt):
    frame = prepare(painted(standing), body, standing)
    both = Hypotheses(np.stack([standing, folded]), np.log([0.6, 0.4]))
    assert LearnColours()({}, standing, both, frame) == {}
    surer = Hypotheses(np.stack([standing, folded]), np.log([0.9, 0.1]))
    arms = LearnColours()({}, standing, surer, frame)[COUNTS][:, HAND].sum()
    assert 0 < arms < 0.8 * LearnColours()({}, standing, both.take([0]), frame)[COUNTS][:, HAND].sum()  # right alone
    assert LearnColours()(learnt, standing, both, frame) is learnt


def test_the_arm_that_lies_where_its_colours_are_is_better(body, folded, painted, learnt):
    frame = seen(body, folded, learnt, painted)
    poses = np.stack([folded, with_elbow(body, folded, 0.5), with_elbow(body, folded, -0.5)])
    scores = colour_scores(poses, frame, SETTINGS)
    assert scores[0] < min(scores[1:]) - 0.01


@pytest.fixture(scope="module")
def left_arm(body):
    return arm_reach(body, ("left_clavicle", "left_shoulder", "left_elbow"), *in_practice(body.skeleton), count=8)


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


def test_nothing_is_looked_for_without_pictures(body, folded, frame_of, left_arm, rng):
    frame = prepare(frame_of(body, folded), body, folded)
    assert pictured_arms([left_arm], folded, frame, SETTINGS, rng) is None


def with_edges(frame, body, pose):
    """The frame, all of one colour, with edges where the left arm of a pose ends before the rest."""
    arm, v = part_labels(body), body.skin(pose)
    edges = np.zeros((len(frame.colours.codes), 2, *frame.colours.codes.shape[1:]), np.uint8)
    for c, p in enumerate(frame.silhouettes.rig.projections):
        shown, _ = compute.shown_parts(v, body.coarse.faces, arm, p, edges.shape[2:])
        edges[c, 0, :, :-1] = 200 * ((shown[:, 1:] != shown[:, :-1]) & (shown[:, 1:] * shown[:, :-1] > 0))
        edges[c, 1, :-1] = 200 * ((shown[1:] != shown[:-1]) & (shown[1:] * shown[:-1] > 0))
    return replace(frame, colours=replace(frame.colours, edges=edges))


def part_labels(body):
    names = body.skeleton.joint_names
    left = np.isin(body.coarse.main_joint, [names.index(f"left_{n}") for n in ("shoulder", "elbow", "wrist")])
    return left[body.coarse.faces].all(1).astype(np.uint8)


def test_the_arm_whose_rims_lie_on_edges_is_better(body, folded, standing, painted):
    alike, memory = (100,) * len(PARTS), {}
    for t in range(3):
        frame = prepare(painted(standing, t, alike), body, standing)
        memory = LearnColours()(memory, standing, Hypotheses.uniform(standing[None]), frame)
    frame = with_edges(painted(folded, clothes=alike), body, folded)
    poses = np.stack([folded, with_elbow(body, folded, 0.4), with_elbow(body, folded, -0.4)])
    scores = colour_scores(poses, replace(prepare(frame, body, folded), memory=memory), SETTINGS)
    assert scores[0] < min(scores[1:]) - 0.01


def test_what_is_all_of_one_colour_says_nothing(body, folded, standing, painted):
    alike, memory = (100,) * len(PARTS), {}
    for t in range(3):
        frame = prepare(painted(standing, t, alike), body, standing)
        memory = LearnColours()(memory, standing, Hypotheses.uniform(standing[None]), frame)
    frame = seen(body, folded, memory, painted, alike)
    scores = colour_scores(np.stack([folded, with_elbow(body, folded, 0.5)]), frame, SETTINGS)
    assert np.abs(scores).max() < 0.02 * ColourSettings().most


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
