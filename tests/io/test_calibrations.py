"""Calibration files: what is written comes back, what other programs write is understood, the rest is
refused."""

import json
import pickle
import struct
import tomllib

import cv2
import numpy as np
import pytest

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import quaternion_from_matrix, se3_inverse
from hypose.io.calibrations.calibration_formats import find_calibration, read_any, read_plain_pickle, write_calibration
from hypose.io.files import toml_value
from hypose.synthetic.scenes import camera_rig
from scripts.fuzz_targets import opencap_pickle, write_easymocap
from tests.io.recordings import make_camera, make_rig

RIG = camera_rig("humaneva-4", distorted=True)
POINTS = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 3))


def assert_same_cameras(found, wanted, tolerance=1e-9):
    for a, b in zip(found, wanted, strict=True):
        assert a.size == b.size and a.fisheye == b.fisheye
        np.testing.assert_allclose(a.K, b.K, rtol=tolerance, atol=tolerance * 1000)
        np.testing.assert_allclose(a.distortion[:5], b.distortion[:5], atol=tolerance)
        np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=tolerance)


def test_names_and_lenses_come_back(tmp_path):
    rig = CameraRig((make_camera("cam 1.a"), make_camera('ü"\\#', 2.0, fisheye=True), make_camera("3", -1.0)))
    write_calibration(rig, tmp_path / "calibration.toml")
    back, _ = read_any(tmp_path / "calibration.toml")
    assert_same_cameras(back, rig)
    assert back.names == rig.names


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
    assert_same_cameras(rig, make_rig(), 1e-8)
    assert len(notes) == expected_notes and rig.names == make_rig().names
    if expected_notes:
        assert "taken as millimetres" in notes[0] and "set the calibration unit" in notes[0]


def test_unit_can_be_forced(tmp_path):
    (tmp_path / "c.toml").write_text(family("vector", 100))
    assert_same_cameras(read_any(tmp_path / "c.toml", "cm")[0], make_rig(), 1e-8)


def test_find_calibration(tmp_path):
    (tmp_path / "Config.toml").write_text("")
    assert find_calibration(tmp_path) is None and find_calibration(tmp_path / "none") is None
    for name in ("Calib.qca.txt", "Calib_qualisys.toml", "calibration.toml"):
        (tmp_path / name).write_text("")
        assert find_calibration(tmp_path) == tmp_path / name


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
    seen = [(r, corner.get((int(r["sync_index"]), int(r["keypoint_id"])))) for r in found]
    errors = [
        np.linalg.norm(new[int(r["cam_id"])].project(point) - [r["img_loc_x"], r["img_loc_y"]])
        for r, point in seen
        if point is not None
    ]
    assert len(errors) > 500 and np.median(errors) < 2.0


# ---- refused -----------------------------------------------------------------------------------------------

GOOD = family("vector")
FIRST = make_rig()[0]
VECTOR = toml_value(cv2.Rodrigues(FIRST.camera_from_world[:3, :3])[0].ravel())
K = toml_value(FIRST.K)
LENS = toml_value(FIRST.distortion)


BAD_TOML = [
    ("= nonsense", r"c\.toml is not valid TOML: .*; correct it"),
    ("a = " + "[" * 5000, r"c\.toml is not valid TOML: .*nested too deeply"),
    ("a = " + "9" * 5000, r"c\.toml is not valid TOML"),
    ("a = 1\n[b]\nc = 2\n", r"holds no cameras: each needs an intrinsic matrix"),
    ("[metadata]\nmatrix = 1\n", r"holds no cameras"),
    (
        GOOD.replace(VECTOR, "[nan, 0.0, 0.0]"),
        r"camera cam_1: rotation contains NaN .* calibrate again",
    ),
    (
        GOOD.replace(VECTOR, "[0.0, 0.0]"),
        r"camera cam_1: rotation must be numbers of shape .*3 x 3, got shape",
    ),
    (
        GOOD.replace(VECTOR, '["a", 0, 0]'),
        r"camera cam_1: rotation must be numbers of shape .* got",
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
    (GOOD + "fisheye = 1\n", r"camera cam_2: fisheye must be true or false, got 1"),
]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        *(("c.toml", *bad) for bad in BAD_TOML),
        ("a.yml", "nonsense: [", "a.yml is no calibration: it is no YAML"),
        ("a.yml", "a: &b [1]\nc: [*b, *b]", "it "),
        ("a.yml", "a: " + "[" * 100_000, "it "),
        ("a.yml", "a: !!python/object:os.system x", "it "),
        ("a.xml", "<!DOCTYPE a><opencv_storage/>", "it "),
        ("a.yml", "%YAML:1.0\n---\nx: 3\n", "holds no cameras"),
        ("a.xcp", "<Cameras><Camera DEVICEID='1' TYPE='Video'/></Cameras>", "holds no cameras"),
        (
            "a.xcp",
            "<Cameras><Camera DEVICEID='1' SENSOR_SIZE='4 4'><KeyFrames><KeyFrame FOCAL_LENGTH='x'/></KeyFrames>"
            "</Camera></Cameras>",
            r"<KeyFrame>: FOCAL_LENGTH must be numbers of shape 1, got \['x'\]",
        ),
        ("a.xcp", "<a/>", "is not a calibration of Vicon"),
        ("a.doc", "{}", "is not a calibration"),
        ("a.json", "{", r"is not JSON \(.*\); give the path of a calibration"),
        ("a.json", "{}", r"is not a calibration of CMU Panoptic, XRMoCap"),
        ("a.json", '{"a": {"K": 5}}', r"camera a: K must be numbers of shape 3 x 3"),
        ("a.json", '{"a": {"K": [[1,0,1],[0,1,1],[0,0,1]], "t": [0,0,1]}}', r"camera a: rotation is missing"),
        ("a.json", '{"a": {"P": [[1,0,0,0],[1,0,0,0],[0,0,1,1]]}}', r"P is no projection matrix"),
        ("a.json", '{"a": {"P": [[1,1,0,0],[0,1,0,0],[0,0,1,1]]}}', r"P has oblique pixels"),
        ("a.mcal", "<a/>", r"is not a calibration of OptiTrack Motive"),
        ("a.mcal", "<a", r"it is not valid XML"),
        ("a.mcal", '<!DOCTYPE a [<!ENTITY b "c">]><a/>', r"it has a DOCTYPE"),
        (
            "a.mcal",
            '<a><Camera Serial="c"><IntrinsicStandardCameraModel/><Extrinsic/></Camera></a>',
            r"camera c, <Attributes>: ImagerPixelWidth is missing",
        ),
    ],
)
def test_bad_files_are_refused_in_a_sentence(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_any(tmp_path / name)
    assert "\n" not in str(caught.value)


QCA = """<calibration><cameras><camera model="Miqus Video" serial="7" viewrotation="0">
<fov_video left="0" top="0" right="63" bottom="47"/>
<transform x="100" y="-3000" z="1200" r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0"/>
<intrinsic focalLengthU="4000" focalLengthV="4032" centerPointU="2000" centerPointV="1500" radialDistortion1="-0.1"
 radialDistortion2="0.2" tangentalDistortion1="0.001" tangentalDistortion2="0.002"/>
</camera></cameras></calibration>"""


def test_qualisys_units_and_axes(tmp_path):
    (tmp_path / "a.qca.txt").write_text(QCA)
    camera = read_any(tmp_path / "a.qca.txt")[0][0]
    assert camera.name == "7" and camera.size == (64, 48)
    assert np.allclose(camera.K, [[62.5, 0, 31.25], [0, 63, 23.4375], [0, 0, 1]])
    assert np.allclose(camera.distortion, [-0.1, 0.2, 0.001, 0.002, 0])
    assert np.allclose(camera.position, [0.1, -3.0, 1.2])
    # stored by columns; the Qualisys camera looks along its -z and its y is up
    world_from_qtm = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert np.allclose(camera.camera_from_world[:3, :3], np.diag([1, -1, -1]) @ world_from_qtm.T)


# ---- test calibration formats --------------------------------------------------------------------------------------
# Calibrations of other programs: written and read back, read as those programs write them, and bad files refused.


def test_easymocap_as_opencv_writes_it(tmp_path):
    write_easymocap(RIG, tmp_path)
    back, notes = read_any(tmp_path / "extri.yml")
    assert "twice the principal point" in " ".join(notes)
    assert back[0].size == (639, 479)
    for a, b in zip(back, RIG, strict=True):
        np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=1e-9)


def test_vicon_as_vicon_writes_it(tmp_path):
    path = tmp_path / "a.xcp"
    # a camera at (0, -3, 1) m that looks along +y with z up: x right, y down, z forward
    path.write_text(
        """<Cameras><Camera DEVICEID="2120" TYPE="Video" SENSOR_SIZE="1920 1080" PIXEL_ASPECT_RATIO="1">
        <KeyFrames><KeyFrame FOCAL_LENGTH="1400" PRINCIPAL_POINT="960 540" WORLD_ERROR="0.3"
        ORIENTATION="0.70710678118 0 0 0.70710678118" POSITION="0 -3000 1000"
        VICON_RADIAL2="ViconRadial2 960 540 6e-9 0 0"/></KeyFrames></Camera>
        <Camera DEVICEID="77" TYPE="Optical" SENSOR_SIZE="1 1"/></Cameras>"""
    )
    rig, notes = read_any(path)
    camera = rig[0]
    np.testing.assert_allclose(camera.position, [0, -3, 1], atol=1e-8)
    np.testing.assert_allclose(camera.pinhole().project([0, 5, 1.0]), [960, 540], atol=1e-6)
    assert camera.project([0, 0, 2.0])[1] < 540  # what is higher appears higher
    assert "given in pixels" in " ".join(notes)
    # Vicon straightens a distorted radius of 500 px by 1 + 6e-9 * 500^2
    straight = camera.undistort_points([[960 + 500.0, 540]])[0, 0] - 960
    assert straight == pytest.approx(500 * (1 + 6e-9 * 500**2), abs=0.05)


def test_opencap_world_is_turned_upright(tmp_path):
    for c in RIG:
        (tmp_path / f"{c.name}.pickle").write_bytes(opencap_pickle(c))
    assert_same_cameras(read_any(tmp_path)[0], RIG)


@pytest.mark.parametrize("protocol", range(6))
def test_pickles_of_arrays_are_read(rng, protocol):
    value = {
        "a": rng.normal(size=(3, 3)),
        "b": np.arange(6).reshape(2, 3),
        "f": np.asfortranarray(rng.normal(size=(2, 3))),
        "big": np.arange(3, dtype=">f4"),
        "n": [1, 2.5, None, True, ("x", -7)],
        "s": np.float64(3.5),
    }
    back = read_plain_pickle(pickle.dumps(value, protocol))
    assert back.keys() == value.keys()
    for key, v in value.items():
        if isinstance(v, np.ndarray):
            np.testing.assert_array_equal(back[key], v)
        else:
            assert back[key] == v


class _Evil:
    def __reduce__(self):
        return (print, ("this must never appear",))


@pytest.mark.parametrize(
    "content",
    [
        pickle.dumps(_Evil()),
        pickle.dumps({"a": _Evil()}, 0),
        pickle.dumps(np.array([_Evil()], dtype=object)),
        b"cos\nsystem\n(S'echo pwned'\ntR.",
        b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x04echo\x85R.",
        b"(i__builtin__\neval\n.",
        b"garbage",
        b"",
        b"}" * 30_000,
        b"h\x00.",
        b"\x80\x02}(X\x01\x00\x00\x00au.",
        pickle.dumps({"a": np.zeros(3)})[:-20],
        b"\x80\x03X" + struct.pack("<I", 2**31) + b"a.",
    ],
)
def test_anything_else_in_a_pickle_is_refused(content, capsys):
    with pytest.raises(ValueError):
        read_plain_pickle(content)
    assert capsys.readouterr().out == ""


def test_toml_alone_is_written(tmp_path):
    with pytest.raises(InputError, match=r"name the calibration \.toml"):
        write_calibration(RIG, tmp_path / "a.yml")


# ---- test calibration relatives ------------------------------------------------------------------------------------
# Calibrations of CMU Panoptic, OptiTrack, projection matrices, OpenCV's folders: read as they write them.


def panoptic(c, **more):
    pose = c.camera_from_world
    return {
        "name": c.name,
        "type": "hd",
        "resolution": list(c.size),
        "K": c.K.tolist(),
        "distCoef": c.distortion.tolist(),
        "R": pose[:3, :3].tolist(),
        "t": (100 * pose[:3, 3:]).tolist(),
        **more,
    }


def test_panoptic_is_in_centimetres(tmp_path):
    path = tmp_path / "calibration_160422.json"
    cameras = [panoptic(c, panel=0, node=i) for i, c in enumerate(RIG)]
    path.write_text(json.dumps({"calibDataSource": "160422_calib", "cameras": cameras}))
    found, notes = read_any(path)
    assert found.names == RIG.names and any("centimetres, as CMU Panoptic's" in n for n in notes)
    assert_same_cameras(found, RIG)
    again, _ = read_any(path, "m")
    np.testing.assert_allclose(again[0].position, 100 * found[0].position, rtol=1e-6)


@pytest.mark.parametrize("scale", [1.0, -0.003])
def test_projection_matrices(tmp_path, scale):
    pinhole = [Camera(c.name, c.K, np.zeros(5), c.camera_from_world, c.size) for c in RIG]
    matrices = {c.name: (scale * c.projection).tolist() for c in pinhole}
    (tmp_path / "a.json").write_text(json.dumps({n: {"P": p} for n, p in matrices.items()}))
    found, notes = read_any(tmp_path / "a.json")
    assert any("does not say how large" in n and "twice the principal point" in n for n in notes)
    assert found.names == RIG.names
    for a, b in zip(found, pinhole, strict=True):
        np.testing.assert_allclose(a.K, b.K, rtol=1e-6, atol=1e-4)
        np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=1e-6)


def test_optitrack(tmp_path):
    """A camera that looks along -z with y up, in a world with y up: seen pixels are those of ours."""
    up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # ours from Motive's
    parts = []
    for c in RIG:
        axes = np.diag([1.0, -1, -1]) @ c.camera_from_world[:3, :3] @ up
        x, y, z = up.T @ c.position
        numbers = " ".join(f'OrientMatrix{i}="{v!r}"' for i, v in enumerate(axes.ravel().tolist()))
        k1, k2, p1, p2, k3 = c.distortion.tolist()[:5]
        parts.append(
            f'<Camera Serial="{c.name}"><Properties CameraID="6"/>'
            f'<Attributes Revision="50" ImagerPixelWidth="{c.size[0]}" ImagerPixelHeight="{c.size[1]}"/>'
            f'<Intrinsic LensCenterX="1" k1="0.1"/>'
            f'<IntrinsicStandardCameraModel LensCenterX="{c.K[0, 2]!r}" LensCenterY="{c.K[1, 2]!r}" '
            f'HorizontalFocalLength="{c.K[0, 0]!r}" VerticalFocalLength="{c.K[1, 1]!r}" k1="{k1!r}" k2="{k2!r}" '
            f'k3="{k3!r}" TangentialX="{p1!r}" TangentialY="{p2!r}"/>'
            f'<Extrinsic X="{x!r}" Y="{y!r}" Z="{z!r}" {numbers}/></Camera>'
        )
    parts.append('<Camera Serial="old"><Attributes/></Camera>')
    text = f'<?xml version="1.0" encoding="UTF-16LE"?>\n<calibrationProfile version="1"><Calibration><Cameras Count="4">{"".join(parts)}</Cameras></Calibration></calibrationProfile>'  # noqa: E501
    text = text.replace("np.float64(", "").replace(')"', '"')
    (tmp_path / "a.mcal").write_bytes(text.encode("utf-16"))
    found, notes = read_any(tmp_path / "a.mcal")
    assert_same_cameras(found, RIG)
    assert "old has no standard camera model or place and is left out" in " ".join(notes)
    (tmp_path / "b.mcal").write_bytes(text.encode("utf-16-le"))
    assert_same_cameras(read_any(tmp_path / "b.mcal")[0], RIG)


@pytest.mark.parametrize("ending", ["xml", "yml"])
def test_a_folder_of_opencv_lenses(tmp_path, ending):
    for c in RIG:
        storage = cv2.FileStorage(str(tmp_path / f"{c.name}.{ending}"), cv2.FILE_STORAGE_WRITE)
        values = {"image_width": 640, "image_height": 480, "camera_matrix": c.K, "tvec": c.camera_from_world[:3, 3]}
        values |= {"distortion_coefficients": c.distortion, "rvec": cv2.Rodrigues(c.camera_from_world[:3, :3])[0]}
        for name, value in values.items():
            storage.write(name, value)
        storage.release()
    found, _ = read_any(tmp_path)
    assert found.names == RIG.names
    assert_same_cameras(found, RIG)


# ---- words about lens, direction and unit ---------------------------------------------------------------------------


def written(tmp_path, document):
    (tmp_path / "a.json").write_text(json.dumps(document))
    return tmp_path / "a.json"


def table(c, **more):
    pose = c.camera_from_world
    plain = {"K": c.K, "R": pose[:3, :3], "t": pose[:3, 3], "dist": c.distortion, "size": np.array(c.size)}
    return {k: v.tolist() for k, v in plain.items()} | more


def outward(c):
    return se3_inverse(c.camera_from_world)


def wxyz(c):
    return quaternion_from_matrix(c.camera_from_world[:3, :3]).tolist()


@pytest.mark.parametrize(
    "spelt",
    [
        lambda c: {"K": [*c.K[[0, 1], [0, 1]].tolist(), *c.K[:2, 2].tolist()]},
        lambda c: {"K": np.pad(c.K, (0, 1)).tolist()},
        lambda c: {"world2cam": False, "R": outward(c)[:3, :3].tolist(), "t": outward(c)[:3, 3].tolist()},
        lambda c: {"R": None, "t": None, "camera_to_world": outward(c).tolist()},
        lambda c: {"quaternion_xyzw": np.roll(wxyz(c), -1).tolist()},
        lambda c: {"qvec": wxyz(c)},
        lambda c: {"quaternion": {letter: value for letter, value in zip("wxyz", wxyz(c), strict=True)}},
        lambda c: {
            "dist": None,
            **{k: float(v) for k, v in zip(("k1", "k2", "p1", "p2", "k3"), c.distortion, strict=True)},
        },
        lambda c: {"distortion_model": "plumb_bob", "convention": "opencv"},
    ],
)
def test_other_spellings_of_the_same_cameras(tmp_path, spelt):
    found, notes = read_any(written(tmp_path, {c.name: table(c, **spelt(c)) for c in RIG}))
    assert found.names == RIG.names and notes == ()
    assert_same_cameras(found, RIG, 1e-8)


@pytest.mark.parametrize("more", [{"fisheye": True}, {"distortion_model": "equidistant"}, {"fisheye_model": 1}])
def test_fisheye_lenses_are_read_as_such(tmp_path, more):
    found, _ = read_any(written(tmp_path, {c.name: table(c, dist=[0.1, 0, 0, 0], **more) for c in RIG}))
    assert all(c.fisheye for c in found)


@pytest.mark.parametrize(("unit", "factor"), [("centimeters", 100), ("cm", 100), ("Millimetre", 1000), ("meters", 1)])
def test_stated_units_are_read(tmp_path, unit, factor):
    cameras = {c.name: table(c, t=(factor * c.camera_from_world[:3, 3]).tolist()) for c in RIG}
    assert_same_cameras(read_any(written(tmp_path, {"units": unit, "cameras": cameras}))[0], RIG)


@pytest.mark.parametrize(
    "more",
    [
        {"distortion_model": "omni"},
        {"camera_model": "ds"},
        {"fisheye": True, "distortion_model": "radtan"},
        {"convention": "opengl"},
        {"quaternion_wxyz": [1, 1, 1, 1]},
        {"quaternion": [1.0, 0, 0, 0]},  # in no stated order
    ],
)
def test_models_and_directions_that_are_not_known_are_refused(tmp_path, more):
    with pytest.raises(CalibrationError, match=f"camera {RIG.names[0]}"):
        read_any(written(tmp_path, {c.name: table(c, **more) for c in RIG}))


def test_an_unknown_unit_is_refused_and_other_keys_are_named(tmp_path):
    with pytest.raises(CalibrationError, match="unit 'inches' is not known"):
        read_any(written(tmp_path, {"units": "inches", "cameras": {c.name: table(c) for c in RIG}}))
    _, notes = read_any(written(tmp_path, {c.name: table(c, skewness=0.1) for c in RIG}))
    assert len(notes) == 1 and "skewness" in notes[0]
    cameras = {c.name: table(c, dist=[0.1, 0, 0, 0]) for c in RIG}
    found, notes = read_any(written(tmp_path, {"fisheye": True, "world_scale": 2.0, "cameras": cameras}))
    assert all(c.fisheye for c in found) and len(notes) == 1 and "world_scale" in notes[0]


def test_samples_of_other_programs(shared_data):
    """Each is the same four cameras in another program's layout; two have the world of their first camera."""
    folder = shared_data("outside_cases") / "calibrations"
    truth = read_any(folder / "camera_array.toml")[0]
    assert len(truth) == 4  # the fifth is not placed
    for name in ("xrmocap_False.json", "units_centimeters.json"):
        assert_same_cameras(read_any(folder / name)[0], truth, 1e-8)
    for name in ("camchain.yaml", "calibrated_cameras_data.yml"):
        found, notes = read_any(folder / name)
        assert any("first camera" in n for n in notes)
        for a, b in zip(found, truth, strict=True):
            relative = b.camera_from_world @ se3_inverse(truth[0].camera_from_world)
            np.testing.assert_allclose(a.camera_from_world, relative, atol=1e-9)
    for name in ("fish_fisheye.json", "ocv_fish"):
        assert all(c.fisheye for c in read_any(folder / name)[0])
    lenses, notes = read_any(folder / "ros_plumb_bob")
    assert lenses.names == ("cam1", "cam2", "cam3", "cam4") and any("lenses alone" in n for n in notes)


def test_two_cameras_in_one_place_are_named(tmp_path):
    tables = {c.name: table(c) for c in RIG}
    tables[RIG.names[2]] |= {k: tables[RIG.names[0]][k] for k in ("R", "t")}
    _, notes = read_any(written(tmp_path, tables))
    assert len(notes) == 1 and f"{RIG.names[0]} and {RIG.names[2]} stand in one place" in notes[0]
