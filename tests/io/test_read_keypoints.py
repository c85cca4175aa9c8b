"""2D key points of every program's layout: the same detections come back from each, and what is misread is refused."""

import json

import numpy as np
import pytest

from benchmarks.robustness.keypoint_layouts import (
    LAYOUTS,
    RATE,
    UNSCORED,
    detections,
    write_keypoint_recording,
    write_keypoints,
)
from hypose.errors import InputError
from hypose.evidence.keypoint_check import misread
from hypose.evidence.keypoints import keypoint_names
from hypose.io.keypoints.keypoint_files import parse_openpose
from hypose.io.keypoints.read_keypoints import keypoints_of_views, read_keypoints
from hypose.io.recordings.frames import FrameSettings, load_person, working_rig
from hypose.io.recordings.recording import load_recording
from hypose.synthetic.scenes import camera_rig

FRAMES = 14
RIG = camera_rig("humaneva-4")


def written(folder, layout, points=None, stated=None, keypoint_set=None):
    kind = keypoint_set or LAYOUTS[layout][0]
    points = detections(kind, RIG, FRAMES) if points is None else points
    paths = write_keypoints(layout, folder / "points", points, RIG, kind)
    rate = None if "caliscope" in layout else RATE
    return write_keypoint_recording(folder, RIG, paths, stated, rate), points


def loaded(folder):
    recording = load_recording(folder)
    found = load_person(recording, working_rig(recording.rig, FrameSettings(longer_side=10_000))).keypoints
    return recording, np.stack([k.points for k in found], 1)


@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_the_same_detections_come_back(tmp_path, layout):
    kind = LAYOUTS[layout][0]
    points = detections(kind, RIG, FRAMES)
    points[1, 5] = 0  # nobody in one view and frame
    points[:, 3, 9] = 0  # a point that is missing
    folder, _ = written(tmp_path, layout, points)
    recording, found = loaded(folder)
    assert recording.keypoint_set == kind and recording.n_frames == FRAMES
    assert recording.frame_rate == pytest.approx(RATE, rel=1e-3)
    assert not recording.has_pictures and recording.rig.sizes.tolist() == RIG.sizes.tolist()
    want = np.stack([c.undistort_points(p[..., :2].reshape(-1, 2)) for c, p in zip(RIG, points, strict=True)])
    want = want.reshape(*points.shape[:3], 2)
    seen = points[..., 2] > 0
    assert ((found[..., 2] > 0) == seen).all()
    tolerance = 0.02 if layout == "ultralytics" else 1e-9  # its writer keeps six digits
    assert np.abs(found[..., :2] - want)[seen].max() <= tolerance
    scores = np.where(seen, 1.0, 0.0) if layout in UNSCORED else points[..., 2]
    assert np.abs(found[..., 2] - scores).max() <= 1e-5
    (note,) = [n for n in recording.notes if n.startswith("Key points:")]
    assert kind in note and "is the video's first" in note


def test_frames_count_from_where_the_program_counts(tmp_path):
    """MMPose's demo from 1, its inferencer and AlphaPose from 0, even when nobody is in the first frames."""
    for layout in ("mmpose-results", "mmpose-predictions", "alphapose", "ultralytics", "sleap-csv", "caliscope"):
        points = detections(LAYOUTS[layout][0], RIG, FRAMES)
        points[:, :4] = 0
        folder, _ = written(tmp_path / layout, layout, points)
        _, found = loaded(folder)
        assert found.shape[1] == FRAMES
        assert not found[:, :4, :, 2].any() and (found[:, 4:, 5, 2] > 0).all(), layout


def test_sets_of_one_length_are_told_apart_by_bones(tmp_path):
    for kind in ("BODY_25", "BODY_25B"):
        folder, _ = written(tmp_path / kind, "openpose", keypoint_set=kind)
        recording, _ = loaded(folder)
        assert recording.keypoint_set == kind
        assert any(f"{kind} (by the lengths of bones)" in n for n in recording.notes)
    other = written(tmp_path / "stated", "openpose", stated="BODY_25", keypoint_set="BODY_25B")[0]
    with pytest.raises(InputError, match=r"(?i)view.*the bones do not fit BODY_25 but BODY_25B"):
        load_recording(other)


def test_scores_beyond_one_are_scaled(tmp_path):
    points = detections("HALPE_26", RIG, FRAMES)
    points[..., 2] *= 6
    recording, found = loaded(written(tmp_path, "alphapose", points)[0])
    assert 0.9 < found[..., 2].max() <= 1
    assert any("scores divided by" in n and "since they exceed 1" in n for n in recording.notes)


def test_shares_of_the_picture_are_seen(tmp_path):
    points = detections("COCO_17", RIG, FRAMES)
    shares = points.copy()
    sizes = RIG.sizes[:, None, None]
    shares[..., :2] = np.where(points[..., 2:] > 0, (points[..., :2] + 0.5) / sizes, 0)
    recording, found = loaded(written(tmp_path, "mmpose-predictions", shares)[0])
    want = RIG[0].undistort_points(points[0, :, 5, :2])
    assert np.allclose(found[0, :, 5, :2], want, atol=1e-6)
    assert any("shares of the picture" in n for n in recording.notes)


# ---- misread or damaged: one sentence, and never another meaning ---------------------------------------------------


def flipped(points):
    out = points.copy()
    out[..., 1] = np.where(points[..., 2] > 0, RIG.sizes[:, None, None, 1] - 1 - points[..., 1], 0)
    return out


def scaled(factor):
    def change(points):
        out = points.copy()
        out[..., :2] = np.where(points[..., 2:] > 0, (points[..., :2] + 0.5) * factor - 0.5, 0)
        return out

    return change


ALL = slice(None)


def exchanged(points):
    names = keypoint_names("COCO_17")
    other = [names.index(n.replace("left", "#").replace("right", "left").replace("#", "right")) for n in names]
    return points[:, :, other]


@pytest.mark.parametrize(
    ("change", "views", "message"),
    [
        (flipped, ALL, r"all views: .* y counts from the bottom"),
        (scaled(0.5), ALL, r"all views: .* images 0\.5 times the calibrated size"),
        (scaled(1 / 3), ALL, r"all views: .* images 0\.333 times the calibrated size"),
        (scaled(2), ALL, r"they reach \(\d+, \d+\) px, the pictures are|images 2 times the calibrated size"),
        (flipped, 2, r"view .* y counts from the bottom"),
        (scaled(0.5), 2, r"view .* images 0\.5 times"),
        (exchanged, ALL, r"the person is mirrored"),
        (lambda p: p[..., [1, 0, 2]], ALL, r"x and y of the key points are exchanged|they reach"),
    ],
)
def test_misread_positions_are_refused(tmp_path, change, views, message):
    points = detections("COCO_17", RIG, FRAMES)
    points[views] = change(points)[views]
    folder, _ = written(tmp_path, "mmpose-predictions", points)
    with pytest.raises(InputError, match=message) as caught:
        load_recording(folder)
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")


@pytest.mark.parametrize(
    ("layout", "stated", "order", "message"),
    [
        ("coco-results", None, np.random.default_rng(3).permutation(17), "bones have impossible lengths"),
        ("rtmlib", "COCO_17", np.arange(26), r"there are 26 points per person, COCO_17 has 17"),
    ],
)  # fmt: skip
def test_another_set_or_order_of_points_is_refused(tmp_path, layout, stated, order, message):
    folder, _ = written(tmp_path, layout, detections(LAYOUTS[layout][0], RIG, FRAMES)[:, :, order], stated)
    with pytest.raises(InputError, match=message):
        load_recording(folder)


def test_cameras_of_one_file_are_found_by_name(tmp_path):
    points = detections("BLAZEPOSE_33", RIG, FRAMES)
    paths = write_keypoints("caliscope", tmp_path / "points", points, RIG, "BLAZEPOSE_33")
    found, _ = keypoints_of_views(paths[:2], ["cam_3", "cam_0"], ["a", "b"])
    for view, camera in zip(found, (3, 0), strict=True):
        assert np.array_equal(view.frame(4, (640, 480))[0, :, :2], points[camera, 4, :, :2])
    with pytest.raises(InputError, match=r"has the cameras 0, 1, 2, 3, and their names do not tell .* left, right"):
        keypoints_of_views(paths[:2], ["left", "right"], ["a", "b"])


def test_two_models_are_refused(tmp_path):
    a = write_keypoints("coco-results", tmp_path / "a", detections("COCO_17", RIG, FRAMES), RIG, "COCO_17")
    b = write_keypoints("alphapose", tmp_path / "b", detections("HALPE_26", RIG, FRAMES), RIG, "HALPE_26")
    with pytest.raises(InputError, match=r"different sets of key points \(.*COCO_17.*HALPE_26.*\)"):
        keypoints_of_views([a[0], b[1]], RIG.names[:2], RIG.names[:2])
    mixed = json.loads(a[0].read_text())
    mixed[3]["keypoints"] = mixed[3]["keypoints"][:30]
    a[0].write_text(json.dumps(mixed))
    with pytest.raises(InputError, match=r"people have 10, 17 key points"):
        read_keypoints(a[0])


@pytest.mark.parametrize("name", ["humaneva-4", "ring-3", "ring-4"])
def test_mirrored_pictures_are_told_where_cameras_stand_evenly(name):
    # such cameras, two of them exchanged, fit mirrored points nearly as well
    cameras = camera_rig(name)
    points = detections("BODY_25", cameras, FRAMES)
    width = cameras.sizes[:, 0, None, None]
    points[..., 0] = np.where(points[..., 2] > 0, width - 1 - points[..., 0], 0)
    people = [[view[t][None] for t in range(FRAMES)] for view in points]
    assert "mirrored" in str(misread(people, keypoint_names("BODY_25"), cameras))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("alphapose_cmu", "AlphaPose results"),
        ("ultralytics_id_missing", "Ultralytics labels"),
        ("pose_sync", "pose-sync"),
    ],
)
def test_recordings_of_other_programs(shared_data, name, words):
    """One of them has lines without the track's number, one has key points that Pose2Sim has synchronised."""
    recording, found = loaded(shared_data("outside_cases") / name)
    assert any(words in n for n in recording.notes) and found.shape[:2] == (4, 60)
    assert (found[..., 2] > 0.3).mean() > 0.5
    if name == "pose_sync":
        assert all(v.files["keypoints"].parent.name == "pose-sync" for v in recording.views)


def test_openpose_1_0_is_read():
    flat = [1.0, 2.0, 0.5] * 18
    assert parse_openpose({"people": [{"pose_keypoints": flat}]}).shape == (1, 18, 3)
