"""Files' names out of foreign text, and text out of foreign files' names.

Names of views, cameras, persons and sensors come from files that anybody may have written, and names of files are bytes
that need not be text. Whatever is named after the one or shown of the other goes through here.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hypose.errors import InputError, visible

_MOST_BYTES = 100  # in UTF-8; parts added around a name (a frame's number, an ending) fits into 255, too
# separators and what Windows forbids, the ends it drops, and beginnings that hide a file or make it an option
_FORBIDDEN = re.compile(r'[\x00-\x1f\x7f-\x9f\\/:*?"<>|\u2028-\u202e\u2066-\u2069\ud800-\udfff]')
_ENDS = re.compile(r"^[\s.\-~]+|[\s.]+$")
_RESERVED = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?", re.IGNORECASE | re.DOTALL)
_MADE = re.compile(r".*~[0-9a-f]{10}", re.DOTALL)


def file_name(text: str) -> str:
    """A name for a file or folder, made of any text: an ordinary name as it is; of others the harmless characters, and
    a mark (~ and ten hexadecimal digits) that tells different texts apart.

    The same text gives the same name everywhere. It means nothing else to any system: no separators, control
    characters, leading dots or dashes, no device of Windows; at most 112 bytes in UTF-8.
    """
    plain = _ENDS.sub("", _FORBIDDEN.sub("_", text))
    if plain == text and text and len(text.encode()) <= _MOST_BYTES and not _RESERVED.fullmatch(text):
        if not _MADE.fullmatch(text):  # else it could be the name that another text gets
            return text
    short = plain.encode()[:_MOST_BYTES].decode(errors="ignore") or "_"
    mark = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:10]
    return f"{'_' if _RESERVED.fullmatch(short) else ''}{short}~{mark}"


def folder_for(folder: str | Path, text: str) -> Path:
    """The folder named after a foreign text in a folder, made if needed; an InputError when what lies there is a link
    that leads out of the folder, or cannot be made."""
    path = Path(folder) / file_name(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
        inside = path.resolve().is_relative_to(path.parent.resolve())
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"The folder {path} cannot be made ({reason}); choose another folder with --out.") from None
    if not inside:
        raise InputError(
            f"{path} is a link that leads out of {path.parent}, and nothing is written there; remove it, or choose "
            "another folder with --out."
        )
    return path


def text_of(name: str | Path) -> str:
    """A file's name as text that can be written, compared and shown: bytes that are no UTF-8 become escapes."""
    return visible(os.fspath(name))


@contextlib.contextmanager
def utf8_path(path: Path) -> Iterator[str]:
    """A path of an existing file for libraries that take UTF-8 only (OpenCV is killed by any other): the path itself,
    else that of a link to it, which is gone after the block. An InputError when no link can be made."""
    if os.fsencode(path) == os.fspath(path).encode("utf-8", "surrogatepass"):
        yield os.fspath(path)
        return
    refusal = InputError(f"The name of {path} is not UTF-8; rename the file or the folder it lies in.")
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hypose-", ignore_cleanup_errors=True))
            link = os.path.join(folder, "file" + text_of(path.suffix))
            link.encode()
            os.symlink(path.absolute(), link)
        except (OSError, UnicodeEncodeError):
            raise refusal from None
        yield link


# ---- matching names ------------------------------------------------------------------------------------------------
# Names of views, cameras, files and folders that mean the same camera.


def match_names(wanted: Sequence[str], available: Sequence[str]) -> list[int | None]:
    """Index in `available` for each wanted name: the same name; else the same letters and digits without
    decoration (cam01_json, ext_cam01_img, Cam-01); else the only one with the same number. None where nothing
    fits uniquely."""

    def unique(key: Any) -> list[int | None]:
        keys = [key(a) for a in available]
        counts = [key(w) for w in wanted]
        return [
            keys.index(k) if k not in (None, "") and keys.count(k) == 1 and counts.count(k) == 1 else None
            for k in counts
        ]

    out: list[int | None] = [None] * len(wanted)
    for key in (lambda n: n, _bare, last_number):
        for i, found in enumerate(unique(key)):
            if out[i] is None and found is not None and found not in out:
                out[i] = found
    return out


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key under which cam2 comes before cam10."""
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p.lower()) for p in re.split(r"(\d+)", name) if p]


def _bare(name: str) -> str:
    return "".join(c for c in re.sub(r"(^(ext|int)_|_(json|img|imgs|ext)$)", "", name.lower()) if c.isalnum())


def last_number(name: str) -> int | None:
    """The last number of a name (cam_01 -> 1, trial2_cam03 -> 3); None without one, or with one of more than 15
    digits."""
    digits = re.findall(r"[0-9]+", name)
    return int(digits[-1]) if digits and len(digits[-1]) <= 15 else None
