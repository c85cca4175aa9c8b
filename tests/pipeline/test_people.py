"""Several people of a recording: whose key points, whose names, what is kept of an interrupted run."""

from dataclasses import replace

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.association import PersonTrack
from hypose.evidence.frame import Frame, Silhouettes
from hypose.io.motions.results import ResultsFolder
from hypose.pipeline import people_run
from hypose.pipeline.people_run import PeopleRun
from hypose.pipeline.person_paths import KeypointPeople, count_people
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.pipeline.tracked_people import (
    Wanted,
    free_name,
    names_at_places,
    said_of_places,
    while_present,
)
from hypose.synthetic.scenes import make_scene
from hypose.tracking.several import shape_of
from hypose.tracking.starts import known_pose
from tests.stand_ins import stop_at

RATE = 25.0


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return make_scene("walk", rig="humaneva-4", seconds=0.1).rig.pinhole().scaled(0.6)


def two_people(rig, frames, away=()):
    """Two bodies of the template that pass each other; the second is out of view in the frames `away`."""
    body, out, truth = human(), [], []
    base = known_pose(body, "standing")
    base[2] -= body.skin(base)[:, 2].min()
    size = rig.sizes.max(0)
    for t in range(frames):
        masks, here = np.zeros((len(rig), size[1], size[0]), np.uint8), []
        for k, (x, y) in enumerate(((-0.45 + 0.02 * t, -0.4), (0.45 - 0.02 * t, 0.4))):
            pose = base.copy()
            pose[:2] += (x, y)
            here.append(pose)
            if k == 1 and t in away:
                continue
            shape = shape_of(body, pose, rig)
            for c, (y0, y1, x0, x1) in enumerate(shape.boxes):
                masks[c, y0:y1, x0:x1] |= shape.drawn(c)
        truth.append(np.stack(here))
        out.append(Frame(t / RATE, t, Silhouettes(masks, rig, np.ones(len(rig), bool), ("",) * len(rig))))
    return out, np.stack(truth, 1)


def both(frames, **more):
    given = (Wanted("anna", body=human(), place=(-0.45, -0.4)), Wanted("bert", body=human(), place=(0.45, 0.4)))
    return PeopleRun(FrameList(frames, RATE), RATE, TrackOptions(smooth=False), wanted=given, **more)


def test_two_people_who_pass_each_other_are_tracked_each_by_their_name(rig):
    frames, truth = two_people(rig, 14)
    assert count_people(lambda t: frames[t], len(frames)) == 2
    found = both(frames)()
    assert found.complete and [p.name for p in found.people] == ["anna", "bert"] and found.others == 0
    for p, q in zip(found.people, truth, strict=True):
        true = human().joints(q)
        away = np.linalg.norm(p.result.motion.joints - true, axis=-1)
        assert away.mean() < 0.03 and away.mean(1).max() < 0.06
        assert p.present.all()


@pytest.mark.slow
def test_a_view_that_shows_nobody_takes_nobody_away(rig):
    frames, truth = two_people(rig, 8)
    for f in frames:
        f.silhouettes.masks[2], f.silhouettes.usable[2] = 0, False  # as frames of recordings have it
    found = both(frames)()
    assert [p.name for p in found.people] == ["anna", "bert"]
    for p, q in zip(found.people, truth, strict=True):
        away = np.linalg.norm(p.result.motion.joints - human().joints(q), axis=-1)
        assert p.present.all() and away.mean() < 0.06
        assert p.result.motion.n_views.max() == 3


@pytest.mark.slow
def test_one_of_two_is_the_one_asked_for_and_the_others_are_told(rig):
    frames, truth = two_people(rig, 6)
    found = replace(both(frames), count=1, wanted=(Wanted("bert", body=human(), place=(0.45, 0.4)),))()
    assert [p.name for p in found.people] == ["bert"] and found.others == 1
    away = np.linalg.norm(found.people[0].result.motion.joints - human().joints(truth[1]), axis=-1)
    assert away.mean() < 0.03


@pytest.mark.slow
def test_an_interrupted_run_goes_on_to_the_same_bytes(rig, tmp_path):
    frames, _ = two_people(rig, 10)
    whole = both(frames)()
    results = ResultsFolder(tmp_path)

    half = both(frames, results=results, progress=stop_at("track", 6))()
    assert not half.complete and results.checkpoint.exists()
    assert all(len(p.result.motion) == 6 for p in half.people)
    rest = both(frames, results=results, resume=True)()
    assert rest.complete and not results.checkpoint.exists()
    for a, b in zip(whole.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.result.motion.poses, b.result.motion.poses)
        np.testing.assert_array_equal(a.result.motion.joint_covariance, b.result.motion.joint_covariance)
    assert (tmp_path / "anna" / "motion.npz").exists() and (tmp_path / "bert" / "motion.npz").exists()


@pytest.mark.slow
@pytest.mark.parametrize("nth", [1, 2])
def test_an_interruption_while_a_person_is_finished_is_one_of_the_run(rig, tmp_path, nth):
    frames, _ = two_people(rig, 6)
    whole = replace(both(frames), options=TrackOptions())()
    results, times, at = ResultsFolder(tmp_path), [], []

    def stop(stage, done, total):
        at.append((stage, done))
        times.extend([1] * (stage == "smooth" and done == 0))
        if stage == "smooth" and done == 0 and len(times) == nth:
            raise KeyboardInterrupt

    half = replace(both(frames, results=results, progress=stop), options=TrackOptions())()
    assert not half.complete and results.checkpoint.exists() and len(half.people) == 2
    assert at[-1] == ("smooth", 0)  # nothing is smoothed after it
    at.clear()
    rest = replace(both(frames, results=results, resume=True, progress=stop), options=TrackOptions())()
    assert rest.complete and at[0] == ("track", 6)  # nobody is searched or tracked again
    for a, b in zip(whole.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.result.motion.poses, b.result.motion.poses)
        np.testing.assert_array_equal(a.result.motion.joint_covariance, b.result.motion.joint_covariance)
    left = [p.name for p in tmp_path.rglob("*") if p.is_file()]
    assert not {"checkpoint.npz", "subject.npz"} & set(left)


@pytest.mark.slow
def test_a_frame_that_is_interrupted_half_way_is_taken_back(rig, tmp_path, monkeypatch):
    frames, _ = two_people(rig, 8)
    whole, results = both(frames)(), ResultsFolder(tmp_path)
    parted = people_run.part_doubles

    def ctrl_c(people, together):
        parted(people, together)
        if len(people[0].estimates) == 5:
            people[0].present[-1] = False
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(people_run, "part_doubles", ctrl_c)
        half = both(frames, results=results)()
    assert [len(p.result.motion) for p in half.people] == [4, 4]
    rest = both(frames, results=results, resume=True)()
    for a, b in zip(whole.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.result.motion.poses, b.result.motion.poses)
        np.testing.assert_array_equal(a.present, b.present)


@pytest.mark.slow
def test_who_leaves_and_returns_is_the_same_person(rig):
    frames, truth = two_people(rig, 40, away=range(8, 24))
    found = both(frames)()
    assert [p.name for p in found.people] == ["anna", "bert"]
    bert = found.people[1]
    assert not bert.present[12:22].any() and bert.present[:6].all() and bert.present[-4:].all()
    joints = human().joints(truth[1])
    away = np.linalg.norm(bert.result.motion.joints - joints, axis=-1).mean(1)
    assert away[:6].max() < 0.06 and away[-4:].max() < 0.08
    assert len(while_present(bert.result.motion, bert.present)) == bert.present.sum()
    assert bert.assessment.word in ("good", "look", "not to be trusted")


@pytest.mark.slow
def test_who_comes_later_is_not_taken_for_somebody_who_stands_elsewhere(rig, tmp_path):
    frames, _ = two_people(rig, 24, away=range(12))
    given = [Wanted("anna", body=human(), place=(-0.45, -0.4)), Wanted("carl", body=human(), place=(9.0, 9.0))]
    given.append(Wanted("bert", body=human(), place=(0.05, 0.4), time=20 / RATE))
    reported: list[str] = []
    found = replace(both(frames, progress=lambda stage, *_: reported.append(stage)), wanted=tuple(given))()
    assert "subject" in reported[reported.index("track") :]  # the start of who comes is told as a start
    assert [p.name for p in found.people] == ["anna", "bert"]
    assert not found.people[1].present[:10].any() and found.people[1].present[-4:].all()

    def stop(stage, done, total):
        if stage == "subject":
            raise KeyboardInterrupt

    # an interruption waits for the start that has been begun
    kept = ResultsFolder(tmp_path)
    half = replace(both(frames, progress=stop, results=kept), wanted=tuple(given))()
    assert not half.complete and [p.name for p in half.people] == ["anna", "bert"]
    rest = replace(both(frames, results=kept, resume=True), wanted=tuple(given))()
    for a, b in zip(found.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.result.motion.poses, b.result.motion.poses)


def test_wanted_people_are_those_who_stand_at_their_places():
    places = np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 0.0]])
    wanted = [Wanted("b", place=(1.1, 0.9)), Wanted("far", place=(9.0, 9.0)), Wanted("any")]
    assert names_at_places(wanted, 3, lambda k, t: places[k], RATE) == ["any", "b", None]
    assert free_name(["person-1"], [Wanted("person-2")]) == "person-3"


def test_a_place_of_before_the_frames_tells_nothing_and_that_is_said():
    places = np.array([[0.0, 0.0], [1.0, 1.0]])
    early, late = Wanted("b", place=(1.0, 1.0), time=-20.0), Wanted("c", place=(1.0, 1.0), time=-0.2)
    assert names_at_places([early], 2, lambda k, t: places[k], RATE) == ["b", None]
    assert names_at_places([late], 2, lambda k, t: places[k], RATE) == [None, "c"]
    assert "b 20.0 s" in said_of_places([early, late], 2)[0]
    assert not said_of_places([early, late], 1) and not said_of_places([late], 2)


def track(first, places):
    t = len(places)
    world = np.repeat(np.array(places, float)[:, None], 3, 1)
    points = np.ones((t, 2, 3, 3))
    return PersonTrack(first, points, world, np.zeros((t, 2), np.int64))


def test_key_points_belong_to_who_stands_where_they_do(rig):
    two = CameraRig(tuple(rig)[:2])
    people = KeypointPeople([track(0, [(0, 0, 1)] * 4), track(2, [(2, 0, 1)] * 8)], ("a", "b", "c"), two)
    assert people.at(1, np.array([0.1, 0.0]), ())[0] == 0
    assert people.at(1, np.array([2.0, 0.0]), ()) is None  # not yet followed
    assert people.at(3, np.array([1.9, 0.0]), ())[0] == 1
    assert people.at(3, np.array([1.9, 0.0]), [1]) is None  # another person's
    assert (people.of(0, 9).points == 0).all() and (people.of(0, 3).points[..., 2] == 1).all()
    assert people.lasting(20) == [1] and KeypointPeople([], ("a",), two).nothing.points.shape == (2, 1, 3)


def test_several_people_of_one_camera_or_of_nothing_are_refused(rig):
    frames, _ = two_people(rig, 2)
    with pytest.raises(InputError, match="key points"):
        PeopleRun(FrameList(frames, RATE), RATE, TrackOptions(evidence="both"))()
    with pytest.raises(InputError, match="key points"):
        PeopleRun(FrameList(frames, RATE), RATE, TrackOptions(evidence="keypoints"))()
    with pytest.raises(InputError, match="no frame"):
        PeopleRun(FrameList([], RATE), RATE, TrackOptions())()
