"""Writes a scene as a recording folder, as a user would have it: videos, background clips, calibration, key
points."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hypose.body.ready_bodies import JOINT_NAMES
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import InputError
from hypose.evidence.detector import openpose_document
from hypose.geometry import Array
from hypose.io.file_names import file_name
from hypose.io.files import atomic_path, write_text
from hypose.io.recordings.recording import Recording, View, write_recording
from hypose.io.sensors.depth import write_depth_png
from hypose.io.videos.video import VideoWriter
from hypose.synthetic.depth_scenes import DepthScene, depth_rig, depth_scene, to_profile, turning
from hypose.synthetic.motions import act
from hypose.synthetic.scenes import Scene
from hypose.synthetic.simulated_keypoints import keypoint_detections
from hypose.synthetic.subjects import dress, load_subjects


def check_folder(folder: Path) -> None:
    """An InputError when a recording cannot be written to the folder, because something else is there; one that
    `write_scene` has begun is written again."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give a folder.")
    if folder.is_dir() and not (folder / "truth.npz").is_file():
        if any(not p.name.startswith(".") for p in folder.iterdir()):
            raise InputError(f"The folder {folder} holds other files; give an empty or new folder.")


def write_truth(scene: Scene, folder: Path) -> None:
    """`save_truth` of a scene."""
    save_truth(folder, scene.times, scene.joints, scene.rotations, scene.subject.stature)


def save_truth(folder: Path, times: Array, joints: Array, rotations: Array, stature: float) -> None:
    """truth.npz: times (T,), joints (T, 19, 3) m, rotations (T, 19, 3, 3), joint_names, stature m. To be written first,
    for a folder that is not finished is known by it (`check_folder`)."""
    with atomic_path(folder / "truth.npz") as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            times=times,
            joints=joints,
            rotations=rotations,
            joint_names=np.array(JOINT_NAMES),
            stature=np.array(stature),
        )


def write_scene(
    scene: Scene,
    folder: str | Path,
    *,
    background_frames: int = 25,
    keypoints: bool = False,
    keypoint_noise_px: float = 4.0,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the scene to a folder; returns recording.toml's path.

    videos/NAME.mp4 and background/NAME.mp4 per camera (their width and height even, the calibration to
    match), calibration.toml with the rig the user was given, recording.toml, with keypoints=True
    pose/NAME_json/ with one OpenPose BODY_25 file per frame, and truth.npz (`write_truth`). progress(done, total) is
    called after every picture.
    """
    folder = Path(folder)
    write_truth(scene, folder)
    for sub in ("videos", "background"):
        (folder / sub).mkdir(exist_ok=True)
    rig = CameraRig(tuple(_even(c) for c in scene.given_rig))
    total, done = len(rig) * (len(scene) + background_frames), 0
    views = []
    for c, camera in enumerate(rig):
        size = camera.size
        name = file_name(camera.name)
        video, background = folder / "videos" / f"{name}.mp4", folder / "background" / f"{name}.mp4"
        for path, pictures in (
            (background, iter(scene.background_frames(c, background_frames))),
            (video, scene.rgb_frames(c)),
        ):
            with VideoWriter(path, scene.frame_rate, size) as writer:
                for picture in pictures:
                    writer.write(picture[: size[1], : size[0]])
                    done += 1
                    if progress is not None:
                        progress(done, total)
        pose = None
        if keypoints:
            pose = folder / "pose" / f"{name}_json"
            pose.mkdir(parents=True, exist_ok=True)
            points = keypoint_detections(scene, c, keypoint_noise_px)
            for t, people in enumerate(points):
                document = openpose_document(people[None])
                write_text(pose / f"{name}_{t:012d}_keypoints.json", json.dumps(document))
        views.append(View(camera.name, video=video, background=background, keypoints=pose))
    recording = Recording(
        folder,
        scene.name,
        rig,
        tuple(views),
        scene.frame_rate,
        None,
        keypoint_set="BODY_25" if keypoints else None,
        n_frames=len(scene),
    )
    return write_recording(recording, folder)


def _even(camera: Camera) -> Camera:
    """Videos need even sides: the last row or column is cut off."""
    return replace(camera, size=(camera.size[0] // 2 * 2, camera.size[1] // 2 * 2))


EMPTY_FRAMES = 20


def walking_scene(
    motion: str, subject: str, sensors: str, *, seconds: float, frame_rate: float, seed: int, clothing_m: float = 0.02
) -> DepthScene:
    """A built-in motion of a subject (name, "": chosen by the seed), who turns to both profiles, before sensors."""
    known = load_subjects()
    body = known[subject or sorted(known)[seed % len(known)]]
    body = dress(body, clothing_m, np.random.default_rng([seed, 0])) if clothing_m > 0 else body
    performance = act(motion, body, seconds, frame_rate, np.random.default_rng([seed, 1]))
    heading = to_profile(len(performance), seed)
    return depth_scene(turning(performance, body, heading), body, depth_rig(sensors), seed=seed)


def write_depth_scene(
    scene: DepthScene, folder: str | Path, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Write the scene to a folder; returns recording.toml's path: depth/NAME/ and background/NAME/ with 16-bit PNG in
    millimetres, calibration.toml, recording.toml and truth.npz. progress(done, total) is called after every map."""
    folder = Path(folder)
    save_truth(folder, scene.times, scene.joints, scene.rotations, scene.subject.stature)
    total, done = len(scene.rig) * (len(scene) + EMPTY_FRAMES), 0
    views = []
    for c, camera in enumerate(scene.rig):
        depth, empty = folder / "depth" / camera.name, folder / "background" / camera.name
        for target, count, make in ((empty, EMPTY_FRAMES, scene.empty_map), (depth, len(scene), scene.depth_map)):
            target.mkdir(parents=True, exist_ok=True)
            for t in range(count):
                write_depth_png(target / f"{t:06d}.png", make(c, t))
                done += 1
                if progress is not None:
                    progress(done, total)
        views.append(View(camera.name, depth=depth, background=empty))
    recording = Recording(
        folder, scene.name, scene.rig, tuple(views), scene.frame_rate, None, keypoint_set=None, n_frames=len(scene)
    )
    return write_recording(recording, folder)
