"""What is plainly wrong is told before tracking, with its name; what is right is left alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic.noisy_masks import noisy_scene
from benchmarks.synthetic.spoilt_keypoints import noisy, spoilt
from hypose.calibration.diagnose_masks import focal_by_points, focal_findings
from hypose.cameras.camera import CameraRig, triangulate
from hypose.evidence.frame import Keypoints, Silhouettes
from hypose.evidence.keypoints import BODY_25, BODY_25B, other_sides
from hypose.geometry import se3
from hypose.pipeline.assessment import sentences
from hypose.pipeline.input_checks import check_inputs
from hypose.pipeline.track_loop import FrameList
from hypose.synthetic.scenes import make_scene

BALANCING = Path(__file__).parents[3] / "shared" / "data" / "pose2sim_balancing"


@pytest.fixture(scope="module")
def scene():
    return noisy_scene("walk", rig="humaneva-4", seconds=1.0, seed=40)


@pytest.fixture(scope="module")
def frames(scene):
    return list(scene.mask_frames(0.5, keypoints=True))


def with_points(frames, change, names=None, rig=None):
    out = []
    for f in frames:
        k = f.keypoints
        out.append(
            replace(f, silhouettes=None, keypoints=Keypoints(change(k.points.copy()), names or k.names, rig or k.rig))
        )
    return out


def with_rig(frames, change):
    out = []
    for f in frames:
        s = f.silhouettes
        rig = CameraRig(tuple(change(c) for c in s.rig))
        out.append(
            replace(
                f, silhouettes=Silhouettes(s.masks, rig, s.usable, s.reasons), keypoints=replace(f.keypoints, rig=rig)
            )
        )
    return out


UPRIGHT = np.eye(3)


def in_world(camera, turn=UPRIGHT, unit=1.0):
    """The camera in a world that is turned and whose unit is another one."""
    place = camera.camera_from_world
    return replace(camera, camera_from_world=se3(place[:3, :3] @ turn, unit * place[:3, 3]))


def alone(frame, points):
    return replace(frame, silhouettes=None, keypoints=replace(frame.keypoints, points=points))


def kinds(frames, evidence="keypoints", height=None):
    found = check_inputs(FrameList(frames), evidence, height)
    assert all(s.count("Next: ") == 1 for s in sentences(found))
    return [f.kind for f in found if f.fault]


@pytest.mark.parametrize("seed", [41, 42])
@pytest.mark.parametrize("motion", ["walk", "sit_down", "serve"])
def test_what_is_right_is_left_alone(motion, seed):
    scene = noisy_scene(motion, rig="humaneva-4", seconds=1.0, seed=seed)
    frames = list(scene.mask_frames(0.5, keypoints=True))
    assert [kinds(frames, evidence) for evidence in ("silhouettes", "keypoints", "both")] == [[], [], []]


def test_a_detector_that_errs_is_no_fault(frames):
    assert kinds(spoilt(frames, "detector", np.random.default_rng(1))) == []


def test_points_in_the_order_of_another_set_are_named(frames):
    order = [BODY_25.index(n) if n in BODY_25 else 0 for n in BODY_25B]

    def as_25b(points):
        out = points[:, order]
        out[:, [k for k, n in enumerate(BODY_25B) if n not in BODY_25]] = 0.0
        return out

    (found,) = check_inputs(FrameList(with_points(frames, as_25b)), "keypoints")
    assert found.kind == "keypoint_set" and "BODY_25B" in found.cure and "not BODY_25:" in found.text
    (found,) = check_inputs(FrameList(with_points(frames, lambda p: p, BODY_25B)), "keypoints")
    assert found.kind == "keypoint_set" and 'keypoint_set = "BODY_25"' in found.cure


def test_exchanged_and_mirrored_cameras_are_named(frames):
    (found,) = check_inputs(FrameList(with_points(frames, lambda p: p[[1, 0, 2, 3]])), "keypoints")
    assert found.kind == "swapped" and found.views == ("cam1", "cam2")
    width = frames[0].keypoints.rig.sizes[2, 0]

    def mirrored(points):
        points[2, :, 0] = width - 1 - points[2, :, 0]
        points[2] = points[2, other_sides(BODY_25)]  # who looks into a mirror lifts the other hand
        return points

    found = check_inputs(FrameList(with_points(frames, mirrored)), "keypoints")
    assert [f.kind for f in found] == ["mirrored"] and found[0].views == ("cam3",)


def test_exchanged_names_are_found_by_the_face_where_there_are_no_feet(frames):
    gone = [k for k, n in enumerate(BODY_25) if n.endswith(("toe", "heel"))]

    def bare(points):
        points[:, gone] = 0.0
        return points

    assert kinds(with_points(frames, bare)) == []
    assert kinds(with_points(frames, lambda p: bare(p)[:, other_sides(BODY_25)])) == ["sides"]


@pytest.mark.parametrize("evidence", ["silhouettes", "keypoints", "both"])
@pytest.mark.parametrize(
    ("turn", "unit", "kind", "cure"),
    [
        (np.diag([1.0, -1.0, -1.0]), 1.0, "up", ""),
        (np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), 1.0, "up", " y points up"),
        (UPRIGHT, 1000.0, "unit", ""),
    ],
    ids=["upside down", "y up", "mm"],
)
def test_another_axis_up_and_a_wrong_unit_are_told(frames, evidence, turn, unit, kind, cure):
    wrong = FrameList(with_rig(frames, lambda c: in_world(c, turn, unit)))
    (found,) = (f for f in check_inputs(wrong, evidence) if f.fault)
    assert found.kind == kind and cure in found.cure, found.sentence


def test_scatter_and_another_calibration_are_told(frames):
    points = np.stack([f.keypoints.points for f in frames])
    rng = np.random.default_rng(2)
    wild = points.copy()
    for _ in range(2):
        wild = noisy(wild, BODY_25, rng)
    wide = [alone(f, p) for f, p in zip(frames, wild, strict=True)]
    assert kinds(wide) == ["scatter"]
    other = make_scene("walk", rig="ring-4", seconds=0.1, seed=1).given_rig.scaled(0.5)
    assert len(kinds(with_points(frames, lambda p: p, rig=other))) == 1


def test_two_views_of_nobody_say_nothing(frames):
    empty = [alone(f, np.zeros_like(f.keypoints.points)) for f in frames]
    assert kinds(empty) == []


@pytest.mark.slow
@pytest.mark.skipif(not BALANCING.exists(), reason="needs the recording pose2sim_balancing")
def test_a_real_recording_is_left_alone_and_told_when_its_set_is_wrong():
    from hypose.io.recordings.frames import FrameSettings, FrameStream
    from hypose.io.recordings.recording import load_recording

    with FrameStream(load_recording(BALANCING), FrameSettings(masks=False)) as stream:
        real = [stream.frame(i) for i in range(len(stream))]
    assert kinds(real) == []
    found = check_inputs(
        FrameList([replace(f, keypoints=replace(f.keypoints, names=BODY_25)) for f in real]), "keypoints"
    )
    assert [f.kind for f in found] == ["keypoint_set"] and "BODY_25B" in found[0].cure


@pytest.mark.slow
@pytest.mark.parametrize(("evidence", "factor"), [("silhouettes", 0.88), ("keypoints", 1.13)])
def test_all_focal_lengths_wrong_are_told_where_the_person_walks(evidence, factor):
    scene = noisy_scene("walk", rig="humaneva-4", seconds=3.0, seed=43)
    frames = list(scene.mask_frames(0.5, keypoints=True))
    assert kinds(frames, evidence) == []
    zoomed = np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
    wrong = with_rig(frames, lambda c: replace(c, K=c.K * zoomed))
    found = [f for f in check_inputs(FrameList(wrong), evidence) if f.kind == "focal"]
    reported = float(found[0].text.split("were ")[1].split(" times")[0])
    assert len(found) == 1 and abs(reported * factor - 1) < 0.06


def test_a_wrong_focal_length_of_two_views_cannot_be_told(frames):
    first = [replace(f.keypoints, points=f.keypoints.points[:2], rig=CameraRig(f.keypoints.rig[:2])) for f in frames]
    found = focal_by_points(first[0].rig, np.stack([k.points for k in first], 1))
    assert found.sd == float("inf") and not list(focal_findings(found))


def test_a_height_that_is_known_tells_what_the_views_do_not(scene, frames):
    tall = float(np.ptp(scene.subject.vertices[:, 2]))
    for unit, height, told in ((1.0, tall, []), (1.1, tall, ["is known"]), (2.15 / tall, None, ["if it is right"])):
        large = with_rig(frames, lambda c, unit=unit: in_world(c, unit=unit))
        found = check_inputs(FrameList(large), "keypoints", height)
        assert [(f.kind, f.fault) for f in found] == [("unit", False)] * len(told)
        assert all(words in f.sentence for words, f in zip(told, found, strict=True))


def test_two_cameras_that_stand_side_by_side_or_face_each_other(frames):
    def of_angle(degrees):
        rig = frames[0].keypoints.rig
        points, _ = triangulate(rig, frames[0].keypoints.points[..., :2], frames[0].keypoints.points[..., 2])
        first, middle = rig[0], np.nanmedian(points, 0)
        turn = np.deg2rad(degrees)
        c, s = np.cos(turn), np.sin(turn)
        around = se3(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.zeros(3))
        around[:3, 3] = middle - around[:3, :3] @ middle
        there = around @ np.linalg.inv(first.camera_from_world)
        return CameraRig((first, replace(first, name="other", camera_from_world=np.linalg.inv(there)))), points

    for degrees, reported in ((6.0, True), (90.0, False), (176.0, True)):
        two, points = of_angle(degrees)
        seen = np.stack([np.concatenate([c.project(points), np.ones((len(points), 1))], -1) for c in two])
        seen = np.where(np.isfinite(seen).all(-1, keepdims=True), seen, 0.0)
        shown = [replace(alone(f, seen), keypoints=Keypoints(seen, f.keypoints.names, two)) for f in frames]
        assert ("parallel" in kinds(shown)) == reported, degrees


@pytest.mark.slow
@pytest.mark.parametrize(("late", "fault"), [((0, 1), True), ((2,), False)])
def test_views_that_are_late_are_told_before_tracking(late, fault):
    """As a fault, unless three others show where the person is."""
    scene = make_scene("walk", rig="humaneva-4", seconds=2.4, seed=41, corruption=())
    frames = list(scene.mask_frames(0.5, keypoints=True))
    assert check_inputs(FrameList(frames), "keypoints", None, scene.frame_rate) == ()
    points = np.stack([f.keypoints.points for f in frames])
    points[3:, late] = points[:-3, late]
    shifted = [alone(f, p) for f, p in zip(frames, points, strict=True)]
    found = check_inputs(FrameList(shifted), "keypoints", None, scene.frame_rate)
    assert {f.kind for f in found} == {"late"} and all(f.fault == fault for f in found)
    assert {scene.given_rig.names[c] for c in late} <= {v for f in found for v in f.views}
