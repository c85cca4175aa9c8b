"""Calibrations of other programs: written and read back, read as those programs write them, and bad files refused."""

import pickle  # noqa: S403 - the oracle of our own writer
import struct

import cv2
import numpy as np
import pytest

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError, InputError
from hypose.geometry import se3, so3_exp
from hypose.io.calibrations.calibration_formats import read_any, write_any
from hypose.io.calibrations.calibration_systems import read_plain_pickle


def make_rig(rng):
    cameras = []
    for i in range(3):
        k = np.array([[900.0 + i, 0, 630.5], [0, 897.0, 365.25 + i], [0, 0, 1]])
        lens = np.array([-0.21, 0.07, 1e-3, -5e-4, 0.011])
        pose = se3(so3_exp(rng.normal(0, 1, 3)), rng.normal(0, 2, 3))
        cameras.append(Camera(f"cam{i + 1}", k, lens, pose, (1280, 720)))
    return CameraRig(tuple(cameras))


def assert_same(a, b, tolerance=1e-9):
    assert a.names == b.names
    for x, y in zip(a, b, strict=True):
        assert x.size == y.size
        np.testing.assert_allclose(x.K, y.K, atol=tolerance * 1000)
        np.testing.assert_allclose(x.distortion, y.distortion, atol=tolerance)
        np.testing.assert_allclose(x.camera_from_world, y.camera_from_world, atol=tolerance)


@pytest.mark.parametrize(
    "name",
    ["a.toml", "camera_array.toml", "anipose.toml", "b/intri.yml", "c/cam.pickle"],
)
def test_written_and_read_back(tmp_path, rng, name):
    rig = make_rig(rng)
    written = write_any(rig, tmp_path / name)
    assert all(p.is_file() for p in written)
    source = tmp_path / "c" if name.endswith("pickle") else written[0]
    back, _ = read_any(source)
    if name == "camera_array.toml":
        assert back.names == rig.names
    assert_same(back, rig)


def test_easymocap_as_opencv_writes_it(tmp_path, rng):
    rig = make_rig(rng)
    for file, entries in (("intri.yml", ("K", "dist")), ("extri.yml", ("R", "T"))):
        storage = cv2.FileStorage(str(tmp_path / file), cv2.FILE_STORAGE_WRITE)
        storage.write("names", list(rig.names))
        for c in rig:
            values = {
                "K": c.K,
                "dist": c.distortion[None],
                "R": cv2.Rodrigues(c.camera_from_world[:3, :3])[0],
                "T": c.camera_from_world[:3, 3:],
            }
            for entry in entries:
                storage.write(f"{entry}_{c.name}", values[entry])
        storage.release()
    back, notes = read_any(tmp_path / "extri.yml")
    assert "twice the principal point" in " ".join(notes)
    assert back[0].size == (1261, 730) or back[0].size == (1261, 731)
    for a, b in zip(back, rig, strict=True):
        np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=1e-9)


def test_real_single_camera_of_opencv(shared_data):
    rig = read_any(shared_data("uu4cam/cam1") / "config.xml")[0]
    assert rig.names == ("cam1",)
    assert rig[0].K[0, 0] == pytest.approx(486.52, abs=0.01)
    assert np.linalg.norm(rig[0].position) < 10  # millimetres were recognised


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


def test_opencap_world_is_turned_upright(tmp_path, rng):
    rig = make_rig(rng)
    write_any(rig, tmp_path / "cam.pickle")
    raw = pickle.loads((tmp_path / "cam1.pickle").read_bytes())  # noqa: S301 - written by ourselves
    assert raw["imageSize"].ravel().tolist() == [720, 1280]
    # the board stands upright, its y axis points down: the world's up is -y
    up = raw["rotation"] @ [0, -1.0, 0]
    np.testing.assert_allclose(up, rig[0].camera_from_world[:3, 2], atol=1e-12)
    np.testing.assert_allclose(raw["translation"].ravel() / 1000, rig[0].camera_from_world[:3, 3])


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


def test_bad_pickles_name_the_file(tmp_path):
    path = tmp_path / "cam.pickle"
    path.write_bytes(pickle.dumps({"intrinsicMat": _Evil()}))
    with pytest.raises(CalibrationError, match=r"cam\.pickle is not an OpenCap camera file: it asks for"):
        read_any(path)
    path.write_bytes(pickle.dumps({"intrinsicMat": np.eye(2), "imageSize": np.ones(2)}))
    with pytest.raises(CalibrationError, match="intrinsicMat must be numbers of shape 3 x 3"):
        read_any(path)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.yml", "nonsense: [", "is not a file of OpenCV's storage"),
        ("a.yml", "%YAML:1.0\n---\nx: 3\n", "holds no camera matrix"),
        ("a.xcp", "<Cameras><Camera DEVICEID='1' TYPE='Video'/></Cameras>", "holds no cameras"),
        (
            "a.xcp",
            "<Cameras><Camera DEVICEID='1' SENSOR_SIZE='4 4'><KeyFrames><KeyFrame FOCAL_LENGTH='x'/></KeyFrames>"
            "</Camera></Cameras>",
            "FOCAL_LENGTH> is 'x', a number is needed",
        ),
        ("a.xcp", "<a/>", "holds no cameras"),
        ("a.json", "{}", "holds no cameras: each needs K, R and t"),
        ("a.doc", "{}", "calibrations are read from"),
    ],
)
def test_bad_files_are_refused_in_a_sentence(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message):
        read_any(tmp_path / name)


def test_incomplete_easymocap(tmp_path, rng):
    write_any(make_rig(rng), tmp_path / "intri.yml")
    text = (tmp_path / "extri.yml").read_text()
    (tmp_path / "extri.yml").write_text(text.replace("T_cam2", "Q_cam2"))
    with pytest.raises(CalibrationError, match="camera cam2: T_cam2 is missing"):
        read_any(tmp_path)


def test_what_a_format_cannot_hold_is_not_written(tmp_path, rng):
    rig = make_rig(rng)
    fisheye = CameraRig((Camera("f", rig[0].K, np.zeros(4), np.eye(4), (640, 480), True),))
    for name in ("a.yml", "a.pickle", "camera_array.toml"):
        with pytest.raises(CalibrationError, match="write .toml|cannot hold"):
            write_any(fisheye, tmp_path / name)
    with pytest.raises(InputError, match=r"name the calibration \.toml"):
        write_any(rig, tmp_path / "a.xcp")
