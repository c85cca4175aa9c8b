"""Small recordings written by the tests themselves: coloured frames whose number can be read back."""

import numpy as np

from hypose.cameras.camera import Camera, CameraRig
from hypose.geometry import se3, so3_exp
from hypose.io.calibrations.calibration_formats import write_calibration
from hypose.io.files import toml_value
from hypose.io.videos.video import writing_video

SIZE = (64, 48)


def make_camera(name, turn=0.0, size=SIZE, fisheye=False, distance=3.0):
    """A camera at `distance` m from the origin, 1 m high, looking at it, turned about z."""
    down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    r = down @ so3_exp([0.0, 0.0, turn])
    k = np.array([[size[0] * 1.1, 0, size[0] / 2 - 0.3], [0, size[0] * 1.1, size[1] / 2 + 0.2], [0, 0, 1]])
    lens = np.array([0.01, -0.002, 0.0004, 0.0003] if fisheye else [-0.2, 0.05, 0.001, -0.0007, 0.01])
    return Camera(name, k, lens, se3(r, np.array([0.02, 1.0, distance])), size, fisheye)


def make_rig(names=("cam_1", "cam_2"), size=SIZE):
    return CameraRig(tuple(make_camera(n, 1.3 * i, size) for i, n in enumerate(names)))


def frame(index, size=SIZE):
    return np.full((size[1], size[0], 3), 3 * index, dtype=np.uint8)


def frame_number(image):
    return round(float(image.mean()) / 3)


def make_video(path, n=12, size=SIZE, frame_rate=25.0):
    """Motion JPEG: grey levels come back exactly enough to tell frames apart."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with writing_video(path, frame_rate, size) as writer:
        for i in range(n):
            writer.write(frame(i, size))
    return path


def write_toml(path, settings):
    views = settings.pop("view", [])
    lines = [f"{k} = {toml_value(v)}" for k, v in settings.items()]
    for view in views:
        lines += ["[[view]]", *(f"{k} = {toml_value(v)}" for k, v in view.items())]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def make_recording(folder, views=None, calibrated=True, names=("cam_1", "cam_2"), **settings):
    """A recording folder of two views with 12 frames at 25 fps; views: tables of recording.toml to use
    instead."""
    folder.mkdir(parents=True, exist_ok=True)
    if calibrated:
        write_calibration(make_rig(names), folder / "calibration.toml")
    if views is None:
        for n in names:
            make_video(folder / f"{n}.avi")
        views = [{"name": n, "video": f"{n}.avi"} for n in names]
    write_toml(folder / "recording.toml", {**settings, "view": views})
    return folder
