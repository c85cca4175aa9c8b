"""The keys of recording.toml: what it may say, and the sentences about what it may not.

With the defaults; paths are relative to it:

    name = "walk"                     # default: the folder's name
    calibration = "calibration.toml"  # of any program that hypose.io.calibrations reads
    calibration_unit = "auto"         # auto, m, cm or mm: unit of the calibration's translations
    world_up = "z"                    # axis of the calibration's world that points up: x y z -x -y -z
    frame_rate = 60.0                 # frames/s; default: what the videos, or the files of key points, say
    frame_range = [0, 100]            # first frame and the one after the last, from 0; default: all
    keypoint_set = "BODY_25"          # order of the 2D key points; default: found out
    keypoint_lag = 0                  # key points of frame t belong to video frame t + keypoint_lag
    keypoint_pixels = "calibration"   # key points are pixels of the calibrated size, or of the stored "image"
    subject_height = 1.75             # m; default: estimated
    subject_mass = 70.0               # kg; default: unknown

    [[view]]                          # one per camera, in any order
    name = "cam01"
    camera = "cam_01"                 # its name in the calibration; default: by name, else by order
    video = "videos/cam01.mp4"        # a video file, or
    images = "images/cam01"           # a folder of images in natural order
    masks = "masks/cam01"             # silhouettes made elsewhere: folder of images or video; needs no video.
                                      # Of several objects: see hypose.io.recordings.object_masks
    depth = "depth/cam01"             # of a depth camera, in place of pictures: a folder of 16-bit PNG in millimetres,
                                      # 0 = hole; background is such a folder of the empty room then, and without
                                      # it the person is who stands on the floor (z = 0)
    background = "background/cam01"   # an image, a folder of images or a video of the empty scene
    keypoints = "pose/cam01_json"     # file or folder of hypose.io.keypoints.read_keypoints; needs no video
    board = "board/cam01.mp4"         # a video or folder of photos of a calibration board, which the studio's Calibrate
                                      # makes the calibration of; tracking does without
    image_shift = [0.0, 0.0]          # px to add to this view's image coordinates (after scaling to the
                                      # calibrated size) so that they agree with calibration and key points
    accept_scaled = false             # images of another shape (width : height) than calibrated were
                                      # stretched, not cut

    [[person]]                        # one per person, if there are several (hypose track --people)
    name = "anna"
    height = 1.68                     # m; default: estimated
    body = "bodies/anna"              # their own body, as hypose subject wrote it; default: fitted
    place = [0.4, -1.2]               # m: where they stand on the floor (x, y), z up, at
    time = 0.0                        # s from the first frame of the recording

    [silhouettes]                     # how masks are made (hypose.evidence.silhouettes.SilhouetteSettings)
    threshold = 4.0                   # and the other options; default: the usual ones

Images of another size but of the calibrated shape (to 1 %) are taken as scaled; a note says so. Videos are
taken as synchronous: frame t of one belongs to frame t of the others.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.evidence.silhouettes import SilhouetteSettings
from hypose.io.calibrations.calibration_toml import parse_toml
from hypose.io.files import read_text

_MAX_TOML_BYTES = 5_000_000
RECORDING_KEYS: dict[str, type | tuple[type, ...]] = {
    "name": str,
    "calibration": str,
    "calibration_unit": str,
    "world_up": str,
    "frame_rate": (int, float),
    "frame_range": list,
    "keypoint_set": str,
    "keypoint_lag": int,
    "keypoint_pixels": str,
    "subject_height": (int, float),
    "subject_mass": (int, float),
    "view": list,
    "person": list,
    "silhouettes": dict,
}
PATH_KEYS = ("video", "images", "masks", "background", "keypoints", "depth")
VIEW_KEYS: dict[str, type | tuple[type, ...]] = {
    "name": str,
    "camera": str,
    **dict.fromkeys(PATH_KEYS, str),
    "board": str,
    "image_shift": list,
    "accept_scaled": bool,
}
PERSON_KEYS: dict[str, type | tuple[type, ...]] = {
    "name": str,
    "height": (int, float),
    "body": str,
    "place": list,
    "time": (int, float),
}
SILHOUETTE_KEYS: dict[str, type | tuple[type, ...]] = {
    f.name: type(f.default)
    if type(f.default) in (bool, int, str)
    else list
    if f.name == "shadow_range"
    else (int, float)
    for f in fields(SilhouetteSettings)
}
_TYPE_NAMES = {
    str: "text in quotes",
    int: "a whole number",
    list: "a list in [ ]",
    bool: "true or false",
    dict: "a table [silhouettes]",
}


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a recording.toml; an InputError names the file, what is wrong in it and the next step."""
    text = read_text(path, "a TOML file", _MAX_TOML_BYTES)
    try:
        return parse_toml(path, text)
    except ValueError as error:
        raise InputError(f"{path} is not valid TOML: {error}; correct it.") from None


def check_keys(where: str, table: Mapping[str, Any], known: Mapping[str, type | tuple[type, ...]]) -> None:
    """InputError when a key of the table is unknown (the nearest known one is named) or of another type."""
    for key, value in table.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, 1, 0.5)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            raise InputError(f"{where}: the key {key} is unknown ({hint}); correct or remove it.")
        types = known[key]
        right = isinstance(value, types) and (types is bool or not isinstance(value, bool))
        if not right:
            wanted = _TYPE_NAMES[types] if isinstance(types, type) else "a number"
            raise InputError(f"{where}: {key} must be {wanted}, got {value!r}; correct it.")
        if isinstance(value, float) and not np.isfinite(value):
            raise InputError(f"{where}: {key} must be a finite number, got {value!r}; correct it.")


def numbers(where: str, key: str, value: Any, count: int, whole: bool) -> list[Any]:
    """value, when it is a list of `count` finite (whole) numbers; else an InputError."""
    types = int if whole else (int, float)
    fine = len(value) == count and all(isinstance(v, types) and not isinstance(v, bool) for v in value)
    if not fine or not np.isfinite(np.array(value, dtype=np.float64)).all():
        kind = "whole numbers" if whole else "numbers"
        raise InputError(f"{where}: {key} must be {count} {kind} in [ ], got {value!r}; correct it.")
    return value


def choice(where: str, key: str, value: str, allowed: Sequence[str]) -> str:
    """value, when it is one of the allowed words; else an InputError."""
    if value not in allowed:
        raise InputError(f"{where}: {key} must be {', '.join(allowed)}, got {value!r}; correct it.")
    return value


def silhouette_options(where: str, table: Mapping[str, Any]) -> SilhouetteSettings:
    """The options of a [silhouettes] table; what it does not name is as usual."""
    check_keys(f"{where}, silhouettes", table, SILHOUETTE_KEYS)
    values = dict(table)
    if "shadow_range" in values:
        values["shadow_range"] = tuple(numbers(where, "shadow_range", values["shadow_range"], 2, whole=False))
    try:
        return SilhouetteSettings(**values)
    except InputError as error:
        raise InputError(f"{where}, silhouettes: {error}") from None
