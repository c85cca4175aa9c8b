"""The silhouettes of a recording as folders of pictures, which another recording reads as its `masks`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from hypose.errors import InputError
from hypose.io.file_names import folder_for
from hypose.io.files import write_bytes, write_text
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.view_source import SIDECAR


def write_masks(stream: FrameStream, folder: str | Path, progress: Callable[[int, int], None] | None = None) -> int:
    """Write the stream's masks as PNG (0/255), undistorted, at working size: folder/VIEW/FRAME.png;
    returns how many of them show something.

    A note beside them says that they are undistorted, so that a recording whose view names such a folder
    as `masks` reads them back exactly. progress(done, total) is called after every frame.
    """
    folder = Path(folder)
    views = [folder_for(folder, v.name) for v in stream.recording.views]
    for path, camera in zip(views, stream.rig, strict=True):
        write_text(path / SIDECAR, json.dumps({"undistorted": True, "size": list(camera.size)}) + "\n")
    shown = 0
    for done, frame in enumerate(stream, 1):
        if frame.silhouettes is None:
            if not stream.recording.has_pictures:
                raise InputError(
                    f"{stream.recording.name} has key points alone, and silhouettes are made from pictures; give the "
                    "videos in recording.toml."
                )
            raise InputError("There are no silhouettes to write; open the stream with silhouettes.")
        for path, camera, mask in zip(views, stream.rig, frame.silhouettes.masks, strict=True):
            ok, data = cv2.imencode(".png", mask[: camera.size[1], : camera.size[0]] * np.uint8(255))
            write_bytes(path / f"{frame.index:06d}.png", data.tobytes() if ok else b"", synced=False)
        if progress is not None:
            progress(done, len(stream))
        shown += int((frame.silhouettes.areas > 0).sum())
    return shown
