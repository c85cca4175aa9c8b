"""Several people of a recording: whose key points, whose names, what is kept of an interrupted run."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.association import PersonTrack
from hypose.evidence.frame import Frame
from hypose.pipeline import people
from hypose.pipeline.recorded_frames import count_people
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_people
from hypose.pipeline.track_loop import body_shape
from hypose.pipeline.track_management import KeypointPeople, KnownPerson, names_at_places, per_frame, said_of_places
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.scenes import make_scene
from hypose.tracking.start_search import known_pose
from tests.evidence.scenes import masks_of
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
    for t in range(frames):
        here = []
        for x, y in ((-0.45 + 0.02 * t, -0.4), (0.45 - 0.02 * t, 0.4)):
            pose = base.copy()
            pose[:2] += (x, y)
            here.append(pose)
        truth.append(np.stack(here))
        shown = [body_shape(body, pose, rig) for pose in here[: 1 if t in away else 2]]
        out.append(Frame(t / RATE, t, masks_of(shown, rig)))
    return out, np.stack(truth, 1)


def both(frames, **more):
    given = (
        KnownPerson("anna", body=human(), place=(-0.45, -0.4)),
        KnownPerson("bert", body=human(), place=(0.45, 0.4)),
    )
    about = {"options": TrackOptions(smooth=False), "wanted": given} | more
    return track_people(FrameList(frames, RATE), RATE, **about)


def test_two_people_who_pass_each_other_are_tracked_each_by_their_name(rig):
    frames, truth = two_people(rig, 14)
    assert count_people(lambda t: frames[t], len(frames)) == 2
    found = both(frames)
    assert found.complete and [p.name for p in found.people] == ["anna", "bert"] and found.others == 0
    for p, q in zip(found.people, truth, strict=True):
        true = human().joints(q)
        away = np.linalg.norm(p.motion.joints - true, axis=-1)
        assert away.mean() < 0.03 and away.mean(1).max() < 0.06
        assert p.there.all()


@pytest.mark.slow
def test_a_view_that_shows_nobody_takes_nobody_away(rig):
    frames, truth = two_people(rig, 8)
    for f in frames:
        f.silhouettes.masks[2], f.silhouettes.usable[2] = 0, False  # as frames of recordings have it
    found = both(frames)
    assert [p.name for p in found.people] == ["anna", "bert"]
    for p, q in zip(found.people, truth, strict=True):
        away = np.linalg.norm(p.motion.joints - human().joints(q), axis=-1)
        assert p.there.all() and away.mean() < 0.06
        assert p.motion.n_views.max() == 3


@pytest.mark.slow
def test_one_of_two_is_the_one_asked_for_and_the_others_are_told(rig):
    frames, truth = two_people(rig, 6)
    found = both(frames, count=1, wanted=(KnownPerson("bert", body=human(), place=(0.45, 0.4)),))
    assert [p.name for p in found.people] == ["bert"] and found.others == 1
    away = np.linalg.norm(found.people[0].motion.joints - human().joints(truth[1]), axis=-1)
    assert away.mean() < 0.03


@pytest.mark.slow
def test_an_interrupted_run_goes_on_to_the_same_bytes(rig, tmp_path):
    frames, _ = two_people(rig, 10)
    whole = both(frames)
    results = tmp_path

    half = both(frames, results=results, progress=stop_at("track", 6))
    assert not half.complete and (results / "checkpoint.npz").exists()
    assert all(len(p.motion) == 6 for p in half.people)
    rest = both(frames, results=results, resume=True)
    assert rest.complete and not (results / "checkpoint.npz").exists()
    for a, b in zip(whole.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.motion.poses, b.motion.poses)
        np.testing.assert_array_equal(a.motion.joint_covariance, b.motion.joint_covariance)
    assert (tmp_path / "anna" / "motion.npz").exists() and (tmp_path / "bert" / "motion.npz").exists()


@pytest.mark.slow
@pytest.mark.parametrize("nth", [1, 2])
def test_an_interruption_while_a_person_is_finished_is_one_of_the_run(rig, tmp_path, nth):
    frames, _ = two_people(rig, 6)
    whole = both(frames, options=TrackOptions())
    results, times, at = tmp_path, [], []

    def stop(stage, done, total):
        at.append((stage, done))
        times.extend([1] * (stage == "smooth" and done == 0))
        if stage == "smooth" and done == 0 and len(times) == nth:
            raise KeyboardInterrupt

    half = both(frames, results=results, progress=stop, options=TrackOptions())
    assert not half.complete and (results / "checkpoint.npz").exists() and len(half.people) == 2
    assert at[-1] == ("smooth", 0)  # nothing is smoothed after it
    at.clear()
    rest = both(frames, results=results, resume=True, progress=stop, options=TrackOptions())
    assert rest.complete and ("subject", 0) not in at and ("track", 5) not in at  # nobody is searched or tracked again
    for a, b in zip(whole.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.motion.poses, b.motion.poses)
        np.testing.assert_array_equal(a.motion.joint_covariance, b.motion.joint_covariance)
    left = [p.name for p in tmp_path.rglob("*") if p.is_file()]
    assert not {"checkpoint.npz", "subject.npz"} & set(left)


@pytest.mark.slow
def test_a_frame_that_is_interrupted_half_way_is_taken_back(rig, tmp_path, monkeypatch):
    frames, _ = two_people(rig, 8)
    whole, results = both(frames), tmp_path
    parted = people.part_doubles

    def ctrl_c(tracked, together):
        parted(tracked, together)
        if len(tracked[0].estimates) == 5:
            tracked[0].present[-1] = False
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(people, "part_doubles", ctrl_c)
        half = both(frames, results=results)
    assert [len(p.motion) for p in half.people] == [4, 4]
    rest = both(frames, results=results, resume=True)
    for a, b in zip(whole.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.motion.poses, b.motion.poses)
        np.testing.assert_array_equal(a.there, b.there)


@pytest.mark.slow
def test_who_leaves_and_returns_is_the_same_person(rig):
    frames, truth = two_people(rig, 40, away=range(8, 24))
    found = both(frames)
    assert [p.name for p in found.people] == ["anna", "bert"]
    bert = found.people[1]
    assert not bert.there[12:22].any() and bert.there[:6].all() and bert.there[-4:].all()
    joints = human().joints(truth[1])
    away = np.linalg.norm(bert.motion.joints - joints, axis=-1).mean(1)
    assert away[:6].max() < 0.06 and away[-4:].max() < 0.08
    assert len(per_frame(bert.motion, bert.there)["lost"]) == bert.there.sum()
    assert bert.assessment.word in ("good", "look", "not to be trusted")


@pytest.mark.slow
def test_who_comes_later_is_not_taken_for_somebody_who_stands_elsewhere(rig, tmp_path):
    frames, _ = two_people(rig, 24, away=range(12))
    given = [
        KnownPerson("anna", body=human(), place=(-0.45, -0.4)),
        KnownPerson("carl", body=human(), place=(9.0, 9.0)),
    ]
    given.append(KnownPerson("bert", body=human(), place=(0.05, 0.4), time=20 / RATE))
    reported: list[str] = []
    found = both(frames, progress=lambda stage, *_: reported.append(stage), wanted=given)
    assert "subject" in reported[reported.index("track") :]  # the start of who comes is told as a start
    assert [p.name for p in found.people] == ["anna", "bert"]
    assert not found.people[1].there[:10].any() and found.people[1].there[-4:].all()

    def stop(stage, done, total):
        at.append(stage)
        if stage == "subject" and "track" in at:
            raise KeyboardInterrupt

    # a frame in which a start is interrupted is taken back; the resumed run does it whole
    kept, at = tmp_path, []
    half = both(frames, progress=stop, results=kept, wanted=given)
    assert not half.complete and [p.name for p in half.people] == ["anna"]
    rest = both(frames, results=kept, resume=True, wanted=given)
    for a, b in zip(found.people, rest.people, strict=True):
        np.testing.assert_array_equal(a.motion.poses, b.motion.poses)


def test_wanted_people_are_those_who_stand_at_their_places():
    places = np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 0.0]])
    wanted = [KnownPerson("b", place=(1.1, 0.9)), KnownPerson("far", place=(9.0, 9.0)), KnownPerson("any")]
    assert names_at_places(wanted, 3, lambda k, t: places[k], RATE) == ["any", "b", "person-1"]
    assert names_at_places(
        [KnownPerson("person-2", place=(9.0, 9.0))], 1, lambda k, t: places[k], RATE, ["person-1"]
    ) == ["person-3"]


def test_a_place_of_before_the_frames_tells_nothing_and_that_is_said():
    places = np.array([[0.0, 0.0], [1.0, 1.0]])
    early, late = KnownPerson("b", place=(1.0, 1.0), time=-20.0), KnownPerson("c", place=(1.0, 1.0), time=-0.2)
    assert names_at_places([early], 2, lambda k, t: places[k], RATE) == ["b", "person-1"]
    assert names_at_places([late], 2, lambda k, t: places[k], RATE) == ["person-1", "c"]
    assert "b 20.0 s" in said_of_places([early, late], 2)[0]
    assert not said_of_places([early, late], 1) and not said_of_places([late], 2)


def track(first, places):
    t = len(places)
    world = np.repeat(np.array(places, float)[:, None], 3, 1)
    points = np.ones((t, 2, 3, 3))
    return PersonTrack(first, points, world, np.zeros((t, 2), np.int64))


def test_key_points_belong_to_who_stands_where_they_do(rig):
    two = CameraRig(tuple(rig)[:2])
    found = KeypointPeople([track(0, [(0, 0, 1)] * 4), track(2, [(2, 0, 1)] * 8)], ("a", "b", "c"), two)
    assert found.at(1, np.array([0.1, 0.0]), ())[0] == 0
    assert found.at(1, np.array([2.0, 0.0]), ()) is None  # not yet followed
    assert found.at(3, np.array([1.9, 0.0]), ())[0] == 1
    assert found.at(3, np.array([1.9, 0.0]), [1]) is None  # another person's
    assert (found.of(0, 9).points == 0).all() and (found.of(0, 3).points[..., 2] == 1).all()
    assert found.lasting(20) == [1] and KeypointPeople([], ("a",), two).nothing.points.shape == (2, 1, 3)


def test_several_people_of_one_camera_or_of_nothing_are_refused(rig):
    frames, _ = two_people(rig, 2)
    with pytest.raises(InputError, match="key points"):
        track_people(FrameList(frames, RATE), RATE, TrackOptions(evidence="both"))
    with pytest.raises(InputError, match="key points"):
        track_people(FrameList(frames, RATE), RATE, TrackOptions(evidence="keypoints"))
    with pytest.raises(InputError, match="no frame"):
        track_people(FrameList([], RATE), RATE, TrackOptions())
