"""numba: sums of rows as vector instructions: the compiler makes none of the sums in a fixed order of cpu_cholesky.dot.

EIGHT partial sums are kept beside each other and added in the order of `dot`, so the bits are the same as there, on
every processor (LLVM intermediate code; products are not fused with sums).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

EIGHT = 8
SUMS = 27
"""of a joint: for each of the six parts x of a wrench w x . y with the parts y up to it, and w x . residual"""

_DOUBLE, _I64 = ir.DoubleType(), ir.IntType(64)
_DOUBLES = ir.VectorType(_DOUBLE, EIGHT)


def _added(builder: Any, value: Any) -> Any:
    """The eight partial sums as one, in the order of `dot`."""
    nothing = ir.Constant(_DOUBLES, ir.Undefined)
    halves = [
        builder.shuffle_vector(value, nothing, ir.Constant(ir.VectorType(ir.IntType(32), 4), list(range(k, k + 4))))
        for k in (0, 4)
    ]
    four = builder.fadd(*halves)
    a, b, c, d = (builder.extract_element(four, ir.IntType(32)(k)) for k in range(4))
    return builder.fadd(builder.fadd(a, b), builder.fadd(c, d))


@intrinsic
def wrench_sums(typingctx: Any, lanes, row, first, last, sums):
    """sums (SUMS,) of the columns first..last, a multiple of EIGHT, of lanes (9, row) f8: wrench (6), weight w,
    residual, scratch. In the order x y: w x . y for y = 0..x, then w x . residual, for x = 0..5."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        out = context.make_array(signature.args[4])(context, builder, args[4]).data
        _, row, first, last, _ = args

        def load(line: int, column: Any) -> Any:
            place = builder.gep(data, [builder.add(builder.mul(row, _I64(line)), column)])
            return builder.load(builder.bitcast(place, _DOUBLES.as_pointer()), align=8)

        n = 0
        for x in range(6):
            others = [*range(x + 1), 7]
            zero = ir.Constant(_DOUBLES, [0.0] * EIGHT)
            totals = [cgutils.alloca_once_value(builder, zero) for _ in others]
            for total in totals:  # a value given where it is made is given once, not for every joint
                builder.store(zero, total)
            with cgutils.for_range_slice(builder, first, last, _I64(EIGHT), intp=_I64) as (column, _):
                weighted = builder.fmul(load(6, column), load(x, column))
                for total, y in zip(totals, others, strict=True):
                    product = builder.fmul(weighted, load(y, column))
                    builder.store(builder.fadd(builder.load(total), product), total)
            for total in totals:
                builder.store(_added(builder, builder.load(total)), builder.gep(out, [_I64(n)]))
                n += 1
        return context.get_dummy_value()

    i8 = types.int64
    return types.none(lanes, i8, i8, i8, sums), code
