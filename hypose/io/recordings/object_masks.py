"""Masks of several objects: palette images, label images, one folder per object.

| given as `masks` of a view | an object is |
| --- | --- |
| images with a palette, of two or more indices | an index, 0 is the background |
| grey images (8 or 16 bit) with a few values | a value, 0 is the background |
| a folder that holds folders of masks | a folder, by its name |

`hypose.evidence.association` finds the objects of different views that are the same person.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.errors import InputError
from hypose.evidence.silhouettes import as_mask
from hypose.geometry import Mask
from hypose.io.files import distinct_numbers, natural_key
from hypose.io.videos.video import (
    PNG_SIGNATURE,
    VideoReader,
    decode,
    evenly_spread,
    frame_size,
    list_images,
    open_video,
    png_chunks,
    png_header,
    read_image,
    read_image_file,
)

SIDECAR = "hypose-masks.json"
"""Name of the note in a folder of masks that are already undistorted; their files are found by frame number."""
_LOOKED_AT = 9  # number of images that identify the kind of masks
_MOST_OBJECTS = 32  # objects
Objects = Mapping[str, Mask]
"""Mask (h, w) of 0 and 1 of each object that is present, by the object's name."""


class ObjectMasks:
    """Masks of several objects in one view, frame by frame.

    They can also be read as pictures, as from a `VideoReader`, with all objects in white.

    path: where the masks come from, for error messages.
    size: stored width and height, px.
    frames: number of frames.
    objects: names of all objects.
    load: function of the frame that gives the masks of its objects.
    first: number of the first frame's files; None where only the order of files counts.

    Attributes:
    chosen: names of the objects that are the person; None for all.
    """

    chosen: frozenset[str] | None = None

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        frames: int,
        objects: tuple[str, ...],
        load: Callable[[int], Objects],
        first: int | None = None,
    ) -> None:
        self.path, self.size, self.objects, self._load, self.first = path, size, objects, load, first
        self.n_frames = self.stated_frames = frames
        self.frame_rate: float | None = None

    def at(self, frame: int) -> Objects:
        """Get the masks of the objects in a frame.

        Raises: InputError where the frame does not exist.
        """
        if not 0 <= frame < self.n_frames:
            raise InputError(f"{self.path} ends with frame {self.n_frames - 1}, frame {frame} was asked for.")
        return self._load(frame)

    def union(self, frame: int, objects: frozenset[str] | None = None) -> Mask:
        """Combine the masks of objects in a frame to one mask (h, w) of 0 and 1; empty where none is there.

        objects: names of the objects; None for all.
        Raises: InputError where the frame does not exist.
        """
        out = np.zeros(self.size[::-1], dtype=np.uint8)
        for name, mask in self.at(frame).items():
            if objects is None or name in objects:
                out |= mask
        return out

    def read(self, index: int) -> NDArray[np.uint8]:
        """Draw all objects of a frame as a picture (h, w, 3), white on black."""
        return np.repeat((self.union(index) * np.uint8(255))[..., None], 3, 2)

    def close(self) -> None:
        """Do nothing; present because a `VideoReader` has it."""

    def __enter__(self) -> ObjectMasks:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def open_masks(path: Path, first: int | None = None) -> ObjectMasks | VideoReader:
    """Open masks of several objects, or a video or images with one mask per frame.

    first: number of the first frame's files, for one folder per object; None for the lowest number.
    Raises: InputError where the path does not hold masks.
    """
    if path.is_dir() and not (path / SIDECAR).is_file():
        images = list_images(path)
        inside = [p for p in sorted(path.iterdir(), key=lambda p: natural_key(p.name)) if p.is_dir() and list_images(p)]
        if not images and inside:
            return _of_folders(path, inside, first)
        found = _of_labels(path, images)
        if found is not None:
            return found
    return open_video(path)


def _of_folders(path: Path, folders: list[Path], first: int | None) -> ObjectMasks:
    """Open masks of one folder per object.

    Files of the same number are of the same frame; where numbers are missing or repeated, the order of files counts.

    folders: folder of each object, which names it.
    first: number of the first frame's files; None for the lowest number.
    """
    listed = {p.name: list_images(p) for p in folders}
    numbers = [distinct_numbers(files) or [] for files in listed.values()]
    if all(numbers):
        first = min(map(min, numbers)) if first is None else first
    else:
        first, numbers = None, [list(range(len(files))) for files in listed.values()]
    by_frame = {
        name: {n - (first or 0): file for n, file in zip(own, files, strict=True)}
        for (name, files), own in zip(listed.items(), numbers, strict=True)
    }
    size = frame_size(folders[0])

    def load(frame: int) -> Objects:
        out = {}
        for name, files in by_frame.items():
            if frame in files:
                image, _ = _decoded(files[frame])
                mask = as_mask(read_image(files[frame]) if image is None else image, str(files[frame]))
                if mask.shape[::-1] != size:
                    raise InputError(f"{files[frame]} has another size than the other masks of {path}.")
                if mask.any():
                    out[name] = mask
        return out

    frames = 1 + max(max(files) for files in by_frame.values())
    return ObjectMasks(path, size, frames, tuple(listed), load, first)


def _of_labels(path: Path, images: list[Path]) -> ObjectMasks | None:
    """Open images whose values are labels; None where they are ordinary masks."""
    if not images:
        return None
    areas, indexed = Counter[int](), []
    for i in evenly_spread(0, len(images), _LOOKED_AT):
        values, is_palette = _labels(images[i])
        if values is None:
            return None
        found, counts = np.unique(values, return_counts=True)
        if len(found) > _MOST_OBJECTS + 1:
            return None
        areas.update(dict(zip(found.tolist(), counts.tolist(), strict=True)))
        indexed.append(is_palette)
    areas.pop(0, None)
    levels = sorted(areas)
    if not 2 <= len(levels) <= _MOST_OBJECTS:
        return None
    if not any(indexed):  # a white mask may have soft edges, or grey for uncertain pixels
        full = 65535 if levels[-1] > 255 else 255
        white = areas[levels[-1]] if levels[-1] > 0.9 * full else 0
        if set(levels) <= {127, 128, full} or sum(areas.values()) < 1.5 * white:
            return None
    size = frame_size(images[0])

    def load(frame: int) -> Objects:
        values, _ = _labels(images[frame])
        if values is None or values.shape[::-1] != size:
            raise InputError(f"{images[frame]} is no image of labels like the others of {path}; write it again.")
        return {str(v): (values == v).astype(np.uint8) for v in np.unique(values).tolist() if v}

    return ObjectMasks(path, size, len(images), tuple(str(v) for v in levels), load)


def _labels(path: Path) -> tuple[NDArray[Any] | None, bool]:
    """Read the values (h, w) of a grey image or the indices of a palette image (True); None for a colour image."""
    image, indexed = _decoded(path)
    if image is not None and image.ndim == 3:
        grey = image.shape[2] < 4 and (image == image[..., :1]).all()
        image = image[..., 0] if grey else None
    return (image, indexed) if image is not None and np.issubdtype(image.dtype, np.integer) else (None, False)


def _decoded(path: Path) -> tuple[NDArray[Any] | None, bool]:
    """Decode an image without conversion; None where it is damaged. True: its values are indices of a palette."""
    data = read_image_file(path)
    *_, bits, colour = png_header(data)
    indexed = colour == 3
    image = decode(_without_palette(data) if indexed else data)
    if image is not None and indexed and bits < 8:  # a grey image of few bits is spread over 0 to 255
        image = np.rint(image.astype(np.float64) * (2**bits - 1) / 255).astype(np.uint8)
    return image, indexed


def _without_palette(data: bytes) -> bytes:
    """Rewrite a palette PNG as a grey PNG, so that OpenCV gives the indices and not their colours."""
    header = b"IHDR" + data[16:25] + b"\0" + data[26:29]
    colours = (b"IHDR", b"PLTE", b"tRNS", b"bKGD", b"hIST", b"sBIT")
    rest = [chunk for kind, chunk in png_chunks(data) if kind not in colours]
    return b"".join([PNG_SIGNATURE, struct.pack(">I", 13), header, struct.pack(">I", zlib.crc32(header)), *rest])
