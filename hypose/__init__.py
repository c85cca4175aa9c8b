"""Human motion from ordinary cameras: weighted hypotheses of pose, held to the evidence in the images.

    import hypose

    result = hypose.track("my_recording")
    hypose.export_motion(result.motion, result.body, "out", ["trc", "mot"])

The names below are the public interface; each is imported when it is first used, so that `import hypose` costs nothing.
Everything else is reached by its module and may change between minor versions.
"""

import importlib
from typing import Any

_PLACES = {
    # a recording becomes a motion
    "load_recording": "hypose.io.recording",
    "Recording": "hypose.io.recording",
    "track": "hypose.pipeline.track",
    "TrackOptions": "hypose.pipeline.run",
    "TrackResult": "hypose.pipeline.run",
    # a motion and what is made of it
    "Motion": "hypose.body.motion",
    "load_motion": "hypose.io.results",
    "save_motion": "hypose.io.results",
    "export_motion": "hypose.io.export",
    "joint_angles": "hypose.body.joint_angles",
    # bodies
    "Body": "hypose.body.body",
    "human": "hypose.body.models",
    "load_body": "hypose.io.bodies",
    "save_body": "hypose.io.bodies",
    # cameras
    "Camera": "hypose.cameras.camera",
    "CameraRig": "hypose.cameras.camera",
    "read_calibration": "hypose.io.calibration_formats:read_any",
    "write_calibration": "hypose.io.calibration_formats:write_any",
    # frame by frame, with evidence of one's own
    "Frame": "hypose.evidence.frame",
    "Tracker": "hypose.tracking.tracker",
    "recipe": "hypose.tracking.recipes",
    # depth sensors
    "read_skeletons": "hypose.io.skeletons",
    "fuse_clip": "hypose.fusion.fuse",
    "load_gesture_model": "hypose.pipeline.gesture_files:load_model",
    # scenes with known truth
    "make_scene": "hypose.evaluation.scenes",
    # what goes wrong
    "HyposeError": "hypose.errors",
    "InputError": "hypose.errors",
}

__all__ = ["__version__", *_PLACES]  # pyright: ignore[reportUnsupportedDunderAll] (__init__.pyi has the types)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value = _version()
    elif name in _PLACES:
        module, _, other = _PLACES[name].partition(":")
        value = getattr(importlib.import_module(module), other or name)
    else:
        raise AttributeError(f"module 'hypose' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("hypose")
    except PackageNotFoundError:  # run from a checkout that was never installed
        return "0+unknown"
