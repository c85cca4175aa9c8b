"""How a function becomes a kernel: numba with one set of options, and a cache on disk that may fail without harm.

numba's own cache takes its files on trust: without a folder that can be written nothing runs at all, a damaged file
ends the process, and after an edit of a kernel that another file calls the caller goes on running the old one. Here a
cache that cannot be written, read or trusted costs time, never a run. The files are keyed by the sources of the kernel
and of all it calls, by numba, Python and the family of processors, and are read only when their checksum holds; what a
wheel brings along (`ready_made`) is found by the same names.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import stat
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from pickle import loads
from typing import Any

from hypose.compute.cache_place import cache_folder, note
from hypose.compute.ready_made import compile_for_family, ready_made

# Intel's vector mathematics is there on some machines only, and its last digits differ from the C library's
os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
compile_for_family()

import llvmlite  # noqa: E402
import numba  # noqa: E402
from llvmlite.binding import Linkage  # noqa: E402
from numba.core.caching import NullCache  # noqa: E402
from numba.core.codegen import JITCodeLibrary  # noqa: E402
from numba.core.compiler import Compiler, CompileResult  # noqa: E402
from numba.core.registry import cpu_target  # noqa: E402
from numba.core.runtime.nrt import rtsys  # noqa: E402
from numba.core.serialize import dumps  # noqa: E402
from numba.core.sigutils import normalize_signature  # noqa: E402
from numba.core.types import unliteral  # noqa: E402

_MAGIC = b"hypose kernel 2\n"
_DIGEST = 32
_UNUSED_DAYS = 60
_IMPORT = re.compile(r"^ *from (hypose\.compute\.[\w.]+) import", re.MULTILINE)


def kernel(function: Callable[..., Any] | None = None, *, inline: bool = False) -> Any:
    """Compile a function with numba when it is first called, or take what an earlier process has compiled.

    Without fast-math: sums keep their order and products are not fused with them, whatever the width of the
    processor's vectors, so that every processor finds the same pose, bit by bit.
    inline: put its code where it is called (small functions that are called in loops).
    """
    if function is None:
        return partial(kernel, inline=inline)
    options: dict[str, Any] = dict(nogil=True, boundscheck=False, error_model="numpy", no_cfunc_wrapper=True)
    options["inline"] = "always" if inline else "never"
    compiled = numba.njit(**options, pipeline_class=_Compiler)(function)
    inner = numba.njit(**options, no_cpython_wrapper=True, pipeline_class=_InnerCompiler)(function)
    compiled._cache = KernelCache(function)
    ask = compiled.get_call_template

    def for_kernels(args: Any, kws: Any) -> Any:
        """What a kernel calls: of constants their types alone, and, unless there is one, without the way in from
        Python, each of which would be compiled."""
        plain = tuple(map(unliteral, args)), {k: unliteral(v) for k, v in kws.items()}
        known = made_here(tuple(compiled._compiler.fold_argument_types(*plain)[1]))
        return (ask if known else inner.get_call_template)(*plain)

    def overload(sig: Any) -> Any:
        args = tuple(normalize_signature(sig)[0])
        return (compiled if made_here(args) else inner).overloads[args].entry_point

    def made_here(args: tuple[Any, ...]) -> bool:
        """What comes from disk is machine code alone, which cannot become a part of a caller."""
        found = compiled.overloads.get(args)
        return found is not None and isinstance(found.library, _Code)

    compiled.get_call_template, compiled.get_overload = for_kernels, overload
    return compiled


class _Code(JITCodeLibrary):
    """A kernel's code, with that of all it calls, made better once, as a whole; numba would begin with each piece."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)

    def serialize_using_object_code(self) -> Any:
        """Machine code and the names of what is in it; numba would keep LLVM's language, too, which takes longest to
        read."""
        self._ensure_finalized()
        everything = (*self._final_module.functions, *self._final_module.global_variables)
        names = [one.name for one in everything if not one.is_declaration]
        return self.name, "object", (self._get_compiled_object(), names)

    def finalize(self) -> None:
        """Take in all that is called, directly or not, each once; numba would copy it into each of its callers."""
        self._linking_libraries = list(map(_alone, _callers_first(self)))
        super().finalize()


class _KeptCode(JITCodeLibrary):
    """The machine code of a kernel, as `_Code` gives it away."""

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> _KeptCode:
        name, _, (code, names) = state
        made = cls(codegen, name)
        made.enable_object_caching()
        made._set_compiled_object(code)
        made._finalize_final_module()
        codegen._engine._defined_symbols.update(names)
        return made


class _InnerCode(_Code):
    """What kernels take into their own code: no machine code is made of it, in which numba could set anything."""

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, env_name: str, env: Any) -> None:
        pass

    def finalize(self) -> None:
        """Nothing is taken in here: kernels take what this calls, too."""
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalize_dynamic_globals()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """With all that it calls: numba's own functions are known to it from now on, and code that is no kernel takes
        what it calls itself and nothing beyond."""
        if self._shared_module is None:
            self._ensure_finalized()
            self._shared_module = self._final_module.clone()
            for called in map(_alone, _callers_first(self)):
                self._shared_module.link_in(called._get_module_for_linking(), preserve=True)
        return self._shared_module


class _Alone:
    """An _InnerCode without what it calls."""

    def __init__(self, code: _InnerCode) -> None:
        self._code, self._reload_init = code, code._reload_init

    def _get_module_for_linking(self) -> Any:
        self._code._ensure_finalized()
        return self._code._final_module


def _alone(code: Any) -> Any:
    return _Alone(code) if isinstance(code, _InnerCode) else code


def _callers_first(code: _Code) -> list[Any]:
    """All code that a kernel calls, directly or not; what is called after whoever calls it, or LLVM would leave it
    out."""
    found: dict[Any, None] = {}

    def look(library: Any) -> None:
        for called in library._linking_libraries:
            if called not in found:
                if isinstance(called, _InnerCode):
                    look(called)
                found[called] = None

    look(code)
    return list(reversed(found))


class _InnerCompiler(Compiler):
    def define_pipelines(self) -> list[Any]:
        """How a kernel is made, and each function that it calls, but for numba's own."""
        from hypose.compute.lean_numba import passes  # which takes much of numba that is not needed to load kernels

        return [passes(self.state)]


class _Compiler(_InnerCompiler):
    def compile_extra(self, func: Callable[..., Any]) -> CompileResult:
        """Compile a Python function; all that it calls, numba's own functions too, becomes a part of it."""
        from hypose.compute.lean_numba import lean

        codegen = self.state.targetctx.codegen()
        self.state.library = _Code(codegen, func.__qualname__)
        self.state.library.enable_object_caching()
        with _libraries(codegen, _InnerCode), lean(lambda library: isinstance(library, _InnerCode)):
            return super().compile_extra(func)


@contextlib.contextmanager
def _libraries(codegen: Any, kind: type[JITCodeLibrary]) -> Iterator[None]:
    """Have numba make its libraries of this kind."""
    before, codegen._library_class = codegen._library_class, kind
    try:
        yield
    finally:
        codegen._library_class = before


class KernelCache(NullCache):
    """numba's interface of a cache, for one kernel: one file per signature and family of processors.

    Nothing here raises: what cannot be read is compiled, what cannot be written is compiled again the next time.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel compiled for a signature, or None."""
        # what is loaded needs no more of numba; the rest, a tenth of a second, whoever compiles loads by himself
        rtsys.initialize(target_context)
        name = self._name(sig, target_context.codegen())
        if name is None:
            return None
        data, path = _found(name)
        if data is None:
            return None
        payload = data[len(_MAGIC) + _DIGEST :]
        if data != _sealed(payload):
            return self._damaged(path)
        try:
            # numba keeps kernels in no other form than as pickles; a private folder and the checksum vouch for this one
            with _libraries(target_context.codegen(), _KeptCode):
                found = CompileResult._rebuild(target_context, *loads(payload))  # noqa: S301
        except Exception:  # sound, but not what this numba makes of it
            return self._damaged(path)
        if path is not None:
            with contextlib.suppress(OSError):
                os.utime(path)
        return found

    def save_overload(self, sig: Any, cres: Any) -> None:
        """Keep a compiled kernel, unless it holds what is true in this process only."""
        if cres.library.has_dynamic_globals or any(not lifted.can_cache for lifted in cres.lifted):
            return
        place, name = cache_folder(), self._name(sig, cres.codegen)
        if place is None or name is None:
            _not_kept.append(self._function.__name__)
            return
        path = place / name
        temporary = path.with_name(f"{uuid.uuid4().hex[:16]}.tmp")
        try:
            _folder_for_writing(path.parent)
            # no listing of types, and no environments of what it calls: a kernel has none when it is compiled either
            *all_else, _ = cres._replace(type_annotation="")._reduce()
            temporary.write_bytes(_sealed(dumps((*all_else, ()))))
            os.replace(temporary, path)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            _not_kept.append(self._function.__name__)
            reason = (error.strerror or str(error)).lower()
            note(f"Compiled code cannot be kept in {path.parent} ({reason}); the next start compiles it again.")

    def _damaged(self, path: Path | None) -> None:
        if path is None:
            return  # in what came with the wheel
        note(f"Damaged files of compiled code in {path.parent} are thrown away and compiled again.")
        with contextlib.suppress(OSError):
            path.unlink()

    def _name(self, sig: Any, codegen: Any) -> str | None:
        """In a cache; None without sources."""
        sources = _digest_of_sources(self._function.__module__)
        if sources is None:
            return None
        name = f"{self._function.__module__.rpartition('.')[2]}.{self._function.__qualname__}"
        line = self._function.__code__.co_firstlineno
        key = repr((sources, name, line, sig, codegen.magic_tuple(), sys.byteorder, sys.maxsize))
        return f"{_VERSIONS}/{name}-{hashlib.sha256(key.encode()).hexdigest()[:24]}.kernel"


def _found(name: str) -> tuple[bytes | None, Path | None]:
    """What is in a file of compiled code, and which file of the cache it is, if it is there."""
    place = cache_folder()
    if place is not None:
        path = place / name
        try:
            return path.read_bytes(), path
        except FileNotFoundError:
            pass
        except OSError as error:
            note(f"Compiled code in {path.parent} cannot be read ({error.strerror}); it is compiled again.")
    return ready_made().get(name), None


def is_ready(part: str) -> bool:
    """Whether all kernels of a part of the room have been kept, or came along: a file tells, by being there."""
    place, name = cache_folder(), _mark(part)
    # os.path.exists is False where we may not look
    return place is not None and os.path.exists(place / name) or name in ready_made()


def note_ready(part: str) -> None:
    """Leave that file, for who comes later."""
    place = cache_folder()
    if place is not None:
        with contextlib.suppress(OSError):
            (place / _mark(part)).touch()


def _mark(part: str) -> str:
    processor = cpu_target.target_context.codegen().magic_tuple()
    key = repr((_digest_of_room(Path(__file__).parent), part, processor))
    return f"{_VERSIONS}/{part}-{hashlib.sha256(key.encode()).hexdigest()[:24]}.ready"


def can_keep() -> bool:
    """Whether other processes will find what is compiled now."""
    place = cache_folder()
    if place is None:
        return False
    try:
        _folder_for_writing(place / _VERSIONS)
        tempfile.TemporaryFile(dir=place / _VERSIONS).close()
    except OSError:
        return False
    return True


def not_kept() -> int:
    """How many kernels this process has compiled and could not keep."""
    return len(_not_kept)


_not_kept: list[str] = []


_VERSIONS = (
    f"kernels-{sys.implementation.cache_tag}{getattr(sys, 'abiflags', '')}"
    f"-numba{numba.__version__}-llvmlite{llvmlite.__version__}"
)


def _sealed(payload: bytes) -> bytes:
    return _MAGIC + hashlib.sha256(payload).digest() + payload


@cache
def _folder_for_writing(folder: Path) -> None:
    """Make the folder of these versions, for whom the cache is for, and forget what nobody has used for long, of other
    versions too."""
    if not folder.is_dir():
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with contextlib.suppress(OSError):  # somebody else has made it in this moment
            folder.chmod(stat.S_IMODE(folder.parent.stat().st_mode))
    oldest = time.time() - _UNUSED_DAYS * 86400
    for path in folder.parent.glob("kernels-*/*"):
        with contextlib.suppress(OSError):
            if path.stat().st_mtime < oldest:
                path.unlink()


@cache
def _digest_of_room(room: Path) -> str:
    return hashlib.sha256(b"\0".join(p.read_bytes() for p in sorted(room.rglob("*.py")))).hexdigest()


@cache
def _digest_of_sources(module: str) -> str | None:
    """Of a module of kernels and all modules of this room that it imports, directly or not; None without sources."""
    root = Path(__file__).parents[2]
    texts: dict[str, bytes] = {}
    left = [module]
    try:
        while left:
            name = left.pop()
            texts[name] = (root / (name.replace(".", "/") + ".py")).read_bytes()
            left += [m for m in _IMPORT.findall(texts[name].decode()) if m not in texts]
    except (OSError, ValueError):
        return None
    return hashlib.sha256(b"\0".join(name.encode() + b"\0" + texts[name] for name in sorted(texts))).hexdigest()
