"""Recorded skeletons of any known program: which reader takes a file or folder."""

from __future__ import annotations

from pathlib import Path

from hypose.errors import InputError
from hypose.io.sensors.skeleton_folder import read_folder
from hypose.io.sensors.skeleton_lines import read_lines
from hypose.io.sensors.skeleton_streams import SkeletonRecording
from hypose.io.sensors.skeleton_tables import read_kinect_csv, read_ntu


def read_skeletons(path: str | Path) -> SkeletonRecording:
    """Read recorded skeletons in any known form; an InputError says in one sentence what cannot be used.

    A folder with session.json; a folder of NTU .skeleton files, one per camera; .csv or .csv.gz of several Kinects;
    .skeleton; .jsonl or .jsonl.gz.
    """
    p = Path(path)
    if p.is_dir():
        if (p / "session.json").exists():
            return read_folder(p)
        files = sorted(p.glob("*.skeleton"))
        if files:
            return read_ntu(files)
        raise InputError(
            f"The folder {p} has neither session.json nor .skeleton files; give a folder of recorded skeletons."
        )
    if not p.exists():
        raise InputError(f"{p} does not exist; give a folder with session.json, or a .csv, .skeleton or .jsonl file.")
    name = p.name.lower().removesuffix(".gz")
    if name == "session.json":
        return read_folder(p.parent)
    if name.endswith(".csv"):
        return read_kinect_csv(p)
    if name.endswith(".skeleton"):
        return read_ntu([p])
    if name.endswith((".jsonl", ".ndjson")):
        return read_lines(p)
    if name.endswith(".zip"):
        raise InputError(f"{p} is an archive; unpack it and give the folder.")
    raise InputError(
        f"{p} has no known form; give a folder with session.json, or a .csv, .skeleton or .jsonl file (.gz is fine)."
    )
