"""What numba does over again for each function, or for a use that kernels have not: left out while kernels compile.

A kernel is some dozens of functions, and numba takes twice as long over them in Python as LLVM over all of their code.
What is made is the same.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from numba.core import typed_passes, untyped_passes
from numba.core.compiler_machinery import AnalysisPass, PassManager, register_pass
from numba.core.cpu import CPUContext
from numba.core.ir import Assign, Expr, SetItem, StaticSetItem
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.transforms import canonicalize_cfg
from numba.core.types import Array, BaseFunction, BaseTuple, Boolean, Number
from numba.core.typing.context import Context
from numba.np import arrayobj

_PLAIN = (Number, Boolean, Array, BaseTuple)
_in_place: list[None] = []


@contextlib.contextmanager
def lean(is_inner: Callable[[Any], bool]) -> Iterator[None]:
    """Compile with less, whoever holds numba's lock; is_inner: whether Python will never call a library's functions."""
    if _in_place:
        yield
        return
    before = [(owner, name, getattr(owner, name)) for owner, name in _REPLACED]
    _in_place.append(None)
    try:
        for owner, name, was in before:
            setattr(owner, name, _REPLACED[owner, name](was, is_inner))
        yield
    finally:
        for owner, name, was in before:
            setattr(owner, name, was)
        _in_place.pop()


@register_pass(mutates_CFG=False, analysis_only=False)
class Borrowed(AnalysisPass):
    """Counts no references in a function that neither makes arrays nor gives one back: all are its caller's."""

    _name = "hypose_borrowed"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> Any:
        """Not for what Python calls: its arrays come with references."""
        models, kinds = state.targetctx.data_model_manager, state.typemap

        def counted(name: str) -> bool:
            return models[kinds[name]].contains_nrt_meminfo()

        def makes(line: Any) -> bool:
            if isinstance(line, (SetItem, StaticSetItem)):  # of a whole array numba may make a copy
                return counted(line.value.name)
            if not isinstance(line, Assign) or not isinstance(line.value, Expr) or not counted(line.target.name):
                return False
            # what is looked up in an array is a part of it, but for what an array of places picks out; a tuple of
            # what is the caller's is as good as that
            operation = line.value
            return operation.op not in _LOOKED_UP or (operation.op == "getitem" and counted(operation.index.name))

        lines = (line for block in state.func_ir.blocks.values() for line in block.body)
        # what is given back is one reference more, whoever made it
        gives = models[state.return_type].contains_nrt_meminfo()
        if state.library is None and not gives and not any(map(makes, lines)):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        return False


_LOOKED_UP = frozenset({"getattr", "getitem", "static_getitem", "cast", "build_tuple", "exhaust_iter"})


class _Passes(PassManager):
    """Passes one after the other, without numba's report of each."""

    def run(self, state: Any) -> None:
        for kind, _ in self.passes:
            one = kind()
            one.analysis = self._analysis
            one.run_pass(state)


def passes(state: Any) -> PassManager:
    """numba's way from a function to LLVM's language, without what only closures, contexts and generators need."""
    made = _Passes("kernel")
    for one in _PASSES:
        made.add_pass(one)
    made.finalize()
    return made


_PASSES = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.InlineInlinables,
    untyped_passes.DeadBranchPrune,
    untyped_passes.ReconstructSSA,
    untyped_passes.DeadBranchPrune,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.NopythonRewrites,
    Borrowed,
    typed_passes.NoPythonSupportedFeatureValidation,
    typed_passes.IRLegalization,
    typed_passes.AnnotateTypes,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)


def _call_type(asked: Callable[..., Any], _: Any) -> Callable[..., Any]:
    """What a function of numba's gives for numbers and arrays is found by trying all of its forms: once for each."""

    def get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or not all(isinstance(a, _PLAIN) for a in args):
            return asked(self, context, args, kws)
        given = self.__dict__.setdefault("_given", {})
        found = given.get(args)
        if found is None:
            found = given[args] = asked(self, context, args, kws)
        return found

    return get_call_type


def _known(asked: Callable[..., Any], _: Any) -> Callable[..., None]:
    """Where numba's own functions are written down is imported by then, so that only what is new there is taken."""

    def load_additional_registries(self: Any) -> None:
        for registry in tuple(self._registries):
            self.install_registry(registry)

    return load_additional_registries


def _way_in(asked: Callable[..., Any], is_inner: Callable[[Any], bool]) -> Callable[..., Any]:
    """The ways into a function from Python and C, which numba makes for its own functions, too."""

    def create_wrapper(self: Any, library: Any, *rest: Any, **named: Any) -> Any:
        return None if is_inner(library) else asked(self, library, *rest, **named)

    return create_wrapper


def _lifetimes(asked: Callable[..., Any], _: Any) -> Callable[..., None]:
    """The lives of variables, after each of some twenty passes; but for generators they are read after the last."""

    def run(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
        code = self.func_ir
        if code.is_generator:
            asked(self, emit_dels, extend_lifetimes)
            return
        code.blocks = canonicalize_cfg(code.blocks)
        code.variable_lifetime, code.generator_info = VariableLifetime(code.blocks), None
        if emit_dels:
            self._insert_var_dels(extend_lifetimes=extend_lifetimes)

    return run


def _implementation(asked: Callable[..., Any], _: Any) -> Callable[..., Any]:
    """That there is no way to make an array of an array, which numba looks for whenever one is indexed."""
    missing: set[Any] = set()

    def get_function(self: Any, fn: Any, sig: Any, _firstcall: bool = True) -> Any:
        if not isinstance(fn, str):
            return asked(self, fn, sig, _firstcall)
        if (fn, sig.args) in missing:
            raise NotImplementedError(f"No definition for lowering {fn}{sig}")
        try:
            return asked(self, fn, sig, _firstcall)
        except NotImplementedError:
            missing.add((fn, sig.args))
            raise

    return get_function


def _array_class(asked: Callable[..., Any], _: Any) -> Callable[..., Any]:
    """A class for each type of arrays, which numba makes whenever one is indexed."""
    return cache(asked)


_REPLACED: dict[tuple[Any, str], Callable[..., Any]] = {
    (BaseFunction, "get_call_type"): _call_type,
    (CPUContext, "load_additional_registries"): _known,
    (Context, "load_additional_registries"): _known,
    (CPUContext, "create_cpython_wrapper"): _way_in,
    (CPUContext, "create_cfunc_wrapper"): _way_in,
    (CPUContext, "get_function"): _implementation,
    (PostProcessor, "run"): _lifetimes,
    (arrayobj, "make_array"): _array_class,
}
