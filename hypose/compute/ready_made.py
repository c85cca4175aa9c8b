"""Kernels that come with a wheel: compiled when it was built, for a family of processors, in one packed file.

They hold where Python, numba, LLVM, the sources and the family of processors are the same (their names say so, as in
the cache). Elsewhere nobody looks them up, and kernels are compiled as from the sources.
"""

from __future__ import annotations

import io
import os
import platform
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

from hypose.compute.cache_place import note

FILE = Path(__file__).parents[1] / "assets" / "kernels.tar.xz"
_NOTHING: Mapping[str, bytes] = MappingProxyType({})
_FAMILY = "x86-64-v3"
"""Intel since Haswell (2013), AMD since Excavator (2015): 256 bits to a vector, fused products. No slower than code for
the very processor (Zen 4; docs/notebook/speed.md)."""
_OF_FAMILY = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")


def compile_for_family() -> None:
    """Before numba is imported: let it compile for the family that this processor belongs to, if to any, so that what
    one processor has compiled is what others would. Whoever has named a processor, or imported numba, is left alone."""
    import llvmlite.binding

    if (
        platform.machine().lower() not in ("x86_64", "amd64")
        or "NUMBA_CPU_NAME" in os.environ
        or "numba" in sys.modules
    ):
        return
    here = llvmlite.binding.get_host_cpu_features()
    if all(here.get(one) for one in _OF_FAMILY):
        os.environ["NUMBA_CPU_NAME"] = _FAMILY
        os.environ.setdefault("NUMBA_CPU_FEATURES", "")


@cache
def ready_made() -> Mapping[str, bytes]:
    """What came with the wheel, by its name in the cache; nothing where nothing came, or cannot be read."""
    if not os.path.exists(FILE):  # as from the sources
        return _NOTHING
    import lzma  # these two take long to import
    import tarfile

    try:
        with tarfile.open(FILE, "r:xz") as packed:
            return {m.name: f.read() for m in packed if (f := packed.extractfile(m)) is not None}
    except (OSError, EOFError, tarfile.TarError, lzma.LZMAError) as error:
        note(f"The compiled code in {FILE} cannot be read ({error}); it is compiled again.")
        return _NOTHING


def pack(cache_folder: Path, file: Path) -> int:
    """Write all compiled code of a cache into a file; how many files went in."""
    import lzma
    import tarfile

    found = sorted(p for p in cache_folder.glob("kernels-*/*") if p.suffix in (".kernel", ".ready"))
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w", format=tarfile.USTAR_FORMAT) as packed:
        for path in found:
            member = tarfile.TarInfo(path.relative_to(cache_folder).as_posix())
            member.size = path.stat().st_size
            with path.open("rb") as stream:
                packed.addfile(member, stream)
    file.write_bytes(lzma.compress(raw.getvalue(), preset=9 | lzma.PRESET_EXTREME))
    return len(found)
