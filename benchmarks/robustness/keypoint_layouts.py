"""A walking person's key points, written in the layouts of the programs whose files are read.

Each writer follows the code of the program itself (named in `hypose.io.keypoints`), so that a reader is held to what
people have and not to what it expects.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hypose.body.default_body import human
from hypose.cameras.camera import CameraRig
from hypose.evidence.keypoints import keypoint_names, landmark_of
from hypose.geometry import Array
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.files import toml_value

RATE = 25.0
# points that the body does not have -> one of its landmarks nearby
_NEAR = {
    "eye_inner": "{}_eye",
    "eye_outer": "{}_eye",
    "mouth": "nose",
    "pinky": "{}_hand_tip",
    "index": "{}_hand_tip",
    "thumb": "{}_thumb_tip",
}


def walker(frames: int, seed: int = 0) -> Array:
    """Poses (T, D) of the default body that walks on the spot, turns and swings its arms."""
    skeleton = human().skeleton
    rng = np.random.default_rng(seed)
    t = np.arange(frames) / RATE
    poses = np.zeros((frames, skeleton.dof))
    phase = 2 * np.pi * 0.9 * t + rng.uniform(0, 1)
    moves = {
        "pelvis_tz": 0.93 + 0.02 * np.cos(2 * phase),
        "pelvis_tx": 0.15 * np.sin(0.7 * t),
        "pelvis_rz": 0.4 * np.sin(0.5 * t),
        "left_hip_rx": -0.45 * np.sin(phase),
        "right_hip_rx": 0.45 * np.sin(phase),
        "left_knee_flexion": 0.5 - 0.4 * np.cos(phase),
        "right_knee_flexion": 0.5 + 0.4 * np.cos(phase),
        "left_elbow_flexion": 0.6 + 0.3 * np.sin(phase),
        "right_elbow_flexion": 0.6 - 0.3 * np.sin(phase),
        "left_shoulder_rx": 0.4 * np.sin(phase),
        "right_shoulder_rx": -0.4 * np.sin(phase),
        "neck_rz": 0.3 * np.sin(1.1 * t),
    }
    for name, values in moves.items():
        poses[:, skeleton.dof_names.index(name)] = values
    return poses


def _landmark(name: str) -> str:
    side, _, part = name.partition("_")
    return _NEAR[part].format(side) if part in _NEAR else name


def detections(keypoint_set: str, rig: CameraRig, frames: int, seed: int = 0, noise_px: float = 1.0) -> Array:
    """(C, T, K, 3) px of the rig's pictures and scores 0..1; points that the body does not have are missing."""
    body, names = human(), keypoint_names(keypoint_set)
    joint, offset, known = landmark_of([_landmark(n) for n in names], body)
    rng = np.random.default_rng([seed, 1])
    rotations, centres = body.skeleton.forward(walker(frames, seed))
    world = centres[:, joint] + np.einsum("tkab,kb->tka", rotations[:, joint], offset)
    out = np.zeros((len(rig), frames, len(names), 3))
    for c, camera in enumerate(rig):
        uv = camera.project(world) + noise_px * rng.standard_normal(world.shape[:2] + (2,))
        inside = known & np.isfinite(uv).all(-1) & (uv >= 0).all(-1) & (uv < np.array(camera.size)).all(-1)
        out[c, ..., :2] = np.where(inside[..., None], uv, 0)
        out[c, ..., 2] = np.where(inside, rng.uniform(0.6, 0.98, inside.shape), 0)
    return np.round(out, 3)


def write_keypoints(layout: str, folder: Path, points: Array, rig: CameraRig, keypoint_set: str) -> list[Path]:
    """Key points (C, T, K, 3) in a layout of LAYOUTS; the file or folder of each camera."""
    folder.mkdir(parents=True, exist_ok=True)
    return LAYOUTS[layout][1](folder, points, rig, keypoint_names(keypoint_set))


def write_keypoint_recording(
    folder: Path, rig: CameraRig, paths: list[Path], stated: str | None = None, rate: float | None = RATE
) -> Path:
    """recording.toml and calibration.toml for key points alone."""
    write_calibration(rig, folder / "calibration.toml")
    lines = [] if rate is None else [f"frame_rate = {rate}"]
    lines += [] if stated is None else [f"keypoint_set = {toml_value(stated)}"]
    for camera, path in zip(rig, paths, strict=True):
        lines += ["[[view]]", f"name = {toml_value(camera.name)}", f"keypoints = {toml_value(str(path))}"]
    (folder / "recording.toml").write_text("\n".join(lines) + "\n")
    return folder


# ---- one writer per layout: (folder, points (C, T, K, 3), rig, names) -> path per camera ---------------------------


def _seen(person: Array) -> bool:
    return bool((person[:, 2] > 0).any())


def _openpose(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        (folder / f"{camera.name}_json").mkdir()
        out.append(folder / f"{camera.name}_json")
        for t, person in enumerate(frames):
            people = [{"person_id": [-1], "pose_keypoints_2d": person.ravel().tolist()}] if _seen(person) else []
            (out[-1] / f"{camera.name}_{t:06d}.json").write_text(json.dumps({"version": 1.3, "people": people}))
    return out


def _mmpose_person(person: Array) -> dict[str, Any]:
    x0, y0, x1, y1 = *person[:, :2].min(0).tolist(), *person[:, :2].max(0).tolist()
    return {
        "keypoints": person[:, :2].tolist(),
        "keypoint_scores": person[:, 2].tolist(),
        "bbox": [[x0, y0, x1, y1]],  # the stray comma in split_instances
        "bbox_score": 0.9,
    }


def _mmpose_frames(frames: Array, first: int) -> list[dict[str, Any]]:
    return [{"frame_id": t + first, "instances": [_mmpose_person(p)] if _seen(p) else []} for t, p in enumerate(frames)]


def _mmpose_results(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    meta = {"dataset_name": "coco", "keypoint_id2name": {str(k): n for k, n in enumerate(names)}}
    for camera, frames in zip(rig, points, strict=True):
        out.append(folder / f"results_{camera.name}.json")
        out[-1].write_text(json.dumps({"meta_info": meta, "instance_info": _mmpose_frames(frames, 1)}))
    return out


def _mmpose_predictions(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        out.append(folder / f"{camera.name}.json")
        out[-1].write_text(json.dumps(_mmpose_frames(frames, 0)))
    return out


def _coco_list(frames: Array, image: Callable[[int], Any], more: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {"image_id": image(t), "category_id": 1, "keypoints": p.ravel().tolist(), "score": 2.9, **more}
        for t, p in enumerate(frames)
        if _seen(p)
    ]


def _coco_results(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        out.append(folder / f"{camera.name}_results.json")
        out[-1].write_text(json.dumps(_coco_list(frames, lambda t: 1000 + t, {})))
    return out


def _alphapose(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        (folder / camera.name).mkdir()
        out.append(folder / camera.name / "alphapose-results.json")
        more = {"box": [1.0, 2.0, 3.0, 4.0], "idx": 1}
        out[-1].write_text(json.dumps(_coco_list(frames, lambda t: f"{t}.jpg", more)))
    return out


def _easymocap(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        out.append(folder / "annots" / camera.name)
        out[-1].mkdir(parents=True)
        for t, person in enumerate(frames):
            annots = [{"personID": 0, "bbox": [0, 0, 9, 9, 1], "keypoints": person.tolist(), "isKeyframe": False}]
            page = {"filename": f"{t:06d}.jpg", "height": camera.size[1], "width": camera.size[0], "annots": annots}
            (out[-1] / f"{t:06d}.json").write_text(json.dumps(page | {"isKeyframe": False}))
    return out


def _ultralytics(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        out.append(folder / camera.name / "labels")
        out[-1].mkdir(parents=True)
        for t, person in enumerate(frames):
            share = np.column_stack([(person[:, :2] + 0.5) / camera.size, person[:, 2]])
            share[person[:, 2] == 0, :2] = 0
            numbers = [0, 0.5, 0.5, 0.2, 0.7, *share.ravel().tolist()]
            if _seen(person):  # else there is no file
                (out[-1] / f"{camera.name}_{t + 1}.txt").write_text(" ".join(f"{n:g}" for n in numbers) + "\n")
    return out


def _deeplabcut(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        out.append(folder / f"{camera.name}DLC_resnet50_humanMay1shuffle1_100000.csv")
        columns = [(n, c) for n in names for c in ("x", "y", "likelihood")]
        lines = [",".join(["scorer", *["DLC_resnet50_humanMay1shuffle1_100000"] * len(columns)])]
        lines += [",".join(["bodyparts", *(n for n, _ in columns)]), ",".join(["coords", *(c for _, c in columns)])]
        lines += [",".join([str(t), *map(repr, p.ravel().tolist())]) for t, p in enumerate(frames)]
        out[-1].write_text("\n".join(lines) + "\n")
    return out


def _sleap_csv(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    out = []
    for camera, frames in zip(rig, points, strict=True):
        out.append(folder / f"{camera.name}.analysis.csv")
        columns = [f"{n}.{c}" for n in names for c in ("x", "y", "score")]
        lines = [",".join(["track", "frame_idx", "instance.score", *columns])]
        for t, person in enumerate(frames):
            cells = [",,0.0" if c == 0 else f"{x!r},{y!r},{c!r}" for x, y, c in person.tolist()]
            lines += [",".join(["track_0", str(t), "0.9", *cells])] if _seen(person) else []
        out[-1].write_text("\n".join(lines) + "\n")
    return out


def _caliscope(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...], old: bool = False) -> list[Path]:
    tracker = folder / "POSE"
    tracker.mkdir()
    camera, first = ("port", 12) if old else ("cam_id", 1549)
    rows = [f"sync_index,{camera},frame_index,frame_time,point_id,img_loc_x,img_loc_y,obj_loc_x,obj_loc_y"]
    times = [f"sync_index,{camera},frame_time"]
    for t in range(points.shape[1]):
        for c in range(len(rig)):
            now = 47389.9 + t / RATE + 0.001 * c
            times.append(f"{t + first},{c},{now!r}")
            rows += [
                f"{t + first},{c},{t},{now!r},{k},{x!r},{y!r},,"
                for k, (x, y, s) in enumerate(points[c, t].tolist())
                if s > 0
            ]
    (tracker / "xy_POSE.csv").write_text("\n".join(rows) + "\n")
    where = tracker / "frame_time_history.csv" if old else folder / "timestamps.csv"
    where.write_text("\n".join(times) + "\n")
    return [tracker / "xy_POSE.csv"] * len(rig)


def _freemocap(folder: Path, points: Array, rig: CameraRig, names: tuple[str, ...]) -> list[Path]:
    body = np.where(points[..., 2:] > 0, points[..., :2], np.nan)
    rest = np.full((*points.shape[:2], 520, 2), np.nan)  # hands and face
    path = folder / "mediapipe_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy"
    np.save(path, np.concatenate([body, rest], 2))
    return [path] * len(rig)


Writer = Callable[[Path, Array, CameraRig, tuple[str, ...]], list[Path]]
LAYOUTS: Mapping[str, tuple[str, Writer]] = {
    "openpose": ("BODY_25", _openpose),
    "rtmlib": ("HALPE_26", _openpose),
    "mmpose-results": ("HALPE_26", _mmpose_results),
    "mmpose-predictions": ("COCO_17", _mmpose_predictions),
    "coco-results": ("COCO_17", _coco_results),
    "alphapose": ("HALPE_26", _alphapose),
    "easymocap": ("BODY_25", _easymocap),
    "ultralytics": ("COCO_17", _ultralytics),
    "deeplabcut-csv": ("HALPE_26", _deeplabcut),
    "sleap-csv": ("COCO_17", _sleap_csv),
    "caliscope": ("BLAZEPOSE_33", _caliscope),
    "caliscope-old": ("BLAZEPOSE_33", lambda f, p, r, n: _caliscope(f, p, r, n, old=True)),
    "freemocap": ("BLAZEPOSE_33", _freemocap),
}
"""Layout -> the set that it usually holds, and its writer."""
UNSCORED = ("caliscope", "caliscope-old", "freemocap")
