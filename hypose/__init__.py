"""Human motion from ordinary cameras: weighted hypotheses of pose, held to the evidence in the images.

    import hypose

    result = hypose.track("my_recording")
    hypose.export_motion(result.motion, result.body, "out", ["trc", "mot"])

The names below are the public interface; each is imported when it is first used, so that `import hypose` costs nothing.
Everything else is reached by its module and may change between minor versions.
"""

from typing import Any

_PLACES = {
    # a recording becomes a motion
    "load_recording": "hypose.io.recordings.recording",
    "Recording": "hypose.io.recordings.recording",
    "track": "hypose.pipeline.track",
    "TrackOptions": "hypose.pipeline.track_options",
    "TrackResult": "hypose.pipeline.run",
    "load_result": "hypose.pipeline.run:load_tracked",
    # a motion and its files
    "Motion": "hypose.body.motion",
    "load_motion": "hypose.io.motions.results",
    "save_motion": "hypose.io.motions.results",
    "export_motion": "hypose.io.motions.export",
    "joint_angles": "hypose.body.joint_angles",
    # bodies
    "Body": "hypose.body.body",
    "human": "hypose.body.default_body",
    "load_body": "hypose.io.motions.results",
    "save_body": "hypose.io.motions.results",
    # cameras
    "Camera": "hypose.cameras.camera",
    "CameraRig": "hypose.cameras.camera",
    "read_calibration": "hypose.io.calibrations.calibration_formats:read_any",
    "write_calibration": "hypose.io.calibrations.calibration_formats",
    # frame by frame, with evidence of one's own
    "Frame": "hypose.evidence.frame",
    "Silhouettes": "hypose.evidence.frame",
    "FrameList": "hypose.pipeline.sources",
    "OwnEvidence": "hypose.evidence.cues",
    "PointTerm": "hypose.evidence.terms",
    "RowTerm": "hypose.evidence.terms",
    "Tracker": "hypose.tracking.tracker",
    "TrackerSettings": "hypose.tracking.tracker",
    # a method of one's own
    "recipe": "hypose.tracking.recipes",
    "Recipe": "hypose.inference.layer",
    "Layer": "hypose.inference.layer",
    "Hypotheses": "hypose.inference.hypotheses",
    "search": "hypose.inference.layer",
    "follow": "hypose.inference.layer",
    "stream": "hypose.inference.layer",
    "kernels": "hypose.inference",
    "resampling": "hypose.inference",
    "SmoothedWeight": "hypose.inference.annealing",
    "SilhouetteXor": "hypose.tracking.frame_evidence",
    "pose_mean": "hypose.tracking.refinement",
    # depth sensors
    "read_skeletons": "hypose.io.sensors.skeleton_files",
    "fuse_clip": "hypose.fusion.fuse",
    "LiveFuser": "hypose.fusion.people",
    "load_gesture_model": "hypose.pipeline.gesture_files:load_model",
    # scenes with known truth
    "make_scene": "hypose.synthetic.scenes",
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
        # as `from module import name` does, for a name may be a module itself
        value = getattr(__import__(module, fromlist=[other or name]), other or name)
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
