"""Scenes that begin with a person who sits, crouches, holds the arms somewhere, and faces anywhere; on a chair that the
masks show as well."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.multiview.action_scenes import subject_of_seed
from benchmarks.multiview.things_in_masks import with_thing
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.evidence.frame import Frame
from hypose.synthetic.motions import Take, sample_times
from hypose.synthetic.performance import Angles, Performance, Stance, moved, perform
from hypose.synthetic.scenes import Scene, camera_rig
from hypose.synthetic.subjects import SyntheticSubject

SCALE = 0.5
"""of the cameras' pictures"""
Channels = dict[str, float]
_HANGING: Channels = {"shoulder_flexion": 3, "shoulder_abduction": 9, "shoulder_internal": 12, "elbow_flexion": 18}
_FOLDED: Channels = {"shoulder_internal": 62, "elbow_flexion": 100, "clavicle_forward": 10, "shoulder_flexion": 34}
_SEAT: Channels = {"up": -0.49, "forward": -0.47, "pelvis_lean": 4, "spine_lean": 6, "neck_lean": -4}
_ON_THIGHS: Channels = {"shoulder_flexion": 38, "elbow_flexion": 52, "shoulder_abduction": 6}
POSTURES: Mapping[str, tuple[Channels, Channels, Stance]] = {
    "standing": ({}, _HANGING, Stance()),
    "seated": (_SEAT, _ON_THIGHS, Stance(0.0, 0.0, 0.17, 12.0)),
    "seated, arms folded": (_SEAT, _FOLDED, Stance(0.0, 0.0, 0.17, 12.0)),
    "crouching": (
        {"up": -0.4, "forward": -0.15, "pelvis_lean": 28, "spine_lean": 22, "neck_lean": -20},
        {"shoulder_flexion": 45, "elbow_flexion": 40, "shoulder_abduction": 8},
        Stance(0.05, -0.05, 0.18, 12.0),
    ),
    "arms forward": ({}, {"shoulder_flexion": 86, "elbow_flexion": 8}, Stance()),
    "arms up": ({}, {"shoulder_flexion": 165, "shoulder_abduction": 10, "elbow_flexion": 12}, Stance()),
    "arms folded": ({"spine_lean": -2}, {**_FOLDED, "shoulder_abduction": 10}, Stance()),
    "step": ({"pelvis_lean": 3}, {"shoulder_flexion": 12, "elbow_flexion": 30}, Stance(0.35, -0.3, 0.1, 6.0)),
}
"""Channels of the trunk and of both arms, in degrees, and where the feet stand."""
CHAIRED = ("seated", "seated, arms folded")
RIGS = ("humaneva-4", "ring-5")


def performance(
    posture: str, subject: SyntheticSubject, rng: np.random.Generator, seconds: float, rate: float
) -> Performance:
    """Somebody who holds a posture as people do: not quite, not still, and facing anywhere."""
    trunk, arms, stance = POSTURES[posture]
    take, t = Take(rng), sample_times(seconds, rate)
    values = dict(trunk)
    for side in ("left", "right"):
        values |= {f"{side}_{c}": v + float(rng.normal(0, 6)) for c, v in arms.items()}
    for channel in ("pelvis_lean", "spine_lean", "spine_turn", "spine_list", "neck_turn", "neck_lean"):
        values[channel] = values.get(channel, 0.0) + float(rng.normal(0, 4))
    course = {c: np.full(len(t), v, dtype=np.float64) for c, v in values.items()}
    for channel, size in (("spine_lean", 1.5), ("spine_turn", 2.5), ("neck_turn", 4.0)):
        course[channel] = course[channel] + take.drift(t, size)
    for side in ("left", "right"):
        for channel, size in (("shoulder_flexion", 4.0), ("elbow_flexion", 5.0)):
            course[f"{side}_{channel}"] = course[f"{side}_{channel}"] + take.drift(t, size)
    made = perform(Angles(posture, t, course, stance), subject)
    made = moved(made, float(rng.uniform(0, 2 * np.pi)))
    x, y = rng.uniform(-0.3, 0.3, 2) - made.root[0, :2]
    return moved(made, 0.0, (float(x), float(y)))


def start_scene(posture: str, cameras: str, seed: int, seconds: float = 1.4) -> Scene:
    """A scene that begins in a posture, masks with level-1 corruption."""
    subject = subject_of_seed(seed)
    rng = np.random.default_rng([seed, list(POSTURES).index(posture), RIGS.index(cameras)])
    acted = performance(posture, subject, rng, seconds, 25.0)
    return noisy_scene(acted, subject, camera_rig(cameras), seed=seed)


def frames_of(scene: Scene, chair: bool) -> list[Frame]:
    """The frames with masks, the chair in them."""
    frames = list(scene.mask_frames(SCALE))
    return with_thing(frames, scene, "chair") if chair else frames
