"""Safe names for files, and comparison of names.

Names of views, cameras, people and sensors come from files of other programs, and a file's name may contain any bytes.
`file_name` makes a file's name of any text, `text_of` makes text of any file's name, and `match_names` finds the names
that mean the same camera.
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

_MOST_BYTES = 100  # in UTF-8; with added parts (a frame's number, an ending) a name still fits into 255
# separators, characters that Windows forbids, ends that it drops, beginnings that hide a file or look like an option
_FORBIDDEN = re.compile(r'[\x00-\x1f\x7f-\x9f\\/:*?"<>|\u2028-\u202e\u2066-\u2069\ud800-\udfff]')
_ENDS = re.compile(r"^[\s.\-~]+|[\s.]+$")
_RESERVED = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?", re.IGNORECASE | re.DOTALL)
_MADE = re.compile(r".*~[0-9a-f]{10}", re.DOTALL)


def file_name(text: str) -> str:
    """Convert any text to a safe name for a file or folder.

    An ordinary name stays as it is. In any other, forbidden characters are replaced and a mark (~ and ten hexadecimal
    digits of a hash) is added, so that different texts get different names. The same text always gives the same name.

    Returns: at most 112 bytes in UTF-8, without separators, control characters, leading dots or dashes, or device names
        of Windows.
    """
    plain = _ENDS.sub("", _FORBIDDEN.sub("_", text))
    if plain == text and text and len(text.encode()) <= _MOST_BYTES and not _RESERVED.fullmatch(text):
        if not _MADE.fullmatch(text):  # otherwise it could equal the name made of another text
            return text
    short = plain.encode()[:_MOST_BYTES].decode(errors="ignore") or "_"
    mark = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:10]
    return f"{'_' if _RESERVED.fullmatch(short) else ''}{short}~{mark}"


def folder_for(folder: str | Path, text: str) -> Path:
    """Make the subfolder named after a text, where it does not exist yet.

    folder: the parent folder.
    text: any text; `file_name` makes the folder's name of it.
    Raises: InputError where the folder cannot be made or is a link that leads out of the parent folder.
    """
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


def free_path(parent: Path, name: str, ending: str = "") -> Path:
    """Return parent/name with an ending, or the first free numbered name: walk, walk-2, walk-3."""
    numbered = re.fullmatch(r"(.+)-(\d{1,4})", name)
    stem, number = (numbered[1], int(numbered[2]) + 1) if numbered else (name, 2)
    path = parent / f"{name}{ending}"
    while path.exists():
        path, number = parent / f"{stem}-{number}{ending}", number + 1
    return path


def text_of(name: str | Path) -> str:
    """Convert a file's name to printable text; bytes that are not UTF-8 become escapes."""
    return visible(os.fspath(name))


@contextlib.contextmanager
def utf8_path(path: Path) -> Iterator[str]:
    """Provide a UTF-8 path of an existing file within a with block.

    It is the path itself or, where that is not UTF-8, a temporary link to the file.

    Raises: InputError where the link cannot be made.
    Why: OpenCV ends the whole process at a path that is not UTF-8.
    """
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
    """Find, for each wanted name, the available name of the same camera.

    Three rules are tried in this order: the same name; the same letters and digits without decoration (cam01_json,
    ext_cam01_img, Cam-01); the same last number.

    Returns: for each wanted name an index into `available`; None where no unique name fits.
    """

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
    """Make a sort key that puts cam2 before cam10."""
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p.lower()) for p in re.split(r"(\d+)", name) if p]


def _bare(name: str) -> str:
    return "".join(c for c in re.sub(r"(^(ext|int)_|_(json|img|imgs|ext)$)", "", name.lower()) if c.isalnum())


def last_number(name: str) -> int | None:
    """Extract the last number of a name (cam_01 -> 1, trial2_cam03 -> 3).

    Returns: None without a number, or where it has more than 15 digits.
    """
    digits = re.findall(r"[0-9]+", name)
    return int(digits[-1]) if digits and len(digits[-1]) <= 15 else None
