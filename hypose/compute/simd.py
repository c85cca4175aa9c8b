"""Short vectors in kernels, with Python's operators on all lanes at once, as LLVM vectors for any processor (AVX-512,
AVX2, SSE, NEON). They are used in loops that LLVM does not vectorise itself.

The second operand of an operator may be a number. Nothing is fused except in `times_plus`. Indices are flat, of
contiguous arrays, and are not checked.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.datamodel.registry import register_default
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic

_I32, _I64 = ir.IntType(32), ir.IntType(64)


class Vec(types.Type):
    """Numba type of a vector of n numbers of one type, on which the processor computes in parallel (SIMD)."""

    def __init__(self, dtype: Any, n: int) -> None:
        self.dtype, self.n = dtype, n
        super().__init__(name=f"Vec({dtype}, {n})")


@register_default(Vec)
class _Model(models.PrimitiveModel):
    """How numba stores a vector: as one LLVM vector."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.VectorType(manager.lookup(kind.dtype).get_value_type(), kind.n))


def _is_real(kind: Vec) -> bool:
    """Return whether the numbers of a vector type are floating point."""
    return isinstance(kind.dtype, types.Float)


def _in_all_lanes(builder: Any, value: Any, n: int) -> Any:
    """Return a number as a vector; a vector unchanged.

    builder: LLVM's.
    value: LLVM value, a number or a vector.
    n: number of lanes.
    """
    if isinstance(value.type, ir.VectorType):
        return value
    kind = ir.VectorType(value.type, n)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, _I32(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(_I32, n), [0] * n))


def _calculate(name: str) -> Callable[..., Any]:
    """Make the function that writes an arithmetic instruction (LLVM's name, without the f of floating point)."""

    def code(builder: Any, kind: Vec, a: Any, b: Any) -> Any:
        return getattr(builder, ("f" if _is_real(kind) else "") + name)(a, b)

    return code


def _compare(name: str) -> Callable[..., Any]:
    """Make the function that writes a comparison (`<` or `>`, of signed numbers), which gives one bit per lane."""

    def code(builder: Any, kind: Vec, a: Any, b: Any) -> Any:
        return (builder.fcmp_ordered if _is_real(kind) else builder.icmp_signed)(name, a, b)

    return code


_COMPARED = {operator.lt: "<", operator.gt: ">"}
_OPERATORS: dict[Any, Callable[..., Any]] = {
    operator.add: _calculate("add"),
    operator.sub: _calculate("sub"),
    operator.mul: _calculate("mul"),
    operator.truediv: _calculate("div"),
    operator.and_: lambda builder, _, a, b: builder.and_(a, b),
    operator.or_: lambda builder, _, a, b: builder.or_(a, b),
    **{op: _compare(name) for op, name in _COMPARED.items()},
}


def _operator(op: Any, write: Callable[..., Any]) -> None:
    """Register a Python operator for vectors of one type, and for a vector and a number.

    op: the operator, of the module `operator`.
    write: function (builder, type, a, b) that writes the instruction.
    """

    @infer_global(op)  # pyright: ignore[reportOptionalCall]
    class _(AbstractTemplate):
        key = op

        def generic(self, args: Any, kws: Any) -> Any:
            vectors = [a for a in args if isinstance(a, Vec)]
            if not vectors or any(a != vectors[0] for a in vectors):
                return None
            kind = vectors[0]
            result = Vec(types.boolean, kind.n) if op in _COMPARED else kind
            return signature(result, *(kind if isinstance(a, Vec) else kind.dtype for a in args))

    @lower_builtin(op, Vec, Vec)
    @lower_builtin(op, Vec, types.Number)
    @lower_builtin(op, types.Number, Vec)
    def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = next(a for a in sig.args if isinstance(a, Vec))
        return write(builder, kind, *(_in_all_lanes(builder, a, kind.n) for a in args))


for _op, _write in _OPERATORS.items():
    _operator(_op, _write)


def _chosen(name: str) -> Any:
    """Make the intrinsic (x, limit) that keeps x where `x name limit` holds, and else gives the limit."""

    def choose(typingctx: Any, x, limit):
        def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            limit = _in_all_lanes(builder, args[1], sig.args[0].n)
            return builder.select(_compare(name)(builder, sig.args[0], args[0], limit), args[0], limit)

        return x(x, x if isinstance(limit, Vec) else x.dtype), code

    return intrinsic(choose)


at_least, at_most = _chosen(">"), _chosen("<")
"""(x, limit): the larger (smaller) value in each lane; NaN gives the limit."""


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any, n: int) -> tuple[Any, int]:
    """Compute the address of n elements of an array from a flat index on, and the size of an element in bytes."""
    data = context.make_array(kind)(context, builder, array).data
    size = context.get_abi_sizeof(data.type.pointee)
    return builder.bitcast(builder.gep(data, [index]), ir.VectorType(data.type.pointee, n).as_pointer()), size


@intrinsic(prefer_literal=True)
def load(typingctx: Any, array, index, n):
    """Load n (a constant) elements of an array from an index on.

    array, index: contiguous array, and the flat index.
    """

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place, size = _place(context, builder, sig.args[0], args[0], args[1], sig.return_type.n)
        return builder.load(place, align=size)

    return Vec(array.dtype, n.literal_value)(array, types.int64, n), code


@intrinsic
def store(typingctx: Any, array, index, value):
    """Store the vector `value` into an array, from a flat index on."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place, size = _place(context, builder, sig.args[0], args[0], args[1], sig.args[2].n)
        builder.store(args[2], place, align=size)
        return context.get_dummy_value()

    return types.none(array, types.int64, value), code


@intrinsic(prefer_literal=True)
def splat(typingctx: Any, number, n):
    """Make a vector of n elements (a constant) that all have the value of a number."""
    dtype = types.unliteral(number)
    return Vec(dtype, n.literal_value)(dtype, n), lambda c, b, sig, args: _in_all_lanes(b, args[0], sig.return_type.n)


@intrinsic(prefer_literal=True)
def ramp(typingctx: Any, n):
    """Make the vector 0, 1, ... n - 1 (n a constant) of int32."""
    kind = Vec(types.int32, n.literal_value)
    return kind(n), lambda *_: ir.Constant(ir.VectorType(_I32, kind.n), list(range(kind.n)))


@intrinsic
def where(typingctx: Any, mask, yes, no):
    """Choose element by element between two vectors: `yes` where the mask is true, else `no`."""
    return yes(mask, yes, no), lambda c, b, sig, args: b.select(*args)


@intrinsic
def bits(typingctx: Any, mask):
    """Pack a vector of truth values into one unsigned integer; the first element is the lowest bit."""
    kind = types.Integer.from_bitwidth(max(mask.n, 8), signed=False)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(mask.n)), ir.IntType(kind.bitwidth))

    return kind(mask), code


@intrinsic
def lane(typingctx: Any, x, k):
    """Return the k-th number of a vector."""
    return x.dtype(x, types.int64), lambda c, b, sig, args: b.extract_element(args[0], b.trunc(args[1], _I32))


@intrinsic
def cast(typingctx: Any, x, dtype):
    """Convert a vector of floating-point numbers to whole ones (they are truncated, and must fit), or of signed whole
    numbers to floating point.

    x, dtype: the vector, and the new type (a type of numpy).
    """
    kind = Vec(dtype.dtype, x.n)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return (builder.fptosi if _is_real(x) else builder.sitofp)(args[0], context.get_value_type(kind))

    return kind(x, dtype), code


def _call(builder: Any, name: str, args: Sequence[Any]) -> Any:
    """Write the call of an LLVM intrinsic of float32 vectors."""
    kind = args[0].type
    f = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind] * len(args)), f"llvm.{name}.v{kind.count}f32"
    )
    return builder.call(f, args)


@intrinsic
def ceil(typingctx: Any, x):
    """Round up (float32)."""
    return x(x), lambda c, b, sig, args: _call(b, "ceil", args)


@intrinsic
def times_plus(typingctx: Any, x, y, z):
    """Compute x * y + z (float32), fused where the processor can; y may be a number."""

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, "fmuladd", [_in_all_lanes(builder, a, x.n) for a in args])

    return x(x, y, x), code


@intrinsic
def popcount(typingctx: Any, word):
    """Count the bits that are set in a 64-bit unsigned integer."""
    return types.int64(types.uint64), lambda c, b, sig, args: b.ctpop(args[0])


@intrinsic
def lowest_bit(typingctx: Any, word):
    """Return the number of the lowest set bit of an unsigned integer; for 0 its number of bits."""
    return types.int64(word), lambda c, b, sig, args: b.zext(b.cttz(args[0], ir.IntType(1)(0)), _I64)


@intrinsic
def as_word(typingctx: Any, x):
    """Reinterpret a vector of eight bytes as one 64-bit unsigned integer."""
    return types.uint64(x), lambda c, b, sig, args: b.bitcast(args[0], _I64)


@intrinsic
def as_bytes(typingctx: Any, word):
    """Reinterpret a 64-bit unsigned integer as a vector of eight bytes."""
    kind = Vec(types.uint8, 8)
    return kind(types.uint64), lambda c, b, sig, args: b.bitcast(args[0], c.get_value_type(kind))
