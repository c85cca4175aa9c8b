"""The trace names the pass that moved a joint, for a fault planted in each of them."""

import re
from dataclasses import replace

import numpy as np
import pytest

import hypose
from hypose.app.jobs.explain import explain_joint
from hypose.io.motions.results import save_body
from hypose.pipeline import input_checks, passes, track
from hypose.pipeline.sources import FrameList
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.pipeline.track import track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.scenes import camera_rig, make_scene

FRAMES = range(5, 8)
JOINT = "left_wrist"


@pytest.fixture(scope="module")
def frames():
    scene = make_scene("walk", "broad", camera_rig("ring-4").scaled(0.4), seconds=0.48, seed=3)
    return list(scene.mask_frames(1.0, keypoints=True))


@pytest.fixture(scope="module")
def subject(frames):
    return find_subject(lambda i: frames[i], len(frames), SubjectOptions("keypoints", girths=False))


def exchange(own, spoilt, monkeypatch):
    """Run `spoilt` in the place of the pass `own`."""
    for part in ("CHECKED", "AFTER_TRACKING"):
        planned = tuple(spoilt if step is own else step for step in getattr(track, part))
        monkeypatch.setattr(track, part, planned)


def with_arm_bent(clip):
    """The clip with the left elbow bent by a radian in FRAMES."""
    s = clip.who.body.skeleton
    elbow = np.array([n.startswith("left_elbow") for n in s.dof_names])
    if clip.motion is not None:
        poses = clip.motion.poses.copy()
        poses[FRAMES.start : FRAMES.stop, elbow] += 1.0
        return replace(clip, motion=replace(clip.motion, poses=poses, joints=clip.who.body.joints(poses)))
    estimates = list(clip.estimates)
    for t in FRAMES:
        estimates[t] = replace(estimates[t], pose=estimates[t].pose + elbow)
    return clip.with_estimates(estimates, ())


def explained(frames, subject, tmp_path, evidence="silhouettes"):
    source, results = FrameList(frames), tmp_path
    options = TrackOptions(evidence=evidence, start="keypoints")
    found = track_source(source, 25.0, options, subject=subject, results=results)
    save_body(found.body, results / "body.npz")
    return explain_joint(tmp_path, JOINT, FRAMES[1])


@pytest.mark.parametrize("stage", passes.REASONS)
def test_a_fault_planted_in_a_pass_is_named(stage, frames, subject, tmp_path, monkeypatch):
    own = getattr(passes, stage, None) or getattr(input_checks, stage)

    def spoilt(clip):
        return with_arm_bent(own(clip))

    spoilt.__name__ = stage
    exchange(own, spoilt, monkeypatch)
    lines = explained(frames, subject, tmp_path)
    named = [line.split(":")[0].strip() for line in lines if " mm in frames " in line]
    assert stage in named
    assert any(passes.REASONS[stage] in line for line in lines)


def test_a_fault_planted_in_the_search_of_a_frame_is_named(frames, subject, tmp_path, monkeypatch):
    own = passes.track_clip

    def spoilt(clip):
        clip, j = own(clip), subject.body.skeleton.joint_names.index(JOINT)
        estimates = clip.estimates
        for t, estimate in enumerate(estimates):
            moved = estimate.moved.copy()
            moved[j] = 0.4 if t in FRAMES else 0.0
            estimates[t] = replace(estimate, moved=moved, origin="by limb search")
        return clip

    exchange(own, spoilt, monkeypatch)
    lines = explained(frames, subject, tmp_path)
    assert any(re.match(r"  track_clip: up to 400 mm in frames \d to 7: the limb search", line) for line in lines)


def test_a_result_is_saved_loaded_and_read_as_a_table(frames, subject, tmp_path):
    result = track_source(FrameList(frames), 25.0, TrackOptions(start="keypoints"), subject=subject)
    result.save(tmp_path / "out")
    again = hypose.load_result(tmp_path / "out")
    assert again.motion.joints.tobytes() == result.motion.joints.tobytes()
    assert again.assessment == result.assessment
    names, radians = hypose.joint_angles(again.motion.skeleton, again.motion.poses)
    np.testing.assert_allclose(again.angles["knee_angle_r"], np.degrees(radians[:, names.index("knee_angle_r")]))
    (tmp_path / "out" / "assessment.json").write_text("{}")
    with pytest.raises(hypose.InputError, match="is not an assessment of hypose"):
        hypose.load_result(tmp_path / "out")


def test_a_result_becomes_a_data_frame(frames, subject):
    pytest.importorskip("pandas")
    result = track_source(FrameList(frames), 25.0, TrackOptions(start="keypoints"), subject=subject)
    table = result.to_dataframe()
    assert len(table) == len(frames) and table["left_wrist_z"].iloc[3] == result.motion.joints[3, 8, 2]
    assert {"time", "knee_angle_l", "left_wrist_sd", "left_wrist_p", "lost"} <= set(table.columns)
