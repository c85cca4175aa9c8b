"""Evidence of your own: radio tags on elbows and wrists that know their distances to four anchors to 3 cm, beside the
masks of two cameras."""

import numpy as np

import hypose

SD = 0.03  # m
ANCHORS = np.array([[2, 2, 0.5], [-2, 2, 2], [-2, -2, 0.5], [2, -2, 2]])


class Ranges:
    """measured (T, K, 4) m: how far the named joints were from the anchors."""

    def __init__(self, measured, names):
        self.measured, self.names = measured, names

    def residuals(self, points, index):
        """Of points (..., K, 3): (..., K, 4) in standard deviations, and the derivatives (..., K, 4, 3)."""
        away = points[..., None, :] - ANCHORS
        far = np.linalg.norm(away, axis=-1)
        return (far - self.measured[index]) / SD, away / far[..., None] / SD

    def rows(self, body, frame):
        """For the solver: residuals of points of the body."""
        joints = np.array([body.skeleton.joint(n) for n in self.names])
        return hypose.RowTerm(joints, lambda points: self.residuals(points, frame.index))

    def energy(self, body, poses, frame):
        """For the search: what each of the poses costs."""
        points = body.joints(poses)[:, [body.skeleton.joint(n) for n in self.names]]
        return 0.01 * np.abs(self.residuals(points, frame.index)[0]).mean((1, 2))


cameras = hypose.make_scene("box", "neutral", seconds=0.1).rig.cameras[::3]
scene = hypose.make_scene("box", "neutral", hypose.CameraRig(cameras), seconds=3.2)
frames, body = hypose.FrameList(list(scene.mask_frames(0.5))), hypose.human()
names = ["left_elbow", "left_wrist", "right_elbow", "right_wrist"]
true = np.linalg.norm(scene.joints[:, [body.skeleton.joint(n) for n in names], None] - ANCHORS, axis=-1)
ranges = Ranges(true + np.random.default_rng(0).normal(0, SD, true.shape), names)
for evidence in ([], [ranges]):
    joints = hypose.track(frames, body=body, own=evidence).motion.joints
    error = 1000 * np.linalg.norm(joints - scene.joints, axis=2)
    print(f"{len(evidence)} of my own: {error.mean():.0f} mm, arms {error[:, [7, 8, 11, 12]].mean():.0f} mm")
