"""`hypose fuse` of recordings, through the command line."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.skeleton_folders import write_folder
from hypose.evidence.frame import SensorReport
from hypose.fusion.joints import COMMON, MIRROR
from hypose.geometry import procrustes, transform
from hypose.io.motions.marker_files import read_trc
from hypose.io.motions.results import load_motion
from hypose.io.sensors.skeleton_files import SkeletonRecording, build_stream
from tests.app.conftest import fails
from tests.depth_sensors import camera, places, walker

ANGLES = (0, 60, -60)


def recorded(rng, people=1, seconds=5.0, starts=(0.0, 0.0, 0.0), common=True, rates=(30, 30, 25)):
    streams = []
    for k, angle in enumerate(ANGLES):
        reports = []
        for n in range(int(seconds * rates[k])):
            t = n / rates[k] + 0.003 * k
            for p in rng.permutation(people):
                joints = walker(t, places(people)[p], 1.3 * p) + 0.008 * rng.normal(size=(15, 3))
                seen = transform(camera(angle), joints)
                reports.append(SensorReport(f"s{k}", t + starts[k], int(p + 10 * k), COMMON, seen, np.full(15, 2)))
        streams.append(build_stream(reports, "rec")[0])
    return SkeletonRecording("rec", tuple(streams), "s0", {}, common_clock=common)


def truth_in_world(motion, place=(0.0, 0.0), phase=0.0):
    """Truth on the motion's frames, moved onto it as a whole: the world's origin is below the reference sensor."""
    order = [COMMON.index(n) for n in motion.skeleton.joint_names]
    true = np.stack([walker(t, place, phase)[order] for t in motion.times])
    moved, _ = procrustes(true.reshape(-1, 3), motion.joints.reshape(-1, 3))
    return transform(moved, true)


# ---- recorded ----


def fused(hypose, recording, folder, *options, code=0):
    """What `hypose fuse` printed, the motion and the folder of its results."""
    write_folder(recording, folder)
    ended, out, err = hypose("fuse", folder, *options)
    assert ended == code, out + err
    (results,) = (folder / "results").iterdir()
    return out + err, load_motion(results / "motion.npz"), results


def error(motion, *where):
    return np.linalg.norm(motion.joints - truth_in_world(motion, *where), axis=-1)


def assessment(results):
    return json.loads((results / "assessment.json").read_text())


def test_a_recording_becomes_a_motion_and_its_files(hypose, rng, tmp_path):
    said, motion, results = fused(hypose, recorded(rng), tmp_path / "rec")
    names = {"motion.npz", "motion.trc", "motion.c3d", "joints.csv", "sensors.csv", "provenance.json"}
    assert results.name == "fuse-fit" and {p.name for p in results.iterdir()} == {*names, "assessment.json"}
    assert len(motion) == 150 and motion.frame_rate == pytest.approx(30) and error(motion).mean() < 0.02
    # z up, the floor at 0
    height = {n: np.median(motion.joints[:, motion.skeleton.joint(n), 2]) for n in ("left_foot", "right_foot", "head")}
    assert 0 < height["left_foot"] < 0.2 and 0 < height["right_foot"] < 0.2 and 1.5 < height["head"] < 1.8
    assert read_trc(results / "motion.trc").points.shape == (150, 15, 3)
    record = json.loads((results / "provenance.json").read_text())
    assert set(record["inputs"]) == {"session.json", "frames.csv", "skeleton.csv"}
    header = (results / "sensors.csv").read_text().splitlines()[0]
    assert "left_hand:s1" in header
    assert "150 frames of 3 sensors at 30 Hz" in said
    assert "Assessment: Good" in said and assessment(results)["assessment"] == "good"


def changed(recording, number, change):
    """The recording with the joints (T, P, J, 3) of one sensor, or of all (None), as `change` makes them."""
    streams = [
        replace(s, positions=change(s.positions)) if number in (k, None) else s for k, s in enumerate(recording.streams)
    ]
    return replace(recording, streams=tuple(streams))


def beside(joints):
    """Arms are named the wrong way round, and legs lie 0.2 m apart from where they are."""
    out = joints.copy()
    out[:, :, 2:8] = joints[:, :, MIRROR[2:8]]
    out[:, :, 9:15] += np.where(np.arange(9, 15) < 12, 0.2, -0.2)[:, None] * [1, 0, 0]
    return out


def test_an_arm_that_the_sensors_see_in_different_places_is_worth_a_look(hypose, rng, tmp_path):
    def elsewhere(where):
        def change(joints):
            out = joints.copy()
            out[60:90, :, COMMON.index("left_hand")] += where
            return out

        return change

    recording = changed(changed(recorded(rng), 1, elsewhere([0.15, 0.1, 0])), 0, elsewhere([0, -0.15, 0.1]))
    _, motion, results = fused(hypose, recording, tmp_path / "rec")
    kept = assessment(results)
    assert kept["assessment"] == "look" and "left hand may be wrong there" in kept["sentence"]
    assert all(58 <= begin and end <= 95 for begin, end in kept["frames"])
    hand = motion.error_probability[:, motion.skeleton.joint("left_hand")]
    assert hand[62:88].mean() > 3 * hand[:55].mean()


@pytest.mark.parametrize(
    "number, change, words",
    [
        (None, lambda p: 3.2808 * p, "m tall, by their legs: the lengths are feet"),
        (None, lambda p: 0.1 * p, "m tall, by their legs: centimetres and millimetres are mixed up"),
        (2, beside, "s2 and s0 see the joints 2"),
    ],
)
def test_what_is_no_person_or_not_the_same_is_not_to_be_trusted(hypose, rng, tmp_path, number, change, words):
    recording = changed(recorded(rng, seconds=6), number, change)
    said, _, results = fused(hypose, recording, tmp_path / "rec", "--formats", "csv", code=3)
    assert words in said.split("Assessment: Not to be trusted")[1]
    assert assessment(results)["assessment"] == "not to be trusted"


@pytest.mark.parametrize("method", ["swarm", "published"])
def test_other_methods(hypose, rng, tmp_path, method):
    given = ("--method", method, "--formats", "csv", "--rate", "25")
    _, motion, results = fused(hypose, recorded(rng, seconds=2), tmp_path / "rec", *given)
    assert results.name == f"fuse-{method}" and motion.frame_rate == pytest.approx(25)
    assert error(motion).mean() < 0.05


def test_persons_get_a_folder_each(hypose, rng, tmp_path):
    write_folder(recorded(rng, people=3, seconds=4), tmp_path / "rec")
    code, out, err = hypose("fuse", tmp_path / "rec", "--out", tmp_path / "out", "--formats", "trc")
    assert code == 0, err
    motions = [load_motion(tmp_path / "out" / f"person-{n}" / "motion.npz") for n in (1, 2, 3)]
    off = np.array([[error(m, places(3)[p], 1.3 * p).mean() for p in range(3)] for m in motions])
    assert sorted(off.argmin(1)) == [0, 1, 2] and off.min(1).max() < 0.025


def test_own_clocks_are_set_by_the_movement(hypose, rng, tmp_path):
    recording = recorded(rng, seconds=12, starts=(0.0, 1000.4, -77.7), common=False)
    said, motion, _ = fused(hypose, recording, tmp_path / "rec", "--formats", "csv")
    assert said.count("clock was set by the movement") == 2 and error(motion)[30:300].mean() < 0.025


def test_a_real_recording(hypose, shared_data, tmp_path):
    path = shared_data("kinect_multitrack") / "Study_2_Kinect_2_Time_12_32_04_PM.csv.gz"
    code, out, err = hypose("fuse", path, "--out", tmp_path / "out", "--formats", "trc")
    assert code == 0, err
    assert (tmp_path / "out" / "motion.trc").is_file() or (tmp_path / "out" / "person-1" / "motion.trc").is_file()


def test_recordings_of_different_persons_are_refused(hypose, rng, tmp_path):
    made = recorded(rng, seconds=3)
    child = replace(made.streams[1], positions=0.6 * made.streams[1].positions)
    write_folder(replace(made, streams=(made.streams[0], child)), tmp_path / "rec")
    fails(hypose("fuse", tmp_path / "rec"), "do not seem to see the same person")
