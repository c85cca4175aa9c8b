"""One recording from start to end: subject, start, tracking, interruption, resume, the same bytes."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Frame
from hypose.io.motions.results import load_motion
from hypose.pipeline.sources import FrameList
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.pipeline.track import track, track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.scenes import camera_rig, make_scene
from hypose.tracking.recipes import recipe
from tests.stand_ins import stop_at


class Frames:
    """The frames of a list, counting how often each is read."""

    def __init__(self, frames: list[Frame], broken_at: int = -1) -> None:
        self.frames, self.broken_at = frames, broken_at

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int, /) -> Frame:
        if index == self.broken_at:
            raise InputError("cam2.mp4 ends at frame 7; cut the recording with --frames.")
        return self.frames[index]


@pytest.fixture(scope="module")
def scene():
    return make_scene("walk", "broad", camera_rig("ring-4").scaled(0.4), seconds=0.48, seed=3)


@pytest.fixture(scope="module")
def frames(scene):
    return list(scene.mask_frames(1.0, keypoints=True))


@pytest.fixture(scope="module")
def subject(frames):
    return find_subject(lambda i: frames[i], len(frames), SubjectOptions("keypoints", girths=False))


def test_start_from_keypoints_is_near_the_truth(scene, subject):
    error = np.linalg.norm(subject.body.joints(subject.start) - scene.joints[0], axis=-1)
    assert error.mean() < 0.05


def test_subject_from_hulls_has_the_height_and_stands_in_place(scene, frames):
    silent = [Frame(f.time, f.index, f.silhouettes) for f in frames]
    found = find_subject(lambda i: silent[i], len(silent), SubjectOptions("auto"))
    assert found.body.stature == pytest.approx(scene.subject.stature, abs=0.12)
    assert found.keypoints is None
    error = np.linalg.norm(found.body.joints(found.start) - scene.joints[0], axis=-1)
    assert error.mean() < 0.10


def test_one_call_tracks_frames_by_a_name_or_a_recipe(frames, subject):
    """A published filter is not smoothed at the end, and a given body is kept as it is."""
    few, body = FrameList(frames[:3]), subject.body
    named = track(few, TrackOptions(start="keypoints"), recipe="hpf", body=body)
    made = track(few, TrackOptions(start="keypoints"), recipe=replace(recipe("hpf", body), name="mine"), body=body)
    assert named.motion.poses.tobytes() == made.motion.poses.tobytes()
    assert named.body is body and len(named.motion) == 3
    rough = track(few, TrackOptions(start="keypoints", smooth=False), recipe="hpf", body=body)
    assert rough.motion.poses.tobytes() == named.motion.poses.tobytes()


def test_key_points_alone_are_not_enough_for_a_search_in_masks():
    with pytest.raises(InputError, match="'hpf' needs silhouettes"):
        TrackOptions(recipe="hpf", evidence="keypoints")
    assert TrackOptions(evidence="keypoints").whole_clip


def test_tracking_follows_the_truth(scene, frames, subject):
    result = track_source(Frames(frames), 25.0, TrackOptions(), subject=subject)
    error = np.linalg.norm(result.motion.joints - scene.joints[: len(frames)], axis=-1)
    assert result.complete and error.mean() < 0.06
    assert not result.motion.lost.any()


def test_keypoints_alone_need_no_masks(scene, frames, subject):
    bare = [Frame(f.time, f.index, None, f.keypoints) for f in frames]
    result = track_source(Frames(bare), 25.0, TrackOptions(evidence="keypoints"), subject=subject)
    assert np.linalg.norm(result.motion.joints - scene.joints[: len(frames)], axis=-1).mean() < 0.05
    assert np.isnan(result.motion.cost).all()


def test_wanted_evidence_that_is_missing_is_named(frames, subject, tmp_path):
    bare = [Frame(f.time, f.index, None, f.keypoints) for f in frames]
    results = tmp_path
    with pytest.raises(EvidenceError, match="no silhouettes"):
        track_source(Frames(bare), 25.0, TrackOptions(), subject=subject, results=results)
    assert not (results / "checkpoint.npz").exists()  # there is nothing to go on from


def test_interrupted_and_resumed_gives_the_same_bytes(frames, subject, tmp_path):
    options = TrackOptions(checkpoint_every=3)
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    track_source(Frames(frames), 25.0, options, subject=subject, results=whole, record={"seed": 0})

    part = track_source(
        Frames(frames), 25.0, options, subject=subject, results=broken, record={"seed": 0}, progress=stop_at("track", 7)
    )
    assert not part.complete and len(load_motion(broken / "motion.npz")) == 7 and (broken / "checkpoint.npz").exists()
    track_source(Frames(frames), 25.0, options, subject=subject, results=broken, record={"seed": 0}, resume=True)
    assert (broken / "motion.npz").read_bytes() == (whole / "motion.npz").read_bytes()
    assert not (broken / "checkpoint.npz").exists()


def test_an_interrupted_run_of_masks_and_key_points_is_judged_by_its_own_frames(frames, subject, tmp_path):
    options, results = TrackOptions(evidence="both"), tmp_path
    part = track_source(
        FrameList(frames), 25.0, options, subject=subject, results=results, progress=stop_at("track", 3)
    )
    assert not part.complete and len(part.motion) == 3 and part.motion.systematic_covariance is not None


def test_who_was_found_before_an_interruption_is_not_searched_again(frames, tmp_path, monkeypatch):
    options, results = TrackOptions(start="keypoints", girths=False), tmp_path
    with pytest.raises(KeyboardInterrupt):
        track_source(Frames(frames), 25.0, options, results=results, progress=stop_at("track", 0))
    monkeypatch.setattr("hypose.pipeline.passes.find_subject", None)
    rest = track_source(Frames(frames), 25.0, options, results=results, resume=True)
    assert rest.complete and not (results / "checkpoint.npz").exists() and (results / "body.npz").exists()
    assert rest.notes[0].startswith("segment lengths from the key points")


def test_resume_of_another_run_is_refused(frames, subject, tmp_path):
    results = tmp_path / "r"

    track_source(
        Frames(frames),
        25.0,
        TrackOptions(),
        subject=subject,
        results=results,
        record={"seed": 0},
        progress=stop_at("track", 4),
    )
    with pytest.raises(InputError, match="another run"):
        track_source(
            Frames(frames), 25.0, TrackOptions(), subject=subject, results=results, record={"seed": 1}, resume=True
        )


def test_an_error_in_the_middle_keeps_what_was_tracked(frames, subject, tmp_path):
    results = tmp_path / "r"
    with pytest.raises(InputError, match=r"cam2\.mp4 ends.*7 frames before are kept"):
        track_source(Frames(frames, broken_at=7), 25.0, TrackOptions(), subject=subject, results=results, record={})
    assert len(load_motion(results / "motion.npz")) == 7


def test_no_frames_and_unknown_choices_are_refused(subject):
    with pytest.raises(InputError, match="no frame"):
        track_source(Frames([]), 25.0, TrackOptions(), subject=subject)
    with pytest.raises(InputError, match="silhouettes, keypoints, both"):
        TrackOptions(evidence="sonar")
    with pytest.raises(InputError, match="hands-up"):
        SubjectOptions(start="somehow")
