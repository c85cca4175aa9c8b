"""Cameras from measured points: the truth, a wrong click, files and their errors."""

import numpy as np
import pytest

from benchmarks.synthetic.calibration_boards import ring_of_cameras
from hypose.calibration.from_points import ScenePoints, calibrate_from_points, read_scene_points
from hypose.errors import CalibrationError, InputError

PLACES = {
    "a": [0, 0, 0], "b": [1.2, 0, 0], "c": [1.1, 1.3, 0], "d": [-0.2, 1, 0], "e": [0, 0, 1.5], "f": [1.2, 0.1, 0.8],
    "g": [-0.9, 0.4, 1.1], "h": [0.5, -1.0, 0.3],
}  # fmt: skip


def scene(rng, noise=0.5, names="abcdefgh"):
    rig = ring_of_cameras(rng, 3)
    points = {n: np.array(PLACES[n], dtype=float) for n in names}
    clicks = {c.name: {n: c.project(p) + rng.normal(0, noise, 2) for n, p in points.items()} for c in rig}
    return rig, ScenePoints(points, clicks, {c.name: c.size for c in rig})


def test_known_lenses(rng):
    rig, given = scene(rng)
    found = calibrate_from_points(given, rig)
    for a, b in zip(found.rig, rig, strict=True):
        assert np.linalg.norm(a.position - b.position) < 0.02
        np.testing.assert_array_equal(a.K, b.K)
    assert found.rms_px < 1 and not found.warnings
    assert (found.position_sd < 0.05).all()


def test_unknown_lenses(rng):
    rig, given = scene(rng, 0.3)
    found = calibrate_from_points(given)
    for a, b in zip(found.rig, rig, strict=True):
        assert a.K[0, 0] == pytest.approx(b.K[0, 0], rel=0.06)
        assert np.linalg.norm(a.position - b.position) < 0.3
    assert all("uncertain by" in n for n in found.notes)


def test_a_wrong_click_is_named_and_does_little(rng):
    rig, given = scene(rng)
    given.clicks["cam2"]["f"] += [60, -35]  # type: ignore[index]
    found = calibrate_from_points(given, rig)
    assert len(found.warnings) == 1 and found.warnings[0].startswith("cam2: the point f lies")
    assert np.linalg.norm(found.rig[1].position - rig[1].position) < 0.06


@pytest.mark.parametrize(
    ("names", "lenses", "message"),
    [
        ("abc", True, "3 points are clicked, at least 4 are needed with a known lens"),
        ("abcde", False, "5 points are clicked, at least 6 are needed without a known lens"),
    ],
)
def test_too_few_points(rng, names, lenses, message):
    rig, given = scene(rng, 0.3, names)
    with pytest.raises(CalibrationError, match=message):
        calibrate_from_points(given, rig if lenses else None)


def test_points_of_one_plane_do_not_give_a_lens(rng):
    _, given = scene(rng)
    flat = {n: p * [1, 1, 0] + [0, 0.1 * i, 0] for i, (n, p) in enumerate(given.points.items())}
    with pytest.raises(CalibrationError, match="all its points lie in one plane"):
        calibrate_from_points(ScenePoints(flat, given.clicks, given.sizes))
    with pytest.raises(CalibrationError, match="size of its picture is not known"):
        calibrate_from_points(ScenePoints(given.points, given.clicks, {}))


TEXT = """
unit = "cm"
[points]
a = [0, 0, 0]
b = [120, 0, 0]
[clicks.cam1]
size = [640, 480]
a = [10, 20.5]
b = [30, 40]
"""


def test_the_file(tmp_path):
    path = tmp_path / "points.toml"
    path.write_text(TEXT)
    found = read_scene_points(path)
    np.testing.assert_allclose(found.points["b"], [1.2, 0, 0])
    np.testing.assert_allclose(found.clicks["cam1"]["a"], [10, 20.5])
    assert found.sizes == {"cam1": (640, 480)}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"cm"', '"feet"', "unit must be m, cm or mm, got 'feet'"),
        ("[points]", "[point]", "point is unknown; known are unit"),
        ("b = [120, 0, 0]", "b = [120, 0]", r"\[points\]: b must be numbers of shape 3"),
        ("b = [30, 40]", "q = [30, 40]", "the point q has no place in"),
        ("b = [30, 40]", "b = [30, nan]", "b contains NaN"),
        ("[640, 480]", "[640, 0]", "size must be"),
        ("[clicks.cam1]", "[clicks", "is not valid TOML"),
    ],
)
def test_bad_files(tmp_path, old, new, message):
    path = tmp_path / "points.toml"
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_scene_points(path)
