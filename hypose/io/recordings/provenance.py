"""Where a result comes from: versions, seed, settings and the hashes of its inputs."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from hypose import __version__
from hypose.errors import InputError
from hypose.io.file_names import natural_key
from hypose.io.files import open_file

_FULL_HASH_BYTES = 64 << 20
_ENDS_BYTES = 1 << 20


def provenance(
    recipe: str,
    seed: int | None,
    settings: Mapping[str, Any],
    inputs: Mapping[str, Path],
    run: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Plain JSON values that tell how a result was made.

    recipe; seed; settings (the effective ones); versions of hypose, python, numpy, scipy, numba and opencv;
    inputs: for each its file name, size in bytes, sha256 and what the hash covers (see `file_identity`).
    Everything that may differ between two runs of equal results (the command, the machine, and what the
    caller gives in `run`: times, threads) is under "run", which `save_motion` leaves out.
    """
    return {
        "recipe": recipe,
        "seed": seed,
        "settings": dict(settings),
        "versions": versions(),
        "inputs": {name: file_identity(path) for name, path in inputs.items()},
        "run": {
            "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
            "platform": platform.platform(),
            **(run or {}),
        },
    }


def identity(record: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a provenance that decides the result: all but "run"."""
    return {k: v for k, v in record.items() if k != "run"}


def versions() -> dict[str, str]:
    """Versions of hypose and of the packages that its numbers depend on."""
    out = {"hypose": __version__, "python": platform.python_version()}
    for package in ("numpy", "scipy", "numba", "opencv-python-headless"):
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            out[package] = "not installed"
    return out


def file_identity(path: str | Path) -> dict[str, Any]:
    """name, bytes, sha256 and `hashed` of a file or a folder of files.

    Files under 64 MiB are hashed whole; of larger ones the first and the last MiB and the size, which is
    quick for hours of video and still notices a re-encoded or cut file (`hashed` = "first and last MiB"). A
    folder's hash is that of its files' names and hashes in natural order.
    """
    path = Path(path)
    try:
        if path.is_dir():
            files = sorted((p for p in path.rglob("*") if p.is_file()), key=lambda p: natural_key(p.as_posix()))
            digest, total, partial = hashlib.sha256(), 0, False
            for file in files:
                one = file_identity(file)
                digest.update(f"{file.relative_to(path).as_posix()} {one['bytes']} {one['sha256']}\n".encode())
                total += one["bytes"]
                partial |= one["hashed"] != "all"
            hashed = "first and last MiB of large files" if partial else "all"
            return {
                "name": path.name,
                "files": len(files),
                "bytes": total,
                "sha256": digest.hexdigest(),
                "hashed": hashed,
            }
        with open_file(path, "an input", sys.maxsize, 0) as stream:
            size = os.fstat(stream.fileno()).st_size
            if size < _FULL_HASH_BYTES:
                return {
                    "name": path.name,
                    "bytes": size,
                    "sha256": hashlib.file_digest(stream, "sha256").hexdigest(),
                    "hashed": "all",
                }
            digest = hashlib.sha256(stream.read(_ENDS_BYTES))
            stream.seek(-_ENDS_BYTES, 2)
            digest.update(stream.read(_ENDS_BYTES))
            digest.update(str(size).encode())
            return {
                "name": path.name,
                "bytes": size,
                "sha256": digest.hexdigest(),
                "hashed": "first and last MiB",
            }
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check that it exists.") from None
