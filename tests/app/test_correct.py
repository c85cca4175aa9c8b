"""`hypose correct`: a result tracked again from a corrected frame, the frames before left as they were."""

import json
import shutil

import numpy as np
import pytest

from hypose.app.jobs.correct import read_correction
from hypose.errors import InputError
from hypose.io.motions.results import load_body, load_motion
from hypose.pipeline.comparison import compare_with_truth
from tests.app.conftest import fails

FRAME = 3


@pytest.fixture
def result(recording, tracked):
    """A result of the recording: its folder and its motion."""
    results = shutil.copytree(tracked, recording / "results" / "default")
    return results, load_motion(results / "motion.npz")


def clicks(recording, frame, pose, **more):
    path = recording / "starts" / "arm.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps({"format": "hypose-clicks", "version": 1, "frame": frame, "pose": list(pose), **more}))
    return path


def test_the_rest_is_tracked_again_from_the_corrected_pose(result, recording, hypose):
    results, motion = result
    corrected = motion.poses[FRAME].copy()
    corrected[motion.skeleton.dofs_of("left_elbow")] += 0.2
    file = clicks(recording, FRAME, corrected)
    code, out, err = hypose("correct", results, file, "--formats", "trc")
    assert code == 0, err
    assert f"Frames {FRAME} and after" in out
    folder = recording / "results" / "default-corrected"
    again, body = load_motion(folder / "motion.npz"), load_body(folder / "body.npz")
    assert len(again) == len(motion)
    np.testing.assert_array_equal(again.poses[:FRAME], motion.poses[:FRAME])
    np.testing.assert_allclose(again.joints, body.joints(again.poses), atol=1e-9)
    off, before = (compare_with_truth(recording / "truth.npz", m, 0).distances[FRAME:].mean() for m in (again, motion))
    assert off < 1.2 * before, "tracked from a start that is 11 degrees off at one elbow it is as good as it was"
    assert not np.array_equal(again.poses[FRAME:], motion.poses[FRAME:])
    assert again.provenance["corrections"] == [{"clicks": "arm", "frame": FRAME, "of": "default", "until": 8}]
    assert {"motion.trc", "report.html", "provenance.json"} <= {p.name for p in folder.iterdir()}
    np.testing.assert_array_equal(load_motion(results / "motion.npz").poses, motion.poses)


def test_a_correction_reaches_back_as_far_as_it_says(result, recording, hypose):
    results, motion = result
    row, since, until = 4, 2, 7
    file = clicks(recording, row, motion.poses[row], since=since, until=until)
    code, _, err = hypose("correct", results, file, "--formats", "trc")
    assert code == 0, err
    again = load_motion(recording / "results" / "default-corrected" / "motion.npz")
    changed = (again.poses != motion.poses).any(1)
    assert changed[since:until].all() and not changed[:since].any() and not changed[until:].any()
    np.testing.assert_allclose(again.times, motion.times)
    legs = [motion.skeleton.joint(f"{side}_{part}") for side in ("left", "right") for part in ("hip", "knee", "ankle")]
    truth = np.load(recording / "truth.npz")["joints"][
        since:until, legs
    ]  # which frame it is shows in how somebody steps
    off, before = (np.linalg.norm(m.joints[since:until, legs] - truth, axis=-1).mean() for m in (again, motion))
    assert off < 1.2 * before, "frames that were tracked backwards are in their own places"
    (record,) = again.provenance["corrections"]
    assert record == {"clicks": "arm", "frame": row, "since": since, "of": "default", "until": until}


def test_what_cannot_be_corrected_is_said(result, recording, hypose, tmp_path):
    results, motion = result

    pose, alone = motion.poses[0], shutil.copytree(results, tmp_path / "alone")
    for wrong, folder, frame, clicked, about, more in (
        ("not part of this result", results, 8, pose, {}, ()),
        ("not part of this result", results, 3, pose, {}, ("--until", 3)),
        ("not part of this result", results, 3, pose, {"since": 4}, ()),
        ("corrected pose", results, 3, pose, {"until": "end"}, ()),
        ("another body", results, 3, pose[:-1], {}, ()),
        ("folder of its own", results, 3, pose, {}, ("--out", results)),
        ("lies in no recording", alone, 3, [0.0], {}, ()),
    ):
        fails(hypose("correct", folder, clicks(recording, frame, clicked, **about), *more), wrong)
    for text in ("", "{}", "[1]", '{"format": "hypose-clicks", "frame": 1, "pose": ["x"]}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(InputError, match=r"corrected pose|empty"):
            read_correction(tmp_path / "bad.json")
