"""Dropped folders: pictures, masks or key points of which there is a file per frame, sent as one tar archive."""

from __future__ import annotations

import tarfile
from pathlib import Path
from typing import Any

from hypose.errors import HyposeError, InputError
from hypose.io.keypoints.read_keypoints import read_keypoints
from hypose.io.videos.video import IMAGE_ENDINGS, list_images, open_video

_MOST = 100_000
"""Files that a folder may hold."""
_KEYPOINT_ENDINGS = (".json", ".txt")


def unpack(archive: Path, folder: Path, limit: int) -> None:
    """Write the files of a tar archive into a new folder, under their bare names; limit: bytes of all of them. Nothing
    but plain files is taken, none leaves the folder, and none is written over another."""
    folder.mkdir()
    bytes_so_far, names = 0, set[str]()
    try:
        with tarfile.open(archive, "r:") as tar:
            for member in tar:
                name = Path(member.name).name
                if not member.isfile() or not _is_plain(name) or name in names:
                    raise InputError(f"The folder {folder.name} holds {name[:40]!r}, which cannot be taken.")
                names.add(name)
                bytes_so_far += member.size
                if len(names) > _MOST or bytes_so_far > limit:
                    raise InputError(
                        f"The folder {folder.name} holds too much; copy it into the served folder by hand."
                    )
                source = tar.extractfile(member)
                assert source is not None
                with source, (folder / name).open("wb") as file:
                    while piece := source.read(1 << 20):
                        file.write(piece)
    except (tarfile.TarError, EOFError, OSError) as error:
        raise InputError(f"The folder {folder.name} did not arrive whole ({error}); drop it again.") from None


def facts_of_folder(folder: Path) -> dict[str, Any]:
    """What a dropped folder holds: pictures, or key points; "other" where it is neither."""
    names = [p.suffix.lower() for p in folder.iterdir()]
    try:
        if names and all(n in IMAGE_ENDINGS for n in names):
            with open_video(folder) as reader:
                return {"kind": "images", "size": list(reader.size), "frames": len(list_images(folder))}
        if names and all(n in _KEYPOINT_ENDINGS for n in names):
            return keypoint_facts(folder)
    except HyposeError as error:
        return {"kind": "other", "problem": str(error).replace(f"{folder.parent}/", "")}
    return {"kind": "other", "problem": f"{folder.name} holds files of several kinds; it is not used."}


def keypoint_facts(path: Path) -> dict[str, Any]:
    """What a file or folder of key points holds; an InputError where it is none."""
    tables = read_keypoints(path)
    frames = max((len(t.people) for t in tables.values()), default=0)
    if not frames:
        raise InputError(f"{path.name} holds no key points.")
    return {"kind": "keypoints", "frames": frames}


def _is_plain(name: str) -> bool:
    return name.isprintable() and 0 < len(name) <= 200 and not name.startswith(".") and "\\" not in name
