"""The tracker frame by frame, with masks that do not come from files: here a made-up scene's, in yours a camera's."""

import numpy as np

import hypose

scene = hypose.make_scene("walk", "neutral", "humaneva-4", seconds=0.2)
subject = hypose.track(hypose.FrameList(list(scene.mask_frames(0.25))), body=hypose.human())  # a body and a start
tracker = hypose.Tracker(subject.body, hypose.recipe("default", subject.body), hypose.TrackerSettings(frame_rate=25.0))

state = tracker.start(subject.motion.poses[0])
for frame in scene.mask_frames(0.25):  # hypose.Frame: time, index, silhouettes with their cameras
    state, estimate = tracker.step(state, frame)
    wrist = subject.body.joints(estimate.pose)[12]
    print(f"{frame.time:.2f} s: right wrist at {np.round(wrist, 2)} m, sd {1000 * estimate.joint_sd[12]:.0f} mm")
