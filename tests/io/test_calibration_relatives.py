"""Calibrations of CMU Panoptic, BioCV, OptiTrack, projection matrices, OpenCV's folders: read as they write them."""

import json

import cv2
import numpy as np
import pytest

from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import CalibrationError
from hypose.geometry import se3, so3_exp
from hypose.io.calibrations.calibration_formats import read_any
from hypose.synthetic.rigs import rig

RIG = rig("humaneva-4", distorted=True)


def assert_same(found, wanted, tolerance=1e-6):
    for a, b in zip(found, wanted, strict=True):
        assert a.size == b.size
        np.testing.assert_allclose(a.K, b.K, rtol=tolerance, atol=tolerance * 1000)
        np.testing.assert_allclose(a.distortion[:5], b.distortion[:5], atol=tolerance)
        np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=tolerance)


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
    assert_same(found, RIG)
    again, _ = read_any(path, "m")
    np.testing.assert_allclose(again[0].position, 100 * found[0].position, rtol=1e-6)


@pytest.mark.parametrize("scale", [1.0, -0.003])
def test_projection_matrices(tmp_path, scale):
    pinhole = [Camera(c.name, c.K, np.zeros(5), c.camera_from_world, c.size) for c in RIG]
    matrices = {c.name: (scale * c.projection).tolist() for c in pinhole}
    (tmp_path / "a.json").write_text(json.dumps({n: {"P": p} for n, p in matrices.items()}))
    lines = [" ".join(map(repr, row)) for p in matrices.values() for row in p]
    (tmp_path / "b.txt").write_text("\n".join(lines) + "\n")
    named = [f"{n}\n" + ",".join(repr(v) for row in p for v in row) for n, p in matrices.items()]
    (tmp_path / "c.txt").write_text("\n".join(named) + "\n")
    for name in ("a.json", "b.txt", "c.txt"):
        found, notes = read_any(tmp_path / name)
        assert any("does not say how large" in n and "twice the principal point" in n for n in notes)
        for a, b in zip(found, pinhole, strict=True):
            np.testing.assert_allclose(a.K, b.K, rtol=1e-6, atol=1e-4)
            np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, atol=1e-6)
        assert found.names == (tuple(f"cam_{i}" for i in range(4)) if name == "b.txt" else RIG.names)


def test_biocv(tmp_path):
    for i, c in enumerate(RIG):
        pose = c.camera_from_world.copy()
        pose[:3, 3] *= 1000
        rows = [str(c.size[0]), str(c.size[1]), *(" ".join(map(repr, r)) for r in c.K.tolist()), ""]
        rows += [*(" ".join(map(repr, r)) for r in pose.tolist()), "", " ".join(map(repr, c.distortion.tolist())), ""]
        (tmp_path / f"0{i}.mp4.calib").write_text("\n".join(rows))
        (tmp_path / "bare").mkdir(exist_ok=True)
        (tmp_path / "bare" / f"0{i}").write_text("\n".join(rows))
    for source in (tmp_path, tmp_path / "bare"):
        found, _ = read_any(source)
        assert len(found) == 4
        assert_same(found, RIG)
    assert_same(read_any(tmp_path / "bare" / "02")[0], [RIG[2]])


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
    assert_same(found, RIG)
    assert "old has no standard camera model or place and is left out" in " ".join(notes)
    (tmp_path / "b.mcal").write_bytes(text.encode("utf-16-le"))
    assert_same(read_any(tmp_path / "b.mcal")[0], RIG)


def test_a_folder_of_opencv_lenses(tmp_path, rng):
    rigs = []
    for i in range(4):
        k = np.array([[900.0 + i, 0, 630.5], [0, 897.0, 365.25], [0, 0, 1]])
        pose = se3(so3_exp(rng.normal(0, 1, 3)), rng.normal(0, 2, 3))
        rigs.append(Camera(f"cam{i + 1}", k, np.array([-0.2, 0.07, 1e-3, 0, 0]), pose, (1280, 720)))
        storage = cv2.FileStorage(str(tmp_path / f"cam{i + 1}.xml"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 1280)
        storage.write("image_height", 720)
        storage.write("camera_matrix", k)
        storage.write("distortion_coefficients", rigs[-1].distortion)
        storage.write("rvec", cv2.Rodrigues(pose[:3, :3])[0])
        storage.write("tvec", pose[:3, 3])
        storage.release()
    found, _ = read_any(tmp_path)
    assert found.names == ("cam1", "cam2", "cam3", "cam4")
    assert_same(found, CameraRig(tuple(rigs)))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", "{", r"is not JSON \(.*\); give the path of a calibration"),
        ("a.json", "{}", r"holds no cameras: each needs K, R and t"),
        ("a.json", '{"a": {"K": 5}}', r"camera a: K must be numbers of shape 3 x 3"),
        ("a.json", '{"a": {"K": [[1,0,1],[0,1,1],[0,0,1]]}}', r"camera a: R is missing"),
        ("a.json", '{"a": {"P": [[1,0,0,0],[1,0,0,0],[0,0,1,1]]}}', r"P is no projection matrix"),
        ("a.json", '{"a": {"P": [[1,1,0,0],[0,1,0,0],[0,0,1,1]]}}', r"P has oblique pixels"),
        ("a.txt", "1 2 3\n", r"a line has 3 numbers; projection matrices need three lines of four"),
        ("a.txt", "hello\n", r"holds no cameras: it needs three lines of four numbers"),
        ("a.txt", "1 0 0 0\n0 1 0 0\n0 0 nan 1\n", r"NaN or infinity"),
        ("a.mcal", "<a/>", r"holds no cameras: .*calibrate them"),
        ("a.mcal", "<a", r"is not valid XML"),
        ("a.mcal", '<!DOCTYPE a [<!ENTITY b "c">]><a/>', r"it has a DOCTYPE"),
        ("a.mcal", '<a><Camera Serial="c"><IntrinsicStandardCameraModel/><Extrinsic/></Camera></a>',
         r"camera c: <Attributes ImagerPixelWidth> is missing"),
    ],
)  # fmt: skip
def test_refused(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_any(tmp_path / name)
    assert "\n" not in str(caught.value)
