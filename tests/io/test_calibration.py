"""Calibration files: what is written comes back, what other programs write is understood, the rest is
refused."""

import tomllib

import cv2
import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.errors import CalibrationError
from hypose.io.calibrations.calibration_formats import find_calibration, read_any
from hypose.io.calibrations.calibration_text import write_calibration
from hypose.io.files import toml_value
from tests.io.recordings import make_camera, make_rig

POINTS = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 3))


def assert_same(a, b, tolerance=1e-9):
    assert a.names == b.names
    for x, y in zip(a, b, strict=True):
        assert x.size == y.size and x.fisheye == y.fisheye
        assert np.array_equal(x.K, y.K)
        assert np.allclose(x.project(POINTS), y.project(POINTS), atol=tolerance)


def test_round_trip(tmp_path):
    rig = CameraRig((make_camera("cam 1.a"), make_camera('ü"\\#', 2.0, fisheye=True), make_camera("3", -1.0)))
    write_calibration(rig, tmp_path / "calibration.toml")
    assert_same(rig, read_any(tmp_path / "calibration.toml")[0])
    first = (tmp_path / "calibration.toml").read_bytes()
    write_calibration(read_any(tmp_path / "calibration.toml")[0], tmp_path / "again.toml")
    again = read_any(tmp_path / "again.toml")[0]
    assert_same(rig, again)
    assert first.startswith(b'["cam 1.a"]')


def test_written_file_serves_pose2sim_and_anipose(tmp_path):
    """Their readers take every table but metadata, Rodrigues rotations and these keys."""
    rig = make_rig()
    write_calibration(rig, tmp_path / "c.toml")
    document = tomllib.loads((tmp_path / "c.toml").read_text())
    assert document.pop("metadata") == {"adjusted": False, "error": 0.0, "unit": "m"}
    for camera, table in zip(rig, document.values(), strict=True):
        assert set(table) == {"name", "size", "matrix", "distortions", "rotation", "translation", "fisheye"}
        r = cv2.Rodrigues(np.array(table["rotation"]))[0]
        projected = cv2.projectPoints(
            POINTS, np.array(table["rotation"]), np.array(table["translation"]), np.array(table["matrix"]),
            np.array(table["distortions"]),
        )[0][:, 0]  # fmt: skip
        assert np.allclose(r, camera.camera_from_world[:3, :3], atol=1e-12)
        assert np.allclose(projected, camera.project(POINTS), atol=1e-8)


def family(rotation, scale=1.0, keys=None, nested=False, extra=""):
    """Two cameras in the family's form; keys: other spellings."""
    keys = keys or {}
    text = extra
    for i, camera in enumerate(make_rig()):
        r, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        values = {
            "name": camera.name,
            "size": camera.size,
            "matrix": camera.K,
            "distortions": camera.distortion,
            "rotation": r if rotation == "matrix" else cv2.Rodrigues(r)[0].ravel(),
            "translation": t * scale,
        }
        text += f"[cameras.{i}]\n" if nested else f"[cam_{i + 1}]\n"
        text += "".join(f"{keys.get(k, k)} = {toml_value(v)}\n" for k, v in values.items() if k not in keys or keys[k])
    return text


@pytest.mark.parametrize(
    ("text", "expected_notes"),
    [
        (family("vector"), 0),
        (family("matrix"), 0),
        (family("vector", 1000), 1),  # anipose, FreeMoCap: millimetres
        (family("matrix", nested=True, extra='CreationDate = 2023-03-31T09:56:43\n[charuco]\nrows = 5\n'), 0),
        (family("vector", keys={"matrix": "K", "distortions": "dist", "rotation": "rvec", "translation": "tvec"}), 0),
        (family("vector", 1000, extra='[metadata]\nunit = "mm"\n'), 0),
    ],
)  # fmt: skip
def test_family_members_give_the_same_rig(tmp_path, text, expected_notes):
    (tmp_path / "c.toml").write_text(text)
    rig, notes = read_any(tmp_path / "c.toml")
    assert_same(make_rig(), rig, 1e-8)
    assert len(notes) == expected_notes
    if expected_notes:
        assert "taken as millimetres" in notes[0] and "set the calibration unit" in notes[0]


def test_unit_can_be_forced(tmp_path):
    (tmp_path / "c.toml").write_text(family("vector", 100))
    assert_same(make_rig(), read_any(tmp_path / "c.toml", "cm")[0], 1e-8)
    with pytest.raises(CalibrationError, match="unit 'inch' is not known"):
        read_any(tmp_path / "c.toml", "inch")[0]


def test_cameras_without_pose_that_are_ignored(tmp_path):
    extra = "[cam_9]\nsize = [64, 48]\nmatrix = [[1,0,0],[0,1,0],[0,0,1]]\nignore = true\n"
    (tmp_path / "c.toml").write_text(extra + family("matrix"))
    rig, notes = read_any(tmp_path / "c.toml")
    assert rig.names == ("cam_1", "cam_2") and "cam_9" in notes[0]


def test_find_calibration(tmp_path):
    assert find_calibration(tmp_path) is None and find_calibration(tmp_path / "none") is None
    (tmp_path / "Config.toml").write_text("")
    (tmp_path / "Calib.qca.txt").write_text("")
    assert find_calibration(tmp_path) == tmp_path / "Calib.qca.txt"
    (tmp_path / "Calib_qualisys.toml").write_text("")
    assert find_calibration(tmp_path) == tmp_path / "Calib_qualisys.toml"
    (tmp_path / "calibration.toml").write_text("")
    assert find_calibration(tmp_path) == tmp_path / "calibration.toml"


# ---- files of other programs -------------------------------------------------------------------------------


def test_qualisys_agrees_with_pose2sims_conversion(shared_data):
    """Pose and K equal Pose2Sim's conversion of the same file; the distortion differs by its division by
    64."""
    folder = shared_data("pose2sim_balancing") / "calibration"
    qca, notes = read_any(folder / "Calib.qca.txt")
    toml = read_any(folder / "Calib_qualisys.toml")[0]
    assert qca.names == toml.names and notes == ()
    for a, b in zip(qca, toml, strict=True):
        assert a.size == b.size == (1088, 1920)
        assert np.allclose(a.K, b.K, atol=1e-9)
        assert np.allclose(a.camera_from_world, b.camera_from_world, atol=1e-9)
        assert np.allclose(a.distortion[:4] / 64, b.distortion, atol=1e-12) and a.distortion[4] == 0
    assert qca.positions[:, 2].min() > 1.5  # z up: the cameras stand above the floor
    assert all(c.project([[0.0, 0.0, 1.0]]).round().min() > 0 for c in qca)


def test_caliscope(shared_data):
    """Both generations of the file give one rig, whose projections meet the tracked corners."""
    folder = shared_data("caliscope_charuco") / "post_optimization"
    new, notes = read_any(folder / "camera_array.toml")
    old = read_any(folder / "config.toml")[0]
    assert new.names == old.names == ("cam_0", "cam_1", "cam_2", "cam_3") and notes == ()
    assert np.allclose(new.projections, old.projections, atol=1e-9)
    found = np.genfromtxt(folder / "calibration/extrinsic/CHARUCO/xy_CHARUCO.csv", delimiter=",", names=True)
    space = np.genfromtxt(folder / "calibration/extrinsic/CHARUCO/xyz_CHARUCO.csv", delimiter=",", names=True)
    corner = {(int(r["sync_index"]), int(r["keypoint_id"])): (r["x_coord"], r["y_coord"], r["z_coord"]) for r in space}
    errors = []
    for row in found:
        point = corner.get((int(row["sync_index"]), int(row["keypoint_id"])))
        if point is not None:
            uv = new[int(row["cam_id"])].project(point)
            errors.append(np.hypot(uv[0] - row["img_loc_x"], uv[1] - row["img_loc_y"]))
    assert len(errors) > 500 and np.median(errors) < 2.0


# ---- refused -----------------------------------------------------------------------------------------------

GOOD = family("vector")
FIRST = make_rig()[0]
VECTOR = toml_value(cv2.Rodrigues(FIRST.camera_from_world[:3, :3])[0].ravel())
K = toml_value(FIRST.K)
LENS = toml_value(FIRST.distortion)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("= nonsense", r"c\.toml is not valid TOML: .*; correct it"),
        ("a = " + "[" * 5000, r"c\.toml is not valid TOML: .*nested too deeply"),
        ("a = " + "9" * 5000, r"c\.toml is not valid TOML"),
        ("a = 1\n[b]\nc = 2\n", r"holds no cameras: each needs a table with size, matrix"),
        ("[metadata]\nmatrix = 1\n", r"holds no cameras"),
        (
            GOOD.replace(VECTOR, "[nan, 0.0, 0.0]"),
            r"camera cam_1: rotation contains NaN .* calibrate it again",
        ),
        (
            GOOD.replace(VECTOR, "[0.0, 0.0]"),
            r"camera cam_1: rotation must be numbers of shape .*3 x 3, got shape",
        ),
        (
            GOOD.replace(VECTOR, '["a", 0, 0]'),
            r"camera cam_1: rotation must be numbers of shape .* got something",
        ),
        (
            GOOD.replace(VECTOR, "[[1,0,0],[0,1,0],[0,0,-1]]"),
            r"camera cam_1: rotation is not a rotation matrix",
        ),
        (
            GOOD.replace(VECTOR, "[[2,0,0],[0,1,0],[0,0,1]]"),
            r"camera cam_1: rotation is not a rotation matrix",
        ),
        (GOOD.replace(VECTOR, "[[1,0,0],[0,1],[0,0,1]]"), r"camera cam_1: rotation must be numbers"),
        (GOOD.replace("rotation", "rotatoin", 1), r"camera cam_1: rotation is missing; add this entry"),
        (GOOD.replace("size = [64, 48]", "", 1), r"camera cam_1: size is missing; add this entry"),
        (
            GOOD.replace("[64, 48]", "[64, -48]", 1),
            r"camera cam_1: size must be .* whole pixels, got 64 x -48",
        ),
        (GOOD.replace("[64, 48]", "[64.5, 48]", 1), r"camera cam_1: size must be .* whole pixels"),
        (GOOD.replace(K, toml_value(FIRST.K.T)), r"camera cam_1: matrix must be .* transposed"),
        (GOOD.replace(K, "[[0,0,0],[0,1,0],[0,0,1]]"), r"camera cam_1: focal lengths must be positive"),
        (GOOD.replace(K, "[[1e300,0,0],[0,1,0],[0,0,1]]"), r"camera cam_1: focal lengths must be positive"),
        (
            GOOD.replace(LENS, "[1, 2, 3]"),
            r"camera cam_1: 3 distortion coefficients; OpenCV's model has 4, 5, 8",
        ),
        (GOOD.replace(LENS, "[inf, 2, 3, 4]"), r"camera cam_1: distortions contains NaN or infinity"),
        (
            GOOD.replace("translation = [", "translation = [1e30, 1, 1] # ", 1),
            r"cam_1: translation .* farther",
        ),
        (GOOD.replace('"cam_2"', '"cam_1"'), r"c\.toml: Camera names must differ"),
        (GOOD + "fisheye = 1\n", r"camera cam_2: fisheye must be true or false, got 1"),
    ],
)
def test_bad_toml(tmp_path, text, message):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_any(tmp_path / "c.toml")[0]


def test_bad_files(tmp_path):
    def refuses(name, message):
        with pytest.raises(CalibrationError, match=message):
            read_any(tmp_path / name)[0]

    refuses("none.toml", r"calibration file .*none\.toml does not exist; check the path, or run hypose calibrate")
    refuses(".", r"holds no calibration; give a file or folder")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00\x81" * 100)
    refuses("binary.toml", r"is not a text file \(UTF-8\), as a calibration is")
    with (tmp_path / "huge.toml").open("wb") as stream:
        stream.truncate(50_000_000)
    refuses("huge.toml", r"has 48 MiB, at most 5 MiB are read")
    (tmp_path / "c.doc").write_text("x")
    refuses("c.doc", r"calibrations are read from \.toml, .*\.qca\.txt, .*; name the file by one of these endings")
    (tmp_path / "empty.toml").write_text("")
    refuses("empty.toml", r"holds no cameras")


QCA = """<calibration><cameras><camera model="{model}" serial="{serial}" viewrotation="0">
<fov_video left="0" top="0" right="63" bottom="47"/>
<transform x="100" y="-3000" z="{z}" r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="{r32}" r33="0"/>
<intrinsic focalLengthU="4000" focalLengthV="{fv}" centerPointU="2000" centerPointV="1500" radialDistortion1="-0.1"
 radialDistortion2="0.2" tangentalDistortion1="0.001" tangentalDistortion2="0.002"/>
</camera></cameras></calibration>"""


def qca(tmp_path, **changes):
    text = QCA.format(**{"model": "Miqus Video", "serial": "7", "z": "1200", "fv": "4032", "r32": "-1"} | changes)
    (tmp_path / "a.qca.txt").write_text(text)
    return tmp_path / "a.qca.txt"


def test_qualisys_units_and_axes(tmp_path):
    camera = read_any(qca(tmp_path))[0][0]
    assert camera.name == "7" and camera.size == (64, 48)
    assert np.allclose(camera.K, [[62.5, 0, 31.25], [0, 63, 23.4375], [0, 0, 1]])
    assert np.allclose(camera.distortion, [-0.1, 0.2, 0.001, 0.002, 0])
    assert np.allclose(camera.position, [0.1, -3.0, 1.2])
    # stored by columns; the Qualisys camera looks along its -z and its y is up
    world_from_qtm = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert np.allclose(camera.camera_from_world[:3, :3], np.diag([1, -1, -1]) @ world_from_qtm.T)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fv": "abc"}, r"camera 7: <intrinsic focalLengthV> is 'abc', a number is needed; export"),
        ({"fv": "nan"}, r"camera 7: <intrinsic focalLengthV> is 'nan'"),
        ({"fv": "-5"}, r"camera 7: focal lengths must be positive"),
        ({"r32": "0"}, r"camera 7: rotation is not a rotation matrix"),
        ({"z": ""}, r"camera 7: <transform z> is ''"),
        ({"serial": "7<"}, r"is not valid XML: .*; export the calibration again"),
    ],
)
def test_bad_qualisys(tmp_path, changes, message):
    with pytest.raises(CalibrationError, match=message):
        read_any(qca(tmp_path, **changes))[0]
