"""Make the site's page of file formats from their tables; nothing of it is kept in docs/."""

from __future__ import annotations

from hypose.io.calibrations.calibration_formats import CALIBRATIONS
from hypose.io.keypoints.keypoint_files import KEYPOINTS
from hypose.io.motions.export import MOTION_FILES
from hypose.io.sensors.skeleton_files import SKELETONS

_HEAD = """# File formats

A file is recognised by its ending and its content.
"""


_TABLES = {
    "Calibrations": CALIBRATIONS,
    "Key points": KEYPOINTS,
    "Motions": MOTION_FILES,
    "Skeletons of sensors": SKELETONS,
}


def formats_page() -> str:
    """Return the page as Markdown: a table for each kind of data."""
    parts = [_HEAD]
    for title, table in _TABLES.items():
        parts.append(f"## {title}\n\n| format | files | read | written | limits |\n| --- | --- | --- | --- | --- |")
        for one in table.formats:
            files = ", ".join({"/": "a folder", "": "no ending"}.get(s, f"`{s}`") for s in one.suffixes)
            read, written = ("yes" if way is not None else "-" for way in (one.read, one.write))
            parts.append(f"| {one.name} | {files} | {read} | {written} | {one.limits or '-'} |")
        parts.append("")
    return "\n".join(parts)
