"""Writes a scene before depth cameras as a recording folder: depth maps, the empty room, calibration, truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hypose.io.recordings.recording import Recording, View, write_recording
from hypose.io.sensors.depth import write_depth_png
from hypose.synthetic.depth_scenes import DepthScene, depth_rig, depth_scene, to_profile, turning
from hypose.synthetic.motions import act
from hypose.synthetic.subjects import dress, load_subjects
from hypose.synthetic.write_recording import save_truth

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
