"""A walk before cameras with the tracker that follows it, for tests of what is done after tracking."""

import numpy as np

from benchmarks.robustness.small_recordings import small_scene
from hypose.body.default_body import human
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.recipes import default
from hypose.tracking.start_search import scaled_to_height, starts_in_frame
from hypose.tracking.tracker import Tracker


def walking_clip(n):
    """A walk of n frames: its scene, its frames, a small tracker, and the pose that it starts from."""
    scene = small_scene(1, n)
    frames = list(scene.mask_frames())
    body = scaled_to_height(human(), scene.subject.stature)
    start = starts_in_frame(body, prepare(frames[0], body, np.zeros(body.skeleton.dof)), body.stature)[0].pose
    return scene, frames, Tracker(body, default(body, particles=64)), start
