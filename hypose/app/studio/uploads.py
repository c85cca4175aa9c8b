"""Files that are dropped onto the page, and the recordings made of them.

An upload is streamed to a hidden folder of this server in the served root; a recording takes it over by renaming. What
no recording has taken over is gone when the server ends, or when many others have come since.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import threading
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import cv2

from hypose.app.studio.answers import NotNow, TooLarge
from hypose.app.studio.catalog import Catalog, NotFound
from hypose.app.studio.job_kinds import free_folder
from hypose.app.studio.new_recording import Layout, Upload, layout_of
from hypose.errors import HyposeError, InputError
from hypose.io.calibrations.calibration_formats import read_any
from hypose.io.files import write_text
from hypose.io.keypoints.read_keypoints import read_keypoints
from hypose.io.recordings.recording import load_recording
from hypose.io.videos.video import IMAGE_ENDINGS, VIDEO_ENDINGS, open_video

FOLDER = ".studio-uploads-"
"""Begins the name of the folder of a server's uploads, in the served one."""
_LARGEST_CALIBRATION = 20 << 20
_MOST = 64
"""Files that lie ready or are on their way; a page sends 60."""
_QUALITY = 80
_KEYPOINT_ENDINGS = (".json", ".csv", ".h5", ".hdf5", ".npy")


class Uploads:
    """The uploads of a server. limit: bytes of one file."""

    def __init__(self, catalog: Catalog, limit: int) -> None:
        self._catalog, self.limit = catalog, limit
        self._folder: Path | None = None
        self._lock = threading.Lock()
        self._uploads: dict[str, Upload] = {}
        self._coming = 0

    async def receive(self, name: str, chunks: AsyncIterator[bytes], stated: int | None) -> Path:
        """Take a file's bytes; returns where they lie until `examine`. TooLarge as soon as they are too many."""
        if stated is not None:
            self._check_size(stated, name)
        with self._lock:
            if self._coming >= _MOST:
                raise NotNow(f"{_MOST} files are on their way already; send this one when they are here.")
            self._coming += 1
            # the oldest are of pages that were closed: one that is open sends fewer
            too_many = list(self._uploads)[: max(0, len(self._uploads) + self._coming - _MOST)]
        for id in too_many:
            with contextlib.suppress(NotFound):
                self.forget(id)
        path: Path | None = None
        try:
            path = self._new_folder() / harmless(name)
            received = 0
            with path.open("xb") as file:
                async for chunk in chunks:
                    received += len(chunk)
                    self._check_size(received, name)
                    file.write(chunk)
            if stated is not None and received != stated:
                raise InputError(f"{harmless(name)} broke off after {received} bytes; send it again.")
        except BaseException as error:
            if path is not None:
                shutil.rmtree(path.parent, ignore_errors=True)
            if isinstance(error, OSError):
                raise InputError(
                    f"{harmless(name)} cannot be kept ({(error.strerror or str(error)).lower()})."
                ) from None
            raise
        finally:
            with self._lock:
                self._coming -= 1
        return path

    def examine(self, path: Path) -> dict[str, Any]:
        """What a received file is."""
        upload = Upload(path.parent.name, path.name, path, facts_of(path))
        with self._lock:
            self._uploads[upload.id] = upload
        return {"upload": upload.id, "name": upload.name, "bytes": path.stat().st_size, **upload.facts}

    def picture(self, id: str, width: int) -> bytes:
        """The first picture of a video or image as JPEG, at most `width` px wide, to tell the cameras apart by."""
        upload = self._find(id)
        if upload.facts["kind"] not in ("video", "image"):
            raise NotFound(f"{upload.name} has no pictures.")
        with open_video(upload.path) as reader:
            image = reader.read(0)
        height, full = image.shape[:2]
        scale = min(1.0, width / full)
        small = cv2.resize(image, (round(full * scale), max(1, round(height * scale))), interpolation=cv2.INTER_AREA)
        return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()

    def forget(self, id: str) -> None:
        """Remove a file that is not wanted after all."""
        upload = self._find(id)
        with self._lock:
            self._uploads.pop(id, None)
        shutil.rmtree(upload.path.parent, ignore_errors=True)

    def make_recording(self, wanted: Mapping[str, Any]) -> Path:
        """A recording folder of uploads; nothing is left of it when it cannot be used, and the uploads stay. One that
        is still to be calibrated, by the clips of a board, is looked at no further."""
        layout = layout_of(wanted, self._find)
        return self._build(free_folder(self._catalog.root, layout.name), layout)

    def hand_over(self, id: str, folder: Path) -> Path:
        """Put a video or picture into a folder, under a name that is free there; returns where it is."""
        upload = self._find(id)
        if upload.facts["kind"] not in ("video", "image"):
            raise InputError(f"{upload.name} is neither a picture nor a video.")
        if not self._catalog.contains(folder):
            raise InputError(f"{folder.name} is a link that leads out of the served folder; remove it first.")
        folder.mkdir(parents=True, exist_ok=True)
        place, number = folder / upload.name, 2
        while place.exists():
            place, number = folder / f"{number}_{upload.name}", number + 1
        try:
            upload.path.rename(place)
        except OSError as error:
            raise InputError(f"{upload.name} cannot be kept ({(error.strerror or str(error)).lower()}).") from None
        self.forget(id)
        return place

    def close(self) -> None:
        """Remove what was not used."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _new_folder(self) -> Path:
        """A folder for one file, in that of this server, with a random name, which only this user may write to."""
        with self._lock:
            if self._folder is None:
                self._folder = Path(tempfile.mkdtemp(prefix=FOLDER, dir=self._catalog.root))
            return Path(tempfile.mkdtemp(prefix="", dir=self._folder))

    def _build(self, folder: Path, layout: Layout) -> Path:
        done: list[tuple[Path, Path]] = []
        try:
            for id, place in layout.moves.items():
                target = folder / place
                target.parent.mkdir(parents=True, exist_ok=True)
                source = self._find(id).path
                source.rename(target)
                done.append((source, target))
            write_text(folder / "recording.toml", layout.text)
            if layout.calibrated:
                load_recording(folder)
        except (HyposeError, OSError) as error:
            for source, target in done:
                with contextlib.suppress(OSError):
                    target.rename(source)
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, OSError):
                raise InputError(f"{folder.name} cannot be made ({(error.strerror or str(error)).lower()}).") from None
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        for id in layout.moves:
            self.forget(id)
        return folder

    def _find(self, id: str) -> Upload:
        with self._lock:
            if id not in self._uploads:
                raise NotFound("A dropped file is not there any more; drop it again.")
            return self._uploads[id]

    def _check_size(self, size: int, name: str) -> None:
        if size > self.limit:
            raise TooLarge(
                f"{harmless(name)} is larger than {self.limit / 2**30:.3g} GiB; copy it into the folder "
                f"{self._catalog.root.name} by hand, or start `hypose view` with a larger --upload-limit."
            )


def harmless(name: str) -> str:
    """A file name without anything that a system could take for more than a name."""
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in name)[-80:].strip(".")
    return plain if plain and not plain.startswith("-") else f"file_{plain}"


def facts_of(path: Path) -> dict[str, Any]:
    """What a dropped file is, by looking into it; a file that cannot be read as what its ending says is "other"."""
    ending = path.suffix.lower()
    try:
        if ending in VIDEO_ENDINGS or ending in IMAGE_ENDINGS:
            with open_video(path) as reader:
                facts = {"size": list(reader.size), "frames": reader.n_frames, "frame_rate": reader.frame_rate}
            return {"kind": "video" if ending in VIDEO_ENDINGS else "image", **facts}
        if ending in _KEYPOINT_ENDINGS:
            with contextlib.suppress(HyposeError):
                frames = max((len(t.people) for t in read_keypoints(path).values()), default=0)
                if frames:
                    return {"kind": "keypoints", "frames": frames}
        if path.stat().st_size <= _LARGEST_CALIBRATION:
            return {"kind": "calibration", "cameras": list(read_any(path)[0].names)}
    except HyposeError as error:
        return {"kind": "other", "problem": str(error).replace(f"{path.parent}/", "")}
    return {"kind": "other"}
