"""Chunks of a recording: their frames, the seams between them, and the same bytes however they were made."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.body import Body
from hypose.body.ready_bodies import human
from hypose.errors import InputError
from hypose.inference.hypotheses import Hypotheses
from hypose.io.motions.results import ResultsFolder, load_motion
from hypose.pipeline import run
from hypose.pipeline.chunked import ChunkRun, chunk_ranges
from hypose.pipeline.first_frame import Subject
from hypose.pipeline.join import AGREE_M, FADE, join, seam_notes
from hypose.pipeline.run import TrackOptions, track_source
from hypose.pipeline.track_loop import Tracked
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.pose_covariance import nothing_known
from hypose.tracking.start_search import start_from_hull
from hypose.tracking.subject import scaled_to_height
from hypose.tracking.tracker import FrameEstimate, TrackerState
from tests.capsule_person import capsule_person

BODY: Body = capsule_person(0.09)
D = BODY.skeleton.dof
PATH = np.zeros((200, D))
PATH[:, 0] = 0.03 * np.arange(200)  # m per frame
PATH[:, 5] = 0.02 * np.arange(200)


def silent(stage, done, total):
    pass


# ---- frames of the chunks --------------------------------------------------------------------------------------


def test_chunks_cover_everything_and_overlap():
    ranges = chunk_ranges(1000, 25.0, 13.0)
    assert [r.start for r in ranges] == [0, 333, 666]
    assert [r.stop for r in ranges] == [383, 716, 1000]
    assert chunk_ranges(200, 25.0, 20.0) == (range(0, 200),)


@pytest.mark.parametrize("seconds", [0.0, -3.0, 5.0, float("nan")])
def test_chunks_that_are_too_short_are_refused(seconds):
    with pytest.raises(InputError, match="at least 10 s"):
        chunk_ranges(1000, 25.0, seconds)


# ---- seams -----------------------------------------------------------------------------------------------------


def estimate(pose, lost=False, cost=0.1):
    return FrameEstimate(pose, nothing_known(np.zeros((19, 3, 3)), D), cost, lost, False, 4)


def state_at(pose):
    return TrackerState(1, Hypotheses.uniform(pose[None]), pose, pose, np.zeros(19), 0.9, 0, False)


def chunk(start, stop, off=None, **more):
    """Tracked along PATH, beside it by off(frame) along y."""
    estimates = []
    for t in range(start, stop):
        pose = PATH[t].copy()
        pose[1] += 0.0 if off is None else off(t)
        estimates.append(estimate(pose, **{k: v(t) for k, v in more.items()}))
    return Tracked(range(start, stop), estimates, state_at(estimates[-1].pose))


def follow(state, frames):
    """Goes on along PATH, as far beside it as it was."""
    for t in frames:
        pose = PATH[t].copy()
        pose[1] = state.pose[1]
        state = state_at(pose)
        yield state, estimate(pose)


def joints_of(tracked):
    return BODY.joints(np.stack([e.pose for e in tracked.estimates]))


def largest_acceleration(joints):
    return np.linalg.norm(np.diff(joints, 2, axis=0), axis=-1).max()


def test_chunks_that_agree_fade_into_each_other():
    first, second = chunk(0, 120), chunk(100, 200, lambda t: 0.012)
    joined, seams = join(BODY, [first, second], follow, 200)
    assert joined.frames == range(0, 200) and len(joined.estimates) == 200
    assert len(seams) == 1 and seams[0].agreed and seams[0].again == 0
    assert 100 <= seams[0].frame < 120 and seams[0].apart_m == pytest.approx(0.012)
    joints = joints_of(joined)
    assert np.abs(joints - BODY.joints(PATH)).max() < 0.0121
    cut = np.concatenate([joints_of(first)[:110], joints_of(second)[10:]])
    assert largest_acceleration(joints) < 0.3 * largest_acceleration(cut)
    assert "12 mm" in seam_notes(seams)[0]


def test_the_place_is_where_they_are_closest():
    late = chunk(100, 200, lambda t: 0.3 * np.exp(-(t - 100) / 3))
    joined, seams = join(BODY, [chunk(0, 120), late], follow, 200)
    assert seams[0].frame > 112 and seams[0].agreed
    assert np.abs(joints_of(joined) - BODY.joints(PATH)).max() < AGREE_M


def test_a_chunk_that_has_not_found_the_pose_yet_is_not_used_until_it_has():
    late = chunk(100, 200, lambda t: 0.4 if t < 150 else 0.0)
    joined, seams = join(BODY, [chunk(0, 120), late], follow, 200)
    assert np.abs(joints_of(joined) - BODY.joints(PATH)).max() < 1e-9
    assert seams[0].agreed and seams[0].again == 150 + FADE - 120
    assert "37 frames were tracked again" in " ".join(seam_notes(seams))


def test_a_chunk_that_never_agrees_is_named():
    joined, seams = join(BODY, [chunk(0, 120), chunk(100, 200, lambda t: 0.4)], follow, 200)
    assert np.abs(joints_of(joined) - BODY.joints(PATH)).max() < 1e-9
    assert not seams[0].agreed
    assert "do not agree" in seam_notes(seams)[-1]


def test_the_later_chunk_is_believed_when_the_earlier_one_has_lost_the_person():
    first = chunk(0, 120, lambda t: 0.5 if t > 80 else 0.0, lost=lambda t: t > 80)
    joined, seams = join(BODY, [first, chunk(100, 200)], follow, 200)
    assert np.abs((joints_of(joined) - BODY.joints(PATH))[104:]).max() < 1e-9
    assert not seams[0].agreed and seams[0].again == 0


def test_gaps_and_chunks_without_anybody_are_filled():
    nobody = Tracked(range(100, 100), [], state_at(PATH[0]))
    joined, seams = join(BODY, [chunk(0, 80), chunk(90, 110), nobody], follow, 200)
    assert joined.frames == range(0, 200) and len(seams) == 1
    assert np.abs(joints_of(joined) - BODY.joints(PATH)).max() < 1e-9


# ---- whole runs ------------------------------------------------------------------------------------------------


class Frames:
    def __init__(self, frames):
        self.frames = frames

    def __len__(self):
        return len(self.frames)

    def frame(self, index, /):
        return self.frames[index]


@pytest.fixture(scope="module")
def scene():
    # one in which the masks tell where the arms are: what they do not tell, two sets of draws may take differently
    return small_scene(8, 130)


@pytest.fixture(scope="module")
def source(scene):
    return Frames(list(scene.mask_frames()))


@pytest.fixture
def known(scene, source, monkeypatch):
    """The subject is found at once; how often is counted."""
    calls = []
    body = scaled_to_height(human(), scene.subject.stature)
    prepared = prepare(source.frame(0), body, np.zeros(body.skeleton.dof))
    start = start_from_hull(body, prepared).pose

    def find(frame_at, total, options):
        calls.append(total)
        return Subject(body, None, start, ("given",))

    monkeypatch.setattr(run, "find_subject", find)
    return calls


def run_in(source, folder, seed=0):
    # 130 frames at 6 frames/s: two chunks
    options = TrackOptions(seed=seed, checkpoint_every=10)
    return ChunkRun(source, 6.0, options, 11.0, ResultsFolder(folder), {"seed": seed})


@pytest.mark.slow
def test_the_order_of_the_chunks_and_a_break_change_no_byte(source, known, tmp_path):
    whole = run_in(source, tmp_path / "one").whole(silent)
    assert whole.complete and len(whole.motion) == 130 and len(known) == 1
    assert any("2 chunks" in note for note in whole.notes)
    assert not (tmp_path / "one" / "chunks").exists() and not (tmp_path / "one" / "subject.npz").exists()

    def stop(stage, done, total):
        if stage == "track" and done == 30:
            raise KeyboardInterrupt

    apart = run_in(source, tmp_path / "two")
    assert len(apart.ranges) == 2
    assert not apart.chunk(1, stop).complete
    kept = (tmp_path / "two" / "chunks" / "0001.npz").read_bytes()
    assert apart.chunk(1, silent).complete
    assert (tmp_path / "two" / "chunks" / "0001.npz").read_bytes() != kept
    apart.whole(silent)
    assert len(known) == 2  # once for each folder
    assert (tmp_path / "two" / "motion.npz").read_bytes() == (tmp_path / "one" / "motion.npz").read_bytes()

    serial = track_source(source, 6.0, TrackOptions(), results=ResultsFolder(tmp_path / "serial"))
    off = np.linalg.norm(serial.motion.joints - whole.motion.joints, axis=-1)
    assert np.median(off) < 0.005 and off.mean(1).max() < 0.05
    # no jerk at the seam that is not in the motion anyway
    jerks = [np.linalg.norm(np.diff(m.joints, 2, axis=0), axis=-1).max(1) for m in (serial.motion, whole.motion)]
    assert jerks[1][55:90].max() < 1.1 * jerks[0].max()


@pytest.mark.slow
def test_an_interrupted_whole_keeps_its_chunks(source, known, tmp_path):
    def stop(stage, done, total):
        if stage == "track" and done == 90:
            raise KeyboardInterrupt

    part = run_in(source, tmp_path / "r").whole(stop)
    assert not part.complete and 80 < len(part.motion) < 130
    assert len(load_motion(tmp_path / "r" / "motion.npz")) == len(part.motion)
    untouched = (tmp_path / "r" / "chunks" / "0000.npz").stat().st_mtime_ns
    seen = []
    whole = run_in(source, tmp_path / "r")
    whole.chunk(0, lambda stage, done, total: seen.append(done))
    assert (tmp_path / "r" / "chunks" / "0000.npz").stat().st_mtime_ns == untouched and len(known) == 1
    assert whole.whole(silent).complete


def test_what_another_run_kept_is_refused_or_left_alone(source, known, tmp_path):
    run_in(source, tmp_path / "r").chunk(0, silent)
    other = run_in(source, tmp_path / "r", seed=1)
    assert other.subject(silent).notes == ("given",) and len(known) == 2
    with pytest.raises(InputError, match="another run"):
        other.chunk(0, silent)
    shutil.rmtree(tmp_path / "r" / "chunks")
    body = tmp_path / "r" / "body.npz"
    body.write_bytes(body.read_bytes()[:-5])  # a body that is not the one it was kept with
    assert replace(other).subject(silent) and len(known) == 3
