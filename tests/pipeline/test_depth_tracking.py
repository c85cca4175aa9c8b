"""From depth maps to a motion: one camera, a colour camera beside it, and cameras brought together by the person."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.depth_frames import depth_frames, empty_rooms, seen_before
from hypose.body.default_body import human
from hypose.calibration.depth_registration import in_camera, place_error, refine_registration, rough_registration
from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError, EvidenceError, InputError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.geometry import se3, se3_inverse, so3_exp, transform
from hypose.pipeline.assessment import UNTRUSTED
from hypose.pipeline.import_depth import register_depth
from hypose.pipeline.input_checks import check_inputs
from hypose.pipeline.run import track_people, track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.depth_scenes import depth_scene, to_profile, turning
from hypose.synthetic.metrics import EVALUATED, population_offsets, with_offsets
from hypose.synthetic.motions import act
from hypose.synthetic.subjects import load_subjects
from hypose.tracking.recipes import recipe
from hypose.tracking.start_search import known_pose
from hypose.tracking.tracker import Tracker, TrackerSettings
from tests.depth_pictures import frame_of, sensors


def scene_of(motion, sensor, seconds, seed=5):
    subject = sorted(load_subjects().items())[3][1]
    p = act(motion, subject, seconds, 25.0, np.random.default_rng(seed))
    return depth_scene(turning(p, subject, 0.7 * to_profile(len(p), seed)), subject, sensor, seed=seed)


def error_mm(motion, scene):
    rotations, _ = motion.skeleton.forward(motion.poses)
    joints = with_offsets(motion.joints, rotations, population_offsets(human()) * scene.subject.stature)
    return 1e3 * np.linalg.norm(joints - scene.joints[: len(joints)], axis=-1)[:, EVALUATED].mean()


@pytest.mark.slow
def test_one_depth_camera_gives_a_motion_without_a_given_start_or_body():
    scene = scene_of("walk", "depth-1", 1.6)
    found = track_source(FrameList(list(depth_frames(scene))), 25.0, TrackOptions(seed=1))
    assert error_mm(found.motion, scene) < 60
    assert found.body.stature == pytest.approx(scene.subject.stature, rel=0.06)
    assert found.motion.joint_covariance is not None and np.isfinite(found.motion.joint_covariance).all()
    assert found.audit is not None and found.motion.error_probability is not None


def test_a_colour_camera_and_a_depth_camera_are_one_solve():
    body = human()
    rig = sensors(2)
    pose = known_pose(body, "standing")
    pose[:3] = 0.03, 0.02, 0.95
    both = frame_of(body, pose, rig)
    half = Depth(both.depth.maps, both.depth.person, rig, np.array([True, False]))
    start = pose.copy()
    start[:2] += 0.06, -0.05
    tracker = Tracker(body, recipe("default", body, particles=48), TrackerSettings())
    _, estimate = tracker.step(tracker.start(start), replace(both, depth=half))
    assert np.linalg.norm(body.joints(estimate.pose) - body.joints(pose), axis=-1).mean() < 0.012
    assert estimate.n_views == 2


def hung_lower(rig, metres):
    """The cameras as told to hang so much lower than they do."""
    down = se3(np.eye(3), np.array([0, 0, metres]))
    return CameraRig(tuple(replace(c, camera_from_world=c.camera_from_world @ down) for c in rig))


@pytest.mark.parametrize(
    "scale, lower, fault", [(1.0, 0.0, None), (1.05, 0.0, False), (4.0, 0.0, True), (1.0, 0.2, True)]
)
def test_maps_of_another_scale_and_moved_cameras_are_told_by_the_floor(scale, lower, fault):
    scene = scene_of("walk", "depth-1", 0.2)
    maps = [scene.depth_map(0, 0) * np.float32(scale)]
    rooms = [replace(r, depth=r.depth * np.float32(scale)) for r in empty_rooms(scene, 3)]
    found = check_inputs(FrameList([seen_before(rooms, maps, hung_lower(scene.rig, lower), 0.0, 0)]), "silhouettes")
    assert [f.fault for f in found if f.kind == "floor"] == ([] if fault is None else [fault])
    assert all("sees the floor" in f.sentence and "depth-import" in f.sentence for f in found)


def test_a_camera_that_is_lowered_while_it_records_is_told_by_the_floor_of_the_end():
    scene = scene_of("walk", "depth-1", 0.2)
    maps, rooms = [scene.depth_map(0, 0)], empty_rooms(scene, 3)
    rigs = scene.rig, scene.rig, hung_lower(scene.rig, 0.2)
    found = check_inputs(FrameList([seen_before(rooms, maps, r, k / 25, k) for k, r in enumerate(rigs)]), "silhouettes")
    assert [f.kind for f in found] == ["floor"] and "sees the floor at the end" in found[0].sentence


def lowered(scene, lower, nobody=False):
    """Frames with everybody in them, before cameras that are told to hang so many m lower than they do."""
    rig, kept = hung_lower(scene.rig, lower), 0 if nobody else 1
    for f in depth_frames(scene, people=True):
        depth = replace(f.depth, rig=rig, person=f.depth.person * kept)
        yield replace(f, depth=depth, silhouettes=replace(f.silhouettes, rig=rig, masks=f.silhouettes.masks * kept))


@pytest.mark.slow
def test_where_everybody_is_tracked_the_floor_tells_the_same():
    frames = list(lowered(scene_of("walk", "depth-2", 0.2), 0.13))
    assessment = track_people(FrameList(frames), 25.0, TrackOptions(seed=1)).people[0].assessment
    assert "depth1 sees the floor 1" in assessment.sentence and assessment.word == UNTRUSTED


def test_where_nobody_is_found_the_floor_may_say_why():
    frames = list(lowered(scene_of("walk", "depth-2", 0.2), 0.3, nobody=True))
    with pytest.raises(EvidenceError, match="depth1 sees the floor .* That may be why: No person stands"):
        track_people(FrameList(frames), 25.0, TrackOptions(seed=1))


# ---- registration ----


def test_a_rough_place_and_the_clocks_from_two_motions(rng):
    t = np.arange(100) / 25
    a = rng.normal(size=(1, 12, 3)) * 0.4 + np.array([0, 0, 1.0])
    moves = np.stack([0.5 * np.sin(2 * t), 0.3 * np.cos(3.1 * t), 0 * t], -1)
    swing = 0.2 * np.sin(4 * t[:, None, None] + np.arange(12)[:, None] * np.ones(3))
    joints = a + moves[:, None] + swing
    b_from_a = se3(so3_exp(np.array([0, 0, 1.9])), np.array([1.0, -2.0, 0.0]))
    seen = transform(b_from_a, joints) + 0.01 * rng.normal(size=joints.shape)
    found = rough_registration(t, joints, t + 7.0, seen)
    assert found.seconds == pytest.approx(-7.0, abs=0.02)
    angle, off = place_error(found.a_from_b, se3_inverse(b_from_a), np.array([0, 0, 1.0]))
    assert angle < 0.5 and off < 0.02 and found.apart < 0.03
    with pytest.raises(CalibrationError, match="do not belong together|does not fit together"):
        rough_registration(t, joints, t, rng.normal(size=joints.shape))


def test_places_are_refined_by_the_measured_points(rng):
    body, rig = human(), sensors(2)
    poses, seen = [], [[], []]
    for k in range(5):
        pose = known_pose(body, "standing")
        pose[:3] = 0.1 * np.sin(k), 0.1 * np.cos(k), 0.95
        pose[3:6] = 0, 0, 0.5 * k
        poses.append(pose)
        depth = frame_of(body, pose, rig).depth
        for c, camera in enumerate(rig):
            own = Depth(depth.maps[c][None], depth.person[c][None], CameraRig((camera,)), np.ones(1, bool))
            seen[c].append(in_camera(own.surface, camera.camera_from_world))
    true = np.stack([c.camera_from_world for c in rig])
    off = true.copy()
    off[1] = true[1] @ se3(so3_exp(np.array([0, 0, 0.04])), np.array([0.05, -0.04, 0.0]))
    at = np.array([0, 0, 1.0])
    before = place_error(off[1], true[1], at)
    found = refine_registration(body, np.stack(poses), seen, off)
    after = place_error(found[1], true[1], at)
    assert before[1] > 0.04 and after[1] < 0.008
    assert before[0] > 2 and after[0] < 0.3
    assert np.array_equal(found[0], true[0])


def test_one_sensor_alone_cannot_be_brought_together():
    with pytest.raises(InputError, match="at least two"):
        register_depth([[]], 25.0)


@pytest.mark.slow
def test_two_sensors_are_brought_together_by_the_person():
    scene = scene_of("combo", "depth-2", 1.6)
    clips = []
    worlds = []
    for c, camera in enumerate(scene.rig):
        turned = camera.camera_from_world @ se3(so3_exp(np.array([0, 0, 0.8 * c])), np.array([0.5 * c, -0.3 * c, 0]))
        rig = CameraRig((replace(camera, camera_from_world=turned),))
        worlds.append(turned)
        clip = []
        for f in depth_frames(scene):
            own = make_silhouettes([f.depth.person[c]], rig)
            seen = Depth(f.depth.maps[c][None], own.masks, rig, own.usable)
            clip.append(Frame(f.time + 2.0 * c, f.index, own, depth=seen))
        clips.append(clip)
    found = register_depth(clips, 25.0, seed=1)
    angle, off = place_error(found.rig[1].camera_from_world, scene.rig[1].camera_from_world, np.array([0, 0, 1.0]))
    assert angle < 1.0 and off < 0.02
    assert found.seconds[1] == pytest.approx(-2.0, abs=0.02)
