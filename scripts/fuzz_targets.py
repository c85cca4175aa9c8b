"""What is fuzzed: every reader of files and lines that come from outside, with a small good input for each."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.robustness.keypoint_layouts import LAYOUTS, detections, write_keypoints
from benchmarks.robustness.small_recordings import small_scene, write_gesture_session, write_masks, write_skeletons
from hypose.cameras.camera import Camera, CameraRig
from hypose.fusion.joints import COMMON
from hypose.geometry import so3_log
from scripts import fuzz_names, fuzz_servers


@dataclass(frozen=True)
class Target:
    """file: what is spoilt, relative to the folder of good inputs; read: the reader; kind: of mutation; given: what the
    reader gets ("" = that file; else its folder or another file); lines: the reader gets the bytes themselves;
    allowed: what it does that others may not (how it begins)."""

    name: str
    file: str
    read: Callable[[Any], Any]
    kind: str = "text"
    given: str = ""
    lines: bool = False
    allowed: tuple[str, ...] = ()


def targets() -> dict[str, Target]:
    """All targets by name."""
    from hypose.app.batch import read_table
    from hypose.calibration.from_points import read_scene_points
    from hypose.io.keypoints.keypoint_files import parse_openpose
    from hypose.io.motions import meshes, results
    from hypose.io.recordings import recording
    from hypose.io.sensors.depth import read_depth_png
    from hypose.io.sensors.skeleton_files import parse_line
    from hypose.io.videos import video
    from hypose.pipeline.gesture_files import load_model, read_recording

    found = [
        *_of_tables(),
        Target("calibration-points", "points.toml", read_scene_points),
        Target("recording-toml", "walk/recording.toml", recording.load_recording, given="walk"),
        Target("batch-table", "study.csv", read_table),
        Target("openpose-json", "pose.json", lambda b: parse_openpose(b, "pose.json"), lines=True),
        Target("body-npz", "motion/body.npz", results.load_body, "npz"),
        Target("checkpoint-npz", "motion/checkpoint.npz", lambda p: results.Checkpoint.load(p, {}), "npz"),
        Target("gesture-model", "model.npz", load_model, "npz"),
        Target("gesture-session", "session/session.json", read_recording, given="session"),
        Target("gesture-frames", "session/frames.csv", read_recording, given="session"),
        Target("live-line", "line.json", parse_line, lines=True),
        Target("live-server", "line.json", _live(), lines=True),
        Target("mesh-obj", "person.obj", meshes.read_person),
        Target("mesh-ply", "person.ply", meshes.read_person, "binary"),
        Target("mesh-stl", "person.stl", meshes.read_person, "binary"),
        Target("mesh-glb", "motion/motion.glb", meshes.read_person, "binary"),
        Target("depth-png", "depth.png", read_depth_png, "binary"),
        Target("image-png", "walk/cam1/00000.png", video.read_image, "binary"),
        Target("video-avi", "clip.avi", _all_frames, "binary"),
        *_of_servers(),
        *_of_names(),
    ]
    return {t.name: t for t in found}


_TABLES = {
    "calibration": {
        "toml": ("calibration.toml", ""),
        "yml": ("easymocap/extri.yml", ""),
        "yml-lenses": ("easymocap/intri.yml", "easymocap/extri.yml"),
        "folder-yml": ("easymocap/intri.yml", "easymocap"),
        "kalibr": ("camchain.yaml", ""),
        "opencv": ("lenses/cam1.xml", ""),
        "opencv-folder": ("lenses/cam1.xml", "lenses"),
        "qca": ("rig.qca.txt", ""),
        "xcp": ("rig.xcp", ""),
        "opencap": ("opencap/cam1.pickle", ""),
        "json": ("rig.json", ""),
        "mcal": ("rig.mcal", ""),
    },
    "keypoints": {
        "openpose": ("openpose/cam1_json/cam1_000000.json", "openpose/cam1_json"),
        "mmpose-results": ("mmpose-results/results_cam1.json", ""),
        "mmpose-predictions": ("mmpose-predictions/cam1.json", ""),
        "coco-results": ("coco-results/cam1_results.json", ""),
        "alphapose": ("alphapose/cam1/alphapose-results.json", ""),
        "alphapose-cmu": ("alphapose-cmu.json", ""),
        "easymocap": ("easymocap/annots/cam1/000000.json", "easymocap/annots/cam1"),
        "ultralytics": ("ultralytics/cam1/labels/cam1_1.txt", "ultralytics/cam1/labels"),
        "deeplabcut-csv": ("deeplabcut-csv/cam1DLC_resnet50_humanMay1shuffle1_100000.csv", ""),
        "sleap-csv": ("sleap-csv/cam1.analysis.csv", ""),
        "caliscope": ("caliscope/POSE/xy_POSE.csv", ""),
        "freemocap": ("freemocap/mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy", ""),
    },
    "motion": {
        "trc": ("motion.trc", ""),
        "c3d": ("motion.c3d", ""),
        "mot": ("motion.mot", ""),
        "npz": ("motion.npz", ""),
    },
    "skeleton": {
        "session": ("sensors/session.json", "sensors"),
        "frames": ("sensors/frames.csv", "sensors"),
        "bodies": ("sensors/skeleton.csv", "sensors"),
        "lines": ("people.jsonl", ""),
        "azure": ("offline.json", ""),
        "kinect": ("kinect.csv", ""),
    },
}
"""Samples of the formats by table: name -> the file that is spoilt, and what is read instead of it."""
_BINARY = (".npy", ".pickle", ".c3d")


def _of_tables() -> list[Target]:
    from hypose.io.calibrations.calibration_formats import read_any
    from hypose.io.motions.export import MOTION_FILES
    from hypose.io.sensors.skeleton_files import read_skeletons

    reads = {"calibration": read_any, "keypoints": _keypoints, "motion": MOTION_FILES.read, "skeleton": read_skeletons}
    return [
        Target(
            f"{table}-{name}",
            f"{table}/{file}",
            reads[table],
            "npz" if file.endswith(".npz") else "binary" if file.endswith(_BINARY) else "text",
            f"{table}/{given}" if given else "",
        )
        for table, samples in _TABLES.items()
        for name, (file, given) in samples.items()
    ]


def _keypoints(path: Path) -> None:
    """A view's key points, from their set to every frame."""
    from hypose.io.keypoints.read_keypoints import keypoints_of_views, read_keypoints

    cameras = list(read_keypoints(path))
    for view in keypoints_of_views([path] * len(cameras), cameras, cameras)[0]:
        for number in range(0 if view is None else min(view.last + 1, 50)):
            assert view is not None
            view.frame(number, (160, 120))


def _of_servers() -> list[Target]:
    reads = {
        "requests": fuzz_servers.send_requests,
        "gesture": fuzz_servers.send_frames("/ws/gesture"),
        "fuse": fuzz_servers.send_frames("/ws/fuse"),
        "datagrams": fuzz_servers.send_datagrams,
        "live": fuzz_servers.send_live_request,
    }
    return [
        Target(f"server-{n}", f"servers/{n}.txt", read, lines=True, allowed=fuzz_servers.ALLOWED)
        for n, read in reads.items()
    ]


def _of_names() -> list[Target]:
    return [
        Target(name, file, read, "binary" if name.startswith("cache") else "text", given, allowed=fuzz_names.ALLOWED)
        for name, (file, given, read) in fuzz_names.READS.items()
    ]


def _all_frames(path: Path) -> int:
    from hypose.io.videos.video import open_video

    with open_video(path) as reader:
        return sum(1 for _ in reader)


def _live() -> Callable[[bytes], Any]:
    """A live server that takes line after line, as from UDP; its clock goes on by 10 ms per line."""
    import asyncio

    from hypose.app.live.live_server import LiveServer

    loop = asyncio.new_event_loop()
    now = [0.0]
    server = LiveServer(udp=None, ws=None)
    server.clock = lambda: now[0]

    async def take(data: bytes) -> str | None:
        now[0] += 0.01
        return server.take(data)

    return lambda data: loop.run_until_complete(take(data))


# ---- good inputs ---------------------------------------------------------------------------------------------


def write_good(folder: Path) -> None:
    """The good inputs of all targets, written by the package's own writers where it has them."""
    import trimesh

    from hypose.body.default_body import human
    from hypose.body.motion import Motion, isotropic
    from hypose.gestures.forest import ForestSettings
    from hypose.gestures.model import GestureModel
    from hypose.gestures.online import Learner
    from hypose.io.calibrations.calibration_formats import write_calibration
    from hypose.io.motions.export import export_motion
    from hypose.io.motions.results import Checkpoint, save_body, save_motion
    from hypose.io.sensors.depth import write_depth_png
    from hypose.io.videos.video import writing_video
    from hypose.pipeline.gesture_files import save_model
    from hypose.synthetic.scenes import camera_rig

    rng = np.random.default_rng(5)
    cameras = CameraRig(camera_rig("humaneva-4", distorted=True).scaled(0.25).cameras[:2])
    write_calibration(cameras, folder / "calibration" / "calibration.toml")
    _write_calibrations(cameras, folder / "calibration")
    write_masks(small_scene(1, 2), folder / "walk")
    write_skeletons(folder / "skeleton" / "sensors", seconds=0.5)
    body = human()
    poses = np.zeros((4, body.skeleton.dof)) + 0.01 * rng.standard_normal((4, body.skeleton.dof))
    joints, flags = body.joints(poses), np.zeros(4, bool)
    sd = isotropic(np.full(joints.shape[:2], 0.01))
    motion = Motion(body.skeleton, np.arange(4) / 25, joints, poses, sd, flags, flags, np.full(4, 4), np.full(4, 0.1))
    (folder / "motion").mkdir()
    save_motion(motion, folder / "motion" / "motion.npz")
    save_body(body, folder / "motion" / "body.npz")
    Checkpoint(2, {"pose": poses[0], "done_poses": poses}, {"a": 1}, {}).save(folder / "motion" / "checkpoint.npz")
    export_motion(motion, body, folder / "motion", ("trc", "c3d", "glb", "mot"))
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.8)
    for ending in ("obj", "ply", "stl"):
        ball.export(folder / f"person.{ending}")
    write_depth_png(folder / "depth.png", 1.0 + rng.random((24, 32)))
    with writing_video(folder / "clip.avi", 25.0, (32, 24)) as writer:
        for _ in range(4):
            writer.write(rng.integers(0, 255, (24, 32, 3), dtype=np.uint8))
    write_gesture_session(folder / "session", "wave")
    learner = Learner.new(np.random.default_rng(0), ForestSettings())
    model = GestureModel("wave", learner, None)
    save_model(model, folder / "model.npz")
    for layout in _TABLES["keypoints"].keys() & LAYOUTS.keys():
        kind = LAYOUTS[layout][0]
        write_keypoints(layout, folder / "keypoints" / layout, detections(kind, cameras, 4), cameras, kind)
    _write_texts(folder)
    fuzz_servers.write_good(folder)
    fuzz_names.write_good(folder)


def write_easymocap(cameras: CameraRig, folder: Path) -> None:
    """intri.yml and extri.yml as OpenCV writes them for EasyMocap."""
    folder.mkdir(parents=True, exist_ok=True)
    for file, entries in (("intri.yml", ("K", "dist")), ("extri.yml", ("R", "T"))):
        storage = cv2.FileStorage(str(folder / file), cv2.FILE_STORAGE_WRITE)
        storage.write("names", list(cameras.names))
        for c in cameras:
            pose = c.camera_from_world
            values = {"K": c.K, "dist": c.distortion[None], "R": so3_log(pose[:3, :3])[:, None], "T": pose[:3, 3:]}
            for entry in entries:
                storage.write(f"{entry}_{c.name}", values[entry])
        storage.release()


def opencap_pickle(c: Camera) -> bytes:
    """A camera as OpenCap writes it: millimetres, in the world of an upright board whose y axis points down."""
    up_from_board = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])
    content = {
        "distortion": c.distortion[None],
        "intrinsicMat": c.K,
        "imageSize": np.array([[c.size[1]], [c.size[0]]], dtype=np.float64),
        "rotation": c.camera_from_world[:3, :3] @ up_from_board,
        "translation": 1000 * c.camera_from_world[:3, 3:],
    }
    return pickle.dumps(content, 3)


def _write_calibrations(cameras: CameraRig, folder: Path) -> None:
    """Calibrations that the package reads and does not write."""
    write_easymocap(cameras, folder / "easymocap")
    (folder / "opencap").mkdir()
    (folder / "opencap" / "cam1.pickle").write_bytes(opencap_pickle(cameras[0]))
    tables, mcal = [], []
    for c in cameras:
        pose = c.camera_from_world
        tables.append({"name": c.name, "resolution": list(c.size), "K": c.K.tolist(), "R": pose[:3, :3].tolist(),
                       "distCoef": c.distortion.tolist(), "t": pose[:3, 3:].tolist()})  # fmt: skip
        axes = " ".join(f'OrientMatrix{i}="{v!r}"' for i, v in enumerate(pose[:3, :3].ravel().tolist()))
        mcal.append(
            f'<Camera Serial="{c.name}"><Attributes ImagerPixelWidth="{c.size[0]}" ImagerPixelHeight="{c.size[1]}"/>'
            '<IntrinsicStandardCameraModel LensCenterX="80" LensCenterY="60" HorizontalFocalLength="150" '
            'VerticalFocalLength="150" k1="0" k2="0" k3="0" TangentialX="0" TangentialY="0"/>'
            f'<Extrinsic X="1" Y="2" Z="3" {axes}/></Camera>'
        )
    (folder / "rig.json").write_text(json.dumps({"cameras": tables}))
    (folder / "rig.mcal").write_text(f"<calibrationProfile>{''.join(mcal)}</calibrationProfile>")
    turn = " ".join(f'r{i}{j}="{int(i == j)}"' for i in (1, 2, 3) for j in (1, 2, 3))
    lens = 'focalLengthU="9600" focalLengthV="9600" centerPointU="5120" centerPointV="3840" '
    lens += 'radialDistortion1="0" radialDistortion2="0" tangentalDistortion1="0" tangentalDistortion2="0"'
    entries = f"  T_cn_cnm1: {np.eye(4).tolist()}\n  intrinsics: [150, 150, 80, 60]\n  resolution: [160, 120]\n"
    (folder / "camchain.yaml").write_text("".join(f"{c.name}:\n{entries}" for c in cameras))
    (folder / "lenses").mkdir()
    for c in cameras:
        storage = cv2.FileStorage(str(folder / "lenses" / f"{c.name}.xml"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", c.size[0])
        storage.write("image_height", c.size[1])
        storage.write("camera_matrix", c.K)
        storage.write("rvec", so3_log(c.camera_from_world[:3, :3]))
        storage.write("tvec", c.camera_from_world[:3, 3])
        storage.release()
    (folder / "rig.qca.txt").write_text(
        '<calibration><cameras><camera model="none" serial="1"><fov_video left="0" top="0" right="159" bottom="119"/>'
        f'<transform x="1" y="2" z="3" {turn}/><intrinsic {lens}/></camera></cameras></calibration>'
    )
    (folder / "rig.xcp").write_text(
        '<Cameras><Camera DEVICEID="1" TYPE="Video" SENSOR_SIZE="160 120" PIXEL_ASPECT_RATIO="1"><KeyFrames><KeyFrame '
        'FOCAL_LENGTH="150" PRINCIPAL_POINT="80 60" ORIENTATION="0 0 0 1" POSITION="1 2 3" VICON_RADIAL2="ViconRadial2 '
        '80 60 0 0 0"/></KeyFrames></Camera></Cameras>'
    )


def _write_texts(folder: Path) -> None:
    """Formats that the package reads and does not write."""
    points = {"a": [0, 0, 0], "b": [0.5, 0, 0], "c": [0, 0.5, 0], "d": [0.1, 0.1, 0.7]}
    lines = ["[points]", *(f"{n} = {p}" for n, p in points.items()), "[clicks.cam1]", "a = [10.5, 20.0]", "b = [30, 4]"]
    (folder / "points.toml").write_text("\n".join(lines) + "\n")
    (folder / "study.csv").write_text("recording,name,recipe,seed,height\nwalk,a,sir,0,1.8\nwalk,a,,1,\n")
    person = {"person_id": [-1], "pose_keypoints_2d": [1.5, 2.5, 0.9] * 25}
    bodies = {f"{t}.jpg": {"bodies": [{"joints": [10.0 + t, 20.0, 0.9] * 18}]} for t in range(4)}
    (folder / "keypoints" / "alphapose-cmu.json").write_text(json.dumps(bodies))
    (folder / "pose.json").write_text(json.dumps({"version": 1.3, "people": [person, person]}))
    joints = {n: [0.1, 0.1 * k, 2.0, 2] for k, n in enumerate(COMMON)}
    line = json.dumps({"sensor": "s0", "time": 1.25, "person": 0, "joints": joints})
    (folder / "line.json").write_text(line)
    lines = [line.replace("1.25", f"{t / 30:.4f}") + "\n" for t in range(8)]
    (folder / "skeleton" / "people.jsonl").write_text("".join(lines))
    azure = [
        {"timestamp_usec": 40_000 * t, "bodies": [{"body_id": 1, "joint_positions": [[100.0, 200.0, 2000.0 + t]] * 4}]}
        for t in range(8)
    ]
    document = {"joint_names": ["HEAD", "NECK", "PELVIS", "NOSE"], "frames": azure}
    (folder / "skeleton" / "offline.json").write_text(json.dumps(document))
    header = "Tracker_Time,Kinect_Id,Person_Id,Head_X,Head_Y,Head_Z,Neck_X,Neck_Y,Neck_Z"
    rows = [f"{33 * t},{t % 2},0,0.1,0.2,2.0,0.1,0.0,2.0" for t in range(12)]
    (folder / "skeleton" / "kinect.csv").write_text("\n".join([header, *rows]) + "\n")
