"""The trace names the pass that moved a joint, for a fault planted in each of them."""

from dataclasses import replace

import numpy as np
import pytest

import hypose
from hypose.app.jobs.explain import explain_joint
from hypose.io.motions.results import ResultsFolder, load_motion, save_body
from hypose.pipeline import passes
from hypose.pipeline.first_frame import SubjectOptions, find_subject
from hypose.pipeline.run import finish, track_source
from hypose.pipeline.trace import Change, later, list_changes, trace_of, with_trace
from hypose.pipeline.track_loop import FrameList
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


def with_arm_bent(clip):
    """The clip with the left elbow bent by a radian in FRAMES."""
    s = clip.who.body.skeleton
    elbow = np.array([n.startswith("left_elbow") for n in s.dof_names])
    if clip.motion is not None:
        poses = clip.motion.poses.copy()
        poses[FRAMES.start : FRAMES.stop, elbow] += 1.0
        return replace(clip, motion=replace(clip.motion, poses=poses, joints=clip.who.body.joints(poses)))
    estimates = list(clip.tracked.estimates)
    for t in FRAMES:
        estimates[t] = replace(estimates[t], pose=estimates[t].pose + elbow)
    return replace(clip, tracked=replace(clip.tracked, estimates=estimates))


def explained(frames, subject, tmp_path, evidence="silhouettes"):
    source, results = FrameList(frames), ResultsFolder(tmp_path)
    options = TrackOptions(evidence=evidence, start="keypoints")
    found = track_source(source, 25.0, options, subject=subject, results=results)
    save_body(found.body, results.file("body.npz"))
    return explain_joint(tmp_path, JOINT, FRAMES[1])


@pytest.mark.parametrize("stage", passes.REASONS)
def test_a_fault_planted_in_a_pass_is_named(stage, frames, subject, tmp_path, monkeypatch):
    own = getattr(passes, stage)

    def spoilt(clip):
        return with_arm_bent(own(clip))

    spoilt.__name__ = stage
    planned = tuple(spoilt if step is own else step for step in passes.PASSES)
    monkeypatch.setattr("hypose.pipeline.run.PASSES", planned)
    lines = explained(frames, subject, tmp_path)
    named = [line.split(":")[0].strip() for line in lines if " mm in frames " in line]
    assert stage in named
    assert any(passes.REASONS[stage] in line for line in lines)


def test_a_fault_planted_in_the_search_of_a_frame_is_named(frames, subject, tmp_path, monkeypatch):
    own = passes.track_clip

    def spoilt(clip):
        clip, j = own(clip), subject.body.skeleton.joint_names.index(JOINT)
        estimates = clip.tracked.estimates
        for t in FRAMES:
            moved = estimates[t].moved.copy()
            moved[j] = 0.4
            estimates[t] = replace(estimates[t], moved=moved, origin="by limb search")
        return clip

    planned = tuple(spoilt if step is own else step for step in passes.PASSES)
    monkeypatch.setattr("hypose.pipeline.run.PASSES", planned)
    lines = explained(frames, subject, tmp_path)
    assert any(line.startswith("  track_clip: up to 400 mm in frames 5 to 7: the limb search") for line in lines)


def test_searches_are_traced_of_clips_that_others_have_tracked_too(frames, subject):
    """Several people are tracked together, and only then run through the passes, each alone."""
    options = TrackOptions(start="keypoints", evidence="silhouettes")
    tracker = passes.tracker_of(subject, options, 25.0)
    followed = list(tracker.follow(tracker.start(subject.start), frames))
    there = [replace(e, moved=np.full_like(e.moved, 0.3), origin="by arm table") for _, e in followed]
    clip = passes.ClipState(FrameList(frames), 25.0, options, subject=subject, tracker=tracker)
    out = finish(replace(clip, tracked=passes.Tracked(there, followed[-1][0])))
    found = [c for c in trace_of(out.motion) if c.stage == "track_clip" and c.joint == JOINT]
    assert [(c.frames, c.reason) for c in found] == [(range(len(frames)), passes.SEARCHES["by arm table"])]


def test_a_person_who_is_not_there_was_found_by_no_search(frames, subject):
    tracker = passes.tracker_of(subject, TrackOptions(evidence="silhouettes"), 25.0)
    *_, (state, _) = tracker.follow(tracker.start(subject.start), frames[:4])
    s = frames[4].silhouettes
    elsewhere = replace(s, masks=np.roll(s.masks, s.masks.shape[-1] // 2, axis=-1))
    state = replace(state, hypotheses=state.hypotheses.marked("by arm table", np.arange(state.hypotheses.count)))
    estimate = tracker.step(state, replace(frames[4], silhouettes=elsewhere, keypoints=None))[1]
    assert estimate.lost and estimate.origin == ""


def test_what_no_pass_moved_is_said_to_be_so(frames, subject, tmp_path):
    lines = explained(frames, subject, tmp_path)
    text = "\n".join(lines)
    assert lines[0].startswith(f"{JOINT} in frame 6 (0.24 s): at (")
    assert "Evidence: unknown, 4 views; the body overlaps the masks by 0." in text
    kept = [c for c in trace_of(load_motion(tmp_path / "motion.npz")) if c.joint == JOINT and 6 in c.frames]
    assert ("No pass moved it" in text) == (not kept)


def test_changes_are_stretches_of_frames_with_the_largest_displacement():
    moved = np.zeros((10, 2))
    moved[[3, 5], 0], moved[8, 1] = (0.1, 0.3), 0.05
    found = list_changes("smooth", ("hip", "knee"), moved, "why")
    assert found == (
        Change("smooth", "hip", range(3, 6), 0.3, "why"),
        Change("smooth", "knee", range(8, 9), 0.05, "why"),
    )
    assert later(found, 4)[0].frames == range(7, 10)
    only = list_changes("smooth", ("hip", "knee"), moved, "why", np.arange(10) > 4)
    assert [c.frames for c in only] == [range(5, 6), range(8, 9)]


def test_a_trace_is_kept_with_its_motion(frames, subject, tmp_path):
    motion = track_source(FrameList(frames), 25.0, TrackOptions(start="keypoints"), subject=subject).motion
    trace = list_changes("smooth", ("hip",), np.full((3, 1), 0.1), "why")
    assert trace_of(with_trace(motion, trace)) == trace


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
