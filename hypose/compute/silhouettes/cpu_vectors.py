"""numba: the inner steps of the silhouette scorer as explicit vector instructions, because the compiler does not
vectorize them reliably (LLVM intermediate code, so for any processor: AVX-512, AVX2, SSE, NEON).

A block holds LANES particles; an array of per-vertex values is (V, LANES), so one load fetches the value of one vertex
for all particles. Every lane computes the same bits, on every processor.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from hypose.compute.vector_code import Arrays, Vector, constant, splat

LANES = 16
"""Particles per block; one AVX-512 register of float32."""
STRIP = 64
"""Image columns per strip of the counting pass; one AVX-512 register of int8."""
GUARD = 64
"""Running counts beyond +-GUARD leave the int8 path; steps of one pixel are kept below it, so none can jump past."""

_FLOAT, _BYTE, _I16, _I32, _I64 = ir.FloatType(), ir.IntType(8), ir.IntType(16), ir.IntType(32), ir.IntType(64)
_FLOATS = ir.VectorType(_FLOAT, LANES)
_INTS = ir.VectorType(_I32, LANES)
_BYTES = ir.VectorType(_BYTE, STRIP)


@intrinsic
def skin_vertex(typingctx: Any, maps, joint, weight, first, end, x, y, z, out, vertex):
    """Linear blend skinning of one vertex x, y, z (f4) in all lanes: influences first..end of joint (i4), weight (f4);
    maps (J, 12, LANES) f4 rows of the (3, 4) maps; into row vertex of out (V, 3, LANES) f4."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        zero = constant(builder, _FLOATS, [0.0] * LANES)
        sums = [cgutils.alloca_once_value(builder, zero.v) for _ in range(3)]
        with cgutils.for_range_slice(builder, args[3], args[4], _I64(1), intp=_I64) as (k, _):
            w = at.scalar(2, k)
            factors = [splat(builder, builder.fmul(w, p), _FLOATS) for p in args[5:8]] + [splat(builder, w, _FLOATS)]
            base = builder.mul(builder.sext(at.scalar(1, k), _I64), _I64(12 * LANES))
            for i, total in enumerate(sums):
                value = Vector(builder, builder.load(total))
                for c, factor in enumerate(factors):
                    m = at.load(0, builder.add(base, _I64((4 * i + c) * LANES)), _FLOATS)
                    value = m.times_plus(factor, value)
                builder.store(value.v, total)
        row = builder.mul(args[9], _I64(3 * LANES))
        for i, total in enumerate(sums):
            at.store(Vector(builder, builder.load(total)), 8, builder.add(row, _I64(i * LANES)))
        return context.get_dummy_value()

    i8, f4 = types.int64, types.float32
    return types.none(maps, joint, weight, i8, i8, f4, f4, f4, out, i8), code


@intrinsic
def project_vertices(typingctx: Any, points, p, u, v, bounds):
    """Pixels u, v (V, LANES) of points (V, 3, LANES) under projections p (12, LANES), all f4; bounds (5, LANES) gets
    x0, x1, y0, y1 and the nearest depth."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        m = [at.load(1, _I64(k * LANES), _FLOATS) for k in range(12)]
        far = [constant(builder, _FLOATS, [s * 1e9] * LANES) for s in (1, -1, 1, -1, 1)]
        extremes = [cgutils.alloca_once_value(builder, f.v) for f in far]
        one = constant(builder, _FLOATS, [1.0] * LANES)
        count = context.make_array(signature.args[0])(context, builder, args[0])
        vertices = builder.extract_value(count.shape, 0)
        with cgutils.for_range(builder, vertices, intp=_I64) as loop:
            row = builder.mul(loop.index, _I64(3 * LANES))
            x, y, z = (at.load(0, builder.add(row, _I64(i * LANES)), _FLOATS) for i in range(3))
            a, b, depth = (
                m[4 * i].times_plus(x, m[4 * i + 1].times_plus(y, m[4 * i + 2].times_plus(z, m[4 * i + 3])))
                for i in range(3)
            )
            inverse = one / depth
            a, b = a * inverse, b * inverse
            place = builder.mul(loop.index, _I64(LANES))
            at.store(a, 2, place)
            at.store(b, 3, place)
            for k, value in enumerate((a, a, b, b, depth)):
                old = Vector(builder, builder.load(extremes[k]))
                new = value.at_least(old) if k in (1, 3) else value.at_most(old)
                builder.store(new.v, extremes[k])
        for k, extreme in enumerate(extremes):
            at.store(Vector(builder, builder.load(extreme)), 4, _I64(k * LANES))
        return context.get_dummy_value()

    return types.none(points, p, u, v, bounds), code


@intrinsic
def front_lanes(typingctx: Any, u, v, a, b, c):
    """Bit l of the result: the triangle of vertices a, b, c (rows of u, v (V, LANES)) is clockwise in lane l."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        rows = [builder.mul(r, _I64(LANES)) for r in args[2:]]
        (ua, ub, uc), (va, vb, vc) = ([at.load(k, r, _FLOATS) for r in rows] for k in (0, 1))
        return ((ub - ua) * (vc - va) < (uc - ua) * (vb - va)).bits(_I16)

    return types.uint16(u, v, types.int64, types.int64, types.int64), code


@intrinsic
def prepare_edge(typingctx: Any, u, v, a, b, window, edge, columns):
    """The edge from vertex a to b in every lane: where it starts in the lane's window and how it runs.

    window (5, LANES) f4: origin x, y, first and end column, rows. Writes edge (4, LANES) f4: left end x, y in the
    window, slope, first column; columns (LANES,) i4: how many it crosses. Returns two masks of lanes: bits 0-15 it
    crosses columns and is not wholly below the window, bits 16-31 it runs right to left.
    """

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        left, top, low, high, rows = (at.load(4, _I64(k * LANES), _FLOATS) for k in range(5))
        ra, rb = builder.mul(args[2], _I64(LANES)), builder.mul(args[3], _I64(LANES))
        xa, xb = at.load(0, ra, _FLOATS) - left, at.load(0, rb, _FLOATS) - left
        ya, yb = at.load(1, ra, _FLOATS) - top, at.load(1, rb, _FLOATS) - top
        swap = xa > xb
        x0, x1, y0, y1 = swap.where(xb, xa), swap.where(xa, xb), swap.where(yb, ya), swap.where(ya, yb)
        first, end = x0.at_least(low).ceil(), x1.at_most(high).ceil()
        active = (first < end) & ((y0 < rows) | (y1 < rows))
        zero = constant(builder, _FLOATS, [0.0] * LANES)
        for k, value in enumerate((x0, y0, (y1 - y0) / (x1 - x0), first)):
            at.store(value, 5, _I64(k * LANES))
        count = active.where(end - first, zero)
        at.store(Vector(builder, builder.fptosi(count.v, _INTS)), 6, _I64(0))
        masks = (builder.zext(m.bits(_I16), _I32) for m in (active, swap))
        return builder.or_(next(masks), builder.shl(next(masks), _I32(16)))

    kinds = (types.int64, types.int64)
    return types.uint32(u, v, *kinds, window, edge, columns), code


@intrinsic
def write_crossings(typingctx: Any, edge, lane, skip, rows, stride, out, place):
    """LANES pixel indices row * stride + column into out (i4, flat index place): where the prepared edge of a lane
    crosses its columns, from the skip-th on. Those past its end are rubbish, for the next edge to overwrite."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        _, lane, skip, rows, stride, _, place = args
        x0, y0, slope, first = (
            splat(builder, at.scalar(0, builder.add(lane, _I64(k * LANES))), _FLOATS) for k in range(4)
        )
        steps = constant(builder, _FLOATS, [float(k) for k in range(LANES)])
        column = first + splat(builder, skip, _FLOATS) + steps
        y = y0 + (column - x0) * slope
        zero = constant(builder, _FLOATS, [0.0] * LANES)
        # the last clamp: rubbish past the image must convert too
        row = y.at_least(zero).at_most(splat(builder, rows, _FLOATS)).ceil()
        r, c = (Vector(builder, builder.fptosi(w.v, _INTS)) for w in (row, column))
        at.store(r * splat(builder, stride, _INTS) + c, 5, place)
        return context.get_dummy_value()

    kinds = (types.int64, types.float32, types.float32, types.int32)
    return types.none(edge, *kinds, out, types.int64), code


@intrinsic
def count_strip(typingctx: Any, difference, start, stride, rows, bits, drawn, mask_start, mask_stride, counts):
    """Running sums down STRIP columns of difference (i1, flat, from index start): adds to counts (3,) i8 the pixels
    where the sum is positive and that are not set in drawn, those of them set in bits (both u1, packed, low bit first,
    flat index mask_start), and the strips whose sums came near the end of int8. Clears what it read."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        _, start, stride, rows, _, _, mask_start, mask_stride, _ = args
        zero = constant(builder, _BYTES, [0] * STRIP)
        running, highest, lowest = (cgutils.alloca_once_value(builder, zero.v) for _ in range(3))
        model, hit = (cgutils.alloca_once_value(builder, _I64(0)) for _ in range(2))
        popcount = builder.module.declare_intrinsic("llvm.ctpop", [_I64])
        with cgutils.for_range(builder, rows, intp=_I64) as loop:
            here = builder.add(start, builder.mul(loop.index, stride))
            acc = Vector(builder, builder.load(running)) + at.load(0, here, _BYTES, 1)
            at.store(zero, 0, here, 1)
            builder.store(acc.v, running)
            builder.store(acc.at_least(Vector(builder, builder.load(highest))).v, highest)
            builder.store(acc.at_most(Vector(builder, builder.load(lowest))).v, lowest)
            where = builder.add(mask_start, builder.mul(loop.index, mask_stride))
            mask, already = (
                builder.load(builder.bitcast(builder.gep(at.data[k], [where]), _I64.as_pointer()), align=1)
                for k in (4, 5)
            )
            inside = builder.and_((acc > zero).bits(_I64), builder.not_(already))
            for total, word in ((model, inside), (hit, builder.and_(inside, mask))):
                builder.store(builder.add(builder.load(total), builder.call(popcount, [word])), total)
        high, low = (constant(builder, _BYTES, [k] * STRIP) for k in (GUARD - 1, -GUARD))
        beyond = (Vector(builder, builder.load(highest)) > high) | (Vector(builder, builder.load(lowest)) < low)
        flag = builder.zext(builder.icmp_unsigned("!=", beyond.bits(_I64), _I64(0)), _I64)
        for k, value in enumerate((builder.load(model), builder.load(hit), flag)):
            place = builder.gep(at.data[8], [_I64(k)])
            builder.store(builder.add(builder.load(place), value), place)
        return context.get_dummy_value()

    i8 = types.int64
    return types.none(difference, i8, i8, i8, bits, drawn, i8, i8, counts), code


@intrinsic
def fill_strip(typingctx: Any, difference, start, stride, rows, mask, out, place, line, counts):
    """Running sums down STRIP columns of difference (i1, flat, from index start), cleared with it. In out (u1, packed,
    low bit first, flat index `place`, `line` bytes a row) the pixels where the sum is positive are set and no others;
    adds to counts (2,) i8 those pixels, and those of them that were set in mask, packed alike."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        _, start, stride, rows, _, _, place, line, _ = args
        zero = constant(builder, _BYTES, [0] * STRIP)
        running = cgutils.alloca_once_value(builder, zero.v)
        totals = [cgutils.alloca_once_value(builder, _I64(0)) for _ in range(2)]
        popcount = builder.module.declare_intrinsic("llvm.ctpop", [_I64])
        with cgutils.for_range(builder, rows, intp=_I64) as loop:
            here = builder.add(start, builder.mul(loop.index, stride))
            acc = Vector(builder, builder.load(running)) + at.load(0, here, _BYTES, 1)
            at.store(zero, 0, here, 1)
            builder.store(acc.v, running)
            inside, where = (acc > zero).bits(_I64), builder.add(place, builder.mul(loop.index, line))
            seen, own = (builder.bitcast(builder.gep(at.data[k], [where]), _I64.as_pointer()) for k in (4, 5))
            hit = builder.and_(inside, builder.load(seen, align=1))
            builder.store(inside, own, align=1)
            for total, word in zip(totals, (inside, hit), strict=True):
                builder.store(builder.add(builder.load(total), builder.call(popcount, [word])), total)
        for k, total in enumerate(totals):
            where = builder.gep(at.data[8], [_I64(k)])
            builder.store(builder.add(builder.load(where), builder.load(total)), where)
        return context.get_dummy_value()

    i8 = types.int64
    return types.none(difference, i8, i8, i8, mask, out, i8, i8, counts), code


@intrinsic
def lowest_bit(typingctx: Any, x):
    """Index of the lowest set bit of a non-zero integer (u4)."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.zext(builder.cttz(args[0], ir.Constant(ir.IntType(1), 1)), _I64)

    return types.int64(types.uint32), code


STEPS = 32
"""Numbers of int16 that are compared at once along a row"""


def _nearest(sign: int) -> Any:
    def nearest(typingctx: Any, line, step, far):
        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            at = Arrays(context, builder, signature, args)
            kind = ir.VectorType(_I16, STEPS)
            count = builder.extract_value(context.make_array(signature.args[0])(context, builder, args[0]).shape, 0)
            step, far = (builder.trunc(v, _I16) for v in args[1:])
            steps, beyond = splat(builder, step, kind), splat(builder, far, kind)
            carry = cgutils.alloca_once(builder, _I16)
            builder.store(far, carry)

            def along(lanes: list[int]) -> Vector:
                return steps * constant(builder, kind, lanes)

            with cgutils.for_range(builder, builder.sdiv(count, _I64(STEPS)), intp=_I64) as loop:
                first = builder.mul(loop.index, _I64(STEPS))
                first = first if sign > 0 else builder.sub(builder.sub(count, first), _I64(STEPS))
                value = at.load(0, first, kind, 2)
                for away in (1, 2, 4, 8, 16):
                    order = range(STEPS - away, 2 * STEPS - away) if sign > 0 else range(away, STEPS + away)
                    pair = (beyond.v, value.v) if sign > 0 else (value.v, beyond.v)
                    lanes = ir.Constant(ir.VectorType(_I32, STEPS), list(order))
                    value = value.at_most(Vector(builder, builder.shuffle_vector(*pair, lanes)) + along([away] * STEPS))
                away = list(range(1, STEPS + 1))[::sign]
                value = value.at_most(splat(builder, builder.load(carry), kind) + along(away))
                at.store(value, 0, first, 2)
                builder.store(builder.extract_element(value.v, _I32(STEPS - 1 if sign > 0 else 0)), carry)
            return context.get_dummy_value()

        return types.none(line, types.int64, types.int64), code

    return intrinsic(nearest)


nearest_from_left, nearest_from_right = _nearest(1), _nearest(-1)
"""(line, step, far): of line (n,) i2, the n // STEPS * STEPS numbers at that end become the least of line[k] +
step |i - k| over all k on that side, and i itself; `far`, and as much, may lie beyond. All of it fits into 16 bits."""
