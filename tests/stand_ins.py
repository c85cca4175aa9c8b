"""Small files in the shape of the real recordings (their names, sizes and peculiarities), made for whoever does not
have these: what reads the real ones is then tried all the same, though not on what people and cameras really did."""

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import ezc3d
import numpy as np

from hypose.geometry import transform
from hypose.io.motions.marker_files import write_trc
from tests import depth_sensors, missing


def mocap(folder: Path) -> None:
    """Markers as OpenCap's, and C3D files, written by ezc3d."""
    names = ["C7", *(f"m{k}" for k in range(49)), "L_toe"]
    place = np.linspace([0, 0, 1.5], [0, 0, 0.05], 51) + np.random.default_rng(0).normal(0, 0.01, (136, 51, 3))
    write_trc(folder / "opencap_walking2.trc", names, place, 100)
    for name, unit in (("kinematics_tennis_serve", "mm"), ("kinematics_tennis_serve_nan", "mm"), ("walking2", "m")):
        points = np.ones((4, 51, 136))
        points[:3] = place.T * (1000 if unit == "mm" else 1)
        if name.endswith("nan"):
            points[:3, 4, 20:40] = np.nan
        file = ezc3d.c3d()
        file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
        file["parameters"]["POINT"]["LABELS"]["value"] = names
        file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
        file["data"]["points"] = points
        file.write(str(folder / f"{name}.c3d"))


def kinect_multitrack(folder: Path) -> None:
    """8 s of one person between two Kinects, as the tracker of that name writes it."""
    order = sorted(_KINECT)
    rng, shown = np.random.default_rng(0), [_KINECT[name] for name in order]
    heads = ["Study_Id", "Tracker_Time", "Person_Id", "Skeleton_Id", "Skeleton_Time", "Kinect_Id"]
    heads[3:3] = ["Skeleton_Init_Angle", "Skeleton_Init_Dist"]
    lines = ["\ufeff" + ", ".join(heads + [f"{name}_{x}" for name in order for x in "XYZ"])]
    for n in range(240):
        joints = depth_sensors.walker(n / 30)
        for k, angle in enumerate((20, -50)):
            seen = transform(depth_sensors.camera(angle), joints + rng.normal(0, 0.008, joints.shape))
            values = (seen[shown] * [-1, -1, 1]).ravel()  # a Kinect's x is to its left, its y up
            times = 63562192334118 + 33 * n, 170926075120 + 330000 * n
            lines.append(
                f"2, {times[0]}, 0, 0, 0, {k}, {times[1]}, 10.0.0.{k}, " + ", ".join(f"{v:.5f}" for v in values)
            )
    text = "\r\n".join(lines) + "\r\n"
    (folder / "Study_2_Kinect_2_Time_12_32_04_PM.csv.gz").write_bytes(gzip.compress(text.encode()))


def azure_kinect_mkv(folder: Path) -> None:
    """One depth map of 640 x 576 px of a floor and the calibration as an attachment, as k4arecorder writes them but
    for the codec."""
    av = missing.module("av", "depth of Azure Kinect recordings", "pip install 'hypose[azure]'")
    depth = np.tile(np.linspace(3000, 1000, 576).astype(np.uint16)[:, None], (1, 640))
    with av.open(str(folder / "recording.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=30, width=640, height=576, pix_fmt="gray16le")
        stream.metadata["title"] = "DEPTH"
        container.add_attachment("calibration.json", "application/octet-stream", b'{"CalibrationInformation": {}}')
        container.mux([*stream.encode(av.VideoFrame.from_ndarray(depth, "gray16le")), *stream.encode()])


def first_camera_of_uu4cam(folder: Path) -> None:
    """A camera as OpenCV writes it, translation in mm, and a video whose header promises two frames too many."""
    storage = cv2.FileStorage(str(folder / "config.xml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", np.array([[486.52, 0, 335.98], [0, 487.74, 228.67], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([[-0.365, 0.181, -6.7e-5, 4.9e-5, -0.049]]))
    storage.write("rotation_vectors", np.array([[-0.67], [1.55], [1.87]], dtype=np.float32))
    storage.write("translation_vectors", np.array([[781.8], [754.3], [3875.9]], dtype=np.float32))
    storage.release()
    path = folder / "background.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 50, (64, 48))
    for k in range(132):
        writer.write(np.full((48, 64, 3), k, np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    for head, offset in ((b"avih", 8 + 16), (b"strh", 8 + 32)):  # where the headers count the frames
        at = data.index(head) + offset
        assert struct.unpack_from("<I", data, at) == (132,)
        struct.pack_into("<I", data, at, 134)
    path.write_bytes(data)


def pose2sim_output(folder: Path) -> None:
    """Markers in a file of 99 rows that says 100."""
    path = folder / "proj_0-99_filt_butterworth.trc"
    write_trc(path, [f"m{k}" for k in range(22)], np.random.default_rng(0).normal(0, 1, (99, 22, 3)), 60)
    path.write_text(path.read_text().replace("60\t60\t99\t", "60\t60\t100\t").replace("\t99\n", "\t100\n", 1))


_KINECT = {"Head": 0, "Neck": 1, "SpineShoulder": 1, "SpineMid": 8, "SpineBase": 8}  # of depth_sensors' joints
for _side, _arm, _leg in (("Left", 2, 9), ("Right", 5, 12)):
    _KINECT |= {f"{name}{_side}": _arm + k for k, name in enumerate(("Shoulder", "Elbow", "Wrist"))}
    _KINECT |= {f"{name}{_side}": _arm + 2 for name in ("Hand", "HandTip", "Thumb")}
    _KINECT |= {f"{name}{_side}": _leg + k for k, name in enumerate(("Hip", "Knee", "Ankle"))}
    _KINECT[f"Foot{_side}"] = _leg + 2

MAKERS: dict[str, Callable[[Path], None]] = {
    "mocap": mocap,
    "kinect_multitrack": kinect_multitrack,
    "azure_kinect_mkv": azure_kinect_mkv,
    "uu4cam/cam1": first_camera_of_uu4cam,
    "pose2sim_balancing/pose2sim_0.10.49_output": pose2sim_output,
}
"""Folder or file of shared/data -> what makes the like of it in an empty folder."""


def stop_at(stage, frame):
    """A progress function that interrupts a run at a frame of a stage."""

    def progress(now, done, total):
        if (now, done) == (stage, frame):
            raise KeyboardInterrupt

    return progress
