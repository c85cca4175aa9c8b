"""Every format of the tables: what is written comes back, and a spoilt file is refused or read as it is."""

import re

import numpy as np
import pytest

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.evidence.frame import SensorReport
from hypose.geometry import se3, so3_exp
from hypose.io.calibrations.calibration_formats import CALIBRATIONS, read_any, write_calibration
from hypose.io.keypoints.keypoint_files import KEYPOINTS
from hypose.io.keypoints.read_keypoints import read_keypoints
from hypose.io.motions.export import MOTION_FILES, export_motion
from hypose.io.sensors.skeleton_files import SKELETONS, read_skeletons
from hypose.pipeline.comparison import read_other
from scripts.fuzz_targets import targets

TABLES = {"calibration": CALIBRATIONS, "keypoints": KEYPOINTS, "motion": MOTION_FILES, "skeleton": SKELETONS}
SAMPLES = [t for t in targets().values() if t.name.split("-")[0] in TABLES and t.name != "calibration-points"]
NOT_SAMPLED = {"OpenPose (one frame)"}
"""Formats that are recognised only to say what to give instead."""
BOTH_WAYS = [
    (table, f) for table in TABLES.values() for f in table.formats if f.read is not None and f.write is not None
]


def table_of(target):
    return TABLES[target.name.split("-")[0]]


def given(target, folder):
    return folder / (target.given or target.file)


def numbers(kind, path):
    """All numbers that a file holds, by name: of a camera, of a view and frame, of a joint, of a sensor."""
    if kind == "calibration":
        return {
            c.name: np.concatenate([c.K.ravel(), c.distortion, c.camera_from_world.ravel()]) for c in read_any(path)[0]
        }
    if kind == "keypoints":
        found = read_keypoints(path)
        return {
            (name, n): np.asarray(table.people[n]) for name, table in found.items() for n in list(table.people)[:30]
        }
    if kind == "motion":
        found = MOTION_FILES.read(path)
        if isinstance(found, tuple):
            return dict(zip(found[1], found[2].T, strict=True))
        points = getattr(found, "points", getattr(found, "joints", None))
        names = found.names if hasattr(found, "names") else found.skeleton.joint_names
        return {name: points[:, i] for i, name in enumerate(names)}
    return {s.name: s.positions for s in read_skeletons(path).streams}


def test_every_format_that_is_read_has_a_sample(good):
    for kind, table in TABLES.items():
        found = {table.find(given(t, good))[0].name for t in SAMPLES if table_of(t) is table}
        wanted = {f.name for f in table.formats if f.read is not None}
        assert found == wanted - NOT_SAMPLED, kind


@pytest.mark.parametrize(("table", "one"), BOTH_WAYS, ids=[f.name for _, f in BOTH_WAYS])
def test_what_is_written_comes_back(tmp_path, rng, small_motion, small_body, table, one):
    if table is CALIBRATIONS:
        lens = np.array([-0.21, 0.07, 1e-3, -5e-4, 0.011])
        k = np.array([[900.0, 0, 630.5], [0, 897.0, 365.25], [0, 0, 1]])
        poses = [se3(so3_exp(rng.normal(0, 1, 3)), rng.normal(0, 2, 3)) for _ in range(3)]
        rig = CameraRig(tuple(Camera(f"cam{i + 1}", k, lens, pose, (1280, 720)) for i, pose in enumerate(poses)))
        write_calibration(rig, tmp_path / "a.toml")
        back, _ = read_any(tmp_path / "a.toml")
        assert back.names == rig.names
        for a, b in zip(back, rig, strict=True):
            assert a.size == b.size
            for name in ("K", "distortion", "camera_from_world"):
                np.testing.assert_allclose(getattr(a, name)[:5], getattr(b, name)[:5], atol=one.precision)
    elif table is MOTION_FILES:
        path, *_ = export_motion(small_motion, small_body, tmp_path, [one.name])
        back = read_other(path)
        np.testing.assert_allclose(np.diff(back.times), np.diff(small_motion.times), atol=1e-6)
        for name, points in back.points.items():
            want = small_motion.joints[:, small_motion.skeleton.joint(name)]
            np.testing.assert_allclose(points, want, atol=one.precision)
        assert back.points or "knee_angle_r" in back.angles
    else:
        writer = one.write(tmp_path / "rec")
        points = rng.normal(size=(8, 3, 3))
        for n, body in enumerate(points):
            writer.add(SensorReport("a", n / 30, 3, ("head", "neck", "torso"), body, np.full(3, 2, np.uint8)))
        writer.close()
        (stream,) = read_skeletons(tmp_path / "rec").streams
        np.testing.assert_allclose(stream.positions[:, 0], points, atol=one.precision)


def refused(path, read):
    """The value of a file that is read; None where it is refused in one sentence that names it, or its folder."""
    try:
        return read()
    except InputError as error:
        text = str(error)
        assert "\n" not in text and text.endswith(".") and len(text) < 1000, text
        assert path.name in text or path.parent.name in text, text
        return None


def spoilt(data):
    """A file cut at ten places, with NaN and huge numbers and words in place of a number, and empty."""
    cuts = [data[: len(data) * k // 11] for k in range(1, 11)]
    places = [m.span() for m in re.finditer(rb"-?\d+\.\d+", data)] or [m.span() for m in re.finditer(rb"\d+", data)]
    words = (b"nan", b"1e300", b"9" * 400, b'"word"')
    middle = [places[len(places) * k // 4] for k in (1, 2, 3)] if len(places) > 3 else places
    return [b"", *cuts, *(data[:a] + word + data[b:] for word in words for a, b in middle)]


@pytest.mark.parametrize("target", SAMPLES, ids=lambda t: t.name)
def test_spoilt_files_are_refused_in_a_sentence_or_read_as_they_are(good, target):
    file, kind = good / target.file, target.name.split("-")[0]
    whole, path = file.read_bytes(), given(target, good)
    want = numbers(kind, path)
    try:
        for k, data in enumerate(spoilt(whole)):
            file.write_bytes(data)
            found = refused(path, lambda: numbers(kind, path))
            assert (
                found is None
                or not np.isinf(np.concatenate([v.ravel() for v in found.values()] or [np.zeros(1)])).any()
            )
            if found is not None and 0 < k <= 10:  # cut: what is read is what stands there
                for name, values in found.items():
                    part = want[name].ravel()[: values.size]
                    found_part = values.ravel()[: part.size]
                    same = np.isclose(found_part, part, atol=1e-6) | np.isnan(found_part)  # NaN: what was cut off
                    assert same.all(), (target.name, k, name)
    finally:
        file.write_bytes(whole)


@pytest.mark.parametrize("target", SAMPLES, ids=lambda t: t.name)
def test_a_file_of_another_format_is_never_taken_for_this_one(good, target):
    """Under the name of this format: it is refused, or it is read as what it is."""
    file, path, table = good / target.file, given(target, good), table_of(target)
    whole = file.read_bytes()
    try:
        for other in SAMPLES:
            data = (good / other.file).read_bytes()
            # a file that is no calibration beside one that is one belongs to something else
            if other.given or data == whole or target.name == "calibration-opencv-folder":
                continue
            file.write_bytes(data)
            found = refused(path, lambda: numbers(target.name.split("-")[0], path))
            if found is not None and table_of(other) is not table:
                pytest.fail(f"{other.name} is taken for {target.name}")
    finally:
        file.write_bytes(whole)


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
@pytest.mark.parametrize("name", ["absent.toml", "a.unknown", "folder"])
def test_what_cannot_be_read_is_named_with_what_can(tmp_path, table, name):
    (tmp_path / "a.unknown").write_text("x")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=rf"^[^\n]*{re.escape(name)}[^\n]*(does not exist|is no)[^\n]*\.$") as caught:
        table.read(tmp_path / name)
    if name == "a.unknown":
        assert all(s in str(caught.value) for f in table.formats if f.read for s in f.suffixes if s[:1] == ".")


@pytest.mark.parametrize("table", [CALIBRATIONS, SKELETONS], ids=["calibration", "skeleton"])
def test_a_file_of_another_kind_is_called_by_its_name(good, table):
    with pytest.raises(InputError, match="cam1.json is not .*, it looks like .* key points of MMPose;"):
        table.read(good / "keypoints" / "mmpose-predictions" / "cam1.json")
