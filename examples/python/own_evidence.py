"""Evidence of your own: tags on elbows and wrists that tell where they are to 3 cm, beside the masks of two cameras."""

import numpy as np

import hypose

SD = 0.03  # m


class Tags:
    """measured (T, K, 3) m: where the named joints were."""

    def __init__(self, measured, names):
        self.measured, self.names = measured, names

    def rows(self, body, frame):
        """For the solver: points of the body and where they should be."""
        joints = np.array([body.skeleton.joint(n) for n in self.names])
        ones = np.ones(len(joints))
        return hypose.PointTerm(self.measured[frame.index], ones, joints, np.zeros((len(joints), 3)), SD)

    def energy(self, body, poses, frame):
        """For the search: what each of the poses costs."""
        joints = body.joints(poses)[:, [body.skeleton.joint(n) for n in self.names]]
        return 0.01 * (np.linalg.norm(joints - self.measured[frame.index], axis=2) / SD).mean(1)


cameras = hypose.make_scene("box", "neutral", seconds=0.1).rig.cameras[:2]
scene = hypose.make_scene("box", "neutral", hypose.CameraRig(cameras), seconds=1.6)
frames, body = hypose.FrameList(list(scene.mask_frames(0.5))), hypose.human()
names = ["left_elbow", "left_wrist", "right_elbow", "right_wrist"]
true = scene.joints[:, [body.skeleton.joint(n) for n in names]]
tags = Tags(true + np.random.default_rng(0).normal(0, SD, true.shape), names)
for evidence in ([], [tags]):
    joints = hypose.track(frames, body=body, own=evidence).motion.joints
    error = 1000 * np.linalg.norm(joints - scene.joints, axis=2)
    print(f"{len(evidence)} of my own: {error.mean():.0f} mm, arms {error[:, [7, 8, 11, 12]].mean():.0f} mm")
