"""The tracker frame by frame, with masks that do not come from files: here a made-up scene's, in yours a camera's."""

import numpy as np

import hypose
from hypose.evaluation.published import known_subject
from hypose.evaluation.rigs import rig
from hypose.tracking.tracker import TrackerSettings

scene = hypose.make_scene("walk", "neutral", rig("humaneva-4").scaled(0.25), seconds=0.2)
subject = known_subject(scene)  # a body and the pose of the first frame
recipe, particles = hypose.recipe("default", subject.body, frame_rate=25.0)
tracker = hypose.Tracker(subject.body, recipe, particles, TrackerSettings(frame_rate=25.0))

state = tracker.start(subject.start)
for frame in scene.mask_frames():  # hypose.Frame: time, index, silhouettes with their cameras
    state, estimate = tracker.step(state, frame)
    wrist = subject.body.joints(estimate.pose)[12]
    print(f"{frame.time:.2f} s: right wrist at {np.round(wrist, 2)} m, sd {1000 * estimate.joint_sd[12]:.0f} mm")
