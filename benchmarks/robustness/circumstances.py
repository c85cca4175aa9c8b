"""What a process finds when it starts: environment and folder, limits of files and memory, permissions, small disks."""

from __future__ import annotations

import ctypes
import os
import resource
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

_NEW_MOUNTS, _NEW_USER = 0x20000, 0x10000000  # CLONE_NEWNS, CLONE_NEWUSER
_PRIVATE = 0x4000 | 1 << 18  # MS_REC | MS_PRIVATE
_DROP_FROM_BOUNDS = 24  # PR_CAPBSET_DROP
_IGNORE_PERMISSIONS = (1, 2)  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
_CAPABILITIES_3 = 0x20080522


@dataclass(frozen=True)
class Circumstances:
    """environment: variables to set, or to remove (None); folder: to work in; file_bytes: no file may grow larger, as
    on a full disk; memory_bytes: of address space; obeys: root obeys the permissions of files, too; small_disk: (an
    existing folder, bytes), on which an empty disk of that size is mounted, seen by this process alone (Linux)."""

    environment: Mapping[str, str | None] = field(default_factory=dict)
    folder: str = ""
    file_bytes: int | None = None
    memory_bytes: int | None = None
    obeys: bool = False
    small_disk: tuple[str, int] | None = None

    def impose(self) -> None:
        """Put the calling process, which should be young and have one thread, into these circumstances; OSError where
        the system does not allow it."""
        for name, value in self.environment.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        tempfile.tempdir = None
        if self.small_disk:
            _mount(*self.small_disk)
        if self.obeys and os.geteuid() == 0:
            _obey_permissions()
        if self.folder:
            os.chdir(self.folder)
        if self.file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (self.file_bytes, self.file_bytes))
        if self.memory_bytes is not None:
            resource.setrlimit(resource.RLIMIT_AS, (self.memory_bytes, self.memory_bytes))

    def as_json(self) -> dict[str, Any]:
        """What `from_json` takes."""
        return asdict(self)

    @classmethod
    def from_json(cls, text: Mapping[str, Any]) -> Circumstances:
        """Circumstances from what `as_json` gave."""
        disk = text["small_disk"]
        return cls(**{**text, "small_disk": disk and tuple(disk)})


USUAL = Circumstances()


def possible(circumstances: Circumstances) -> bool:
    """Whether the system lets us make such circumstances, and they then hold: tried in a process of its own."""
    child = os.fork()
    if not child:
        code = 1
        try:
            circumstances.impose()
            code = int(circumstances.obeys and _writes_where_it_may_not())
        finally:
            os._exit(code)
    return os.waitpid(child, 0)[1] == 0


def _writes_where_it_may_not() -> bool:
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o500)
        try:
            (Path(folder) / "file").touch()
        except PermissionError:
            return False
        finally:
            os.chmod(folder, 0o700)
    return True


def _system(name: str, *arguments: Any) -> None:
    if sys.platform != "linux":
        raise OSError(f"{name} is known on Linux only")
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, name)(*arguments) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{name}: {os.strerror(number)}")


def _mount(folder: str, size: int) -> None:
    user, group = os.geteuid(), os.getegid()
    _system("unshare", _NEW_MOUNTS | (_NEW_USER if user else 0))
    if user:
        for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            Path(f"/proc/self/{name}").write_text(text)
    _system("mount", b"none", b"/", None, _PRIVATE, None)
    _system("mount", b"tmpfs", os.fsencode(folder), b"tmpfs", 0, f"size={size},mode=700".encode())


def _obey_permissions() -> None:
    """For good: in this process and in all that it starts."""
    for power in _IGNORE_PERMISSIONS:
        _system("prctl", _DROP_FROM_BOUNDS, power, 0, 0, 0)
    header = (ctypes.c_uint32 * 2)(_CAPABILITIES_3, 0)
    held = (ctypes.c_uint32 * 6)()  # effective, permitted, inheritable, of the first 32 and of the others
    _system("capget", header, held)
    for k in range(3):
        held[k] &= ~sum(1 << power for power in _IGNORE_PERMISSIONS)
    _system("capset", header, held)
