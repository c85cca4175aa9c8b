"""numba: the inner steps from pictures to masks as vector instructions, because the compiler does not see that the
three colours of a pixel lie side by side (LLVM intermediate code, so for any processor). Every lane computes the same
bits, on every processor: whole numbers, and floating point that is never fused.

Pictures are flat here, (3 n,) u1: blue, green and red of one pixel after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from hypose.compute.vector_code import Arrays, Vector, splat

STRIP = 32
"""Bytes of rows that are added at once"""
GROUP = 16
"""Pixels that are compared at once"""
_WRITTEN_OUT = 8
"""Sums of so few terms are written out, others are a loop."""

_BIT, _BYTE, _I16, _I32, _I64, _FLOAT = *(ir.IntType(k) for k in (1, 8, 16, 32, 64)), ir.FloatType()
_COLOURS = ir.VectorType(_I32, 4)  # blue, green, red, and what comes after
_i8, _f4 = types.int64, types.float32


def _size(element: Any) -> int:
    """Bytes of an element."""
    return 4 if element == _FLOAT else element.width // 8


class _Code:
    """The code being written: the arrays among an intrinsic's arguments by number, and what is done with vectors."""

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any) -> None:
        self.b, self._at = builder, Arrays(context, builder, signature, args)

    def number(self, array: int, index: Any) -> Any:
        """One element of an array."""
        return self._at.scalar(array, index)

    def load(self, array: int, index: Any, count: int) -> Any:
        """`count` elements from a place in an array on."""
        element = self._at.data[array].type.pointee
        return self._at.load(array, index, ir.VectorType(element, count), _size(element)).v

    def store(self, value: Any, array: int, index: Any) -> None:
        """The elements of a vector, from a place in an array on."""
        self._at.store(Vector(self.b, value), array, index, _size(value.type.element))

    def all(self, scalar: Any, count: int) -> Any:
        """A vector of the same value."""
        return splat(self.b, scalar, ir.VectorType(scalar.type, count)).v

    def pick(self, value: Any, lanes: Sequence[int]) -> Any:
        """Some lanes of a vector."""
        order = ir.Constant(ir.VectorType(_I32, len(lanes)), list(lanes))
        return self.b.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), order)

    def of_pixels(self, value: Any) -> list[Any]:
        """Blue, green and red of pixels, each a vector."""
        return [self.pick(value, range(c, value.type.count, 3)) for c in range(3)]

    def by_count(self, count: Any, write: Callable[[int | None], None]) -> None:
        """Code for each small number of terms, written out, and for many (None)."""
        for n in range(1, _WRITTEN_OUT + 1):
            with self.b.if_then(self.b.icmp_signed("==", count, _I64(n))):
                write(n)
        with self.b.if_then(self.b.icmp_signed(">", count, _I64(_WRITTEN_OUT))):
            write(None)

    def summed(self, terms: int | None, count: Any, start: Any, term: Callable[[Any], Any]) -> Any:
        """start + term(0) + ... + term(count - 1); terms: how many these are, where they are written out."""
        if terms is not None:
            for k in range(terms):
                start = self.b.add(start, term(_I64(k)))
            return start
        total = cgutils.alloca_once(self.b, start.type)
        self.b.store(start, total)
        with cgutils.for_range(self.b, count, intp=_I64) as loop:
            self.b.store(self.b.add(self.b.load(total), term(loop.index)), total)
        return self.b.load(total)


@intrinsic
def weighted_rows(typingctx: Any, picture, at, stride, weights, first, lines, half, shift, width, sums):
    """sums (u2) [i], i < width, which is at least STRIP: the sum over k < lines of weights[first + k] (u2) times
    picture (u1) [at + k stride + i], plus half, shifted down; all in 16 bits."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        c = _Code(context, builder, signature, args)
        _, at, stride, _, first, lines, half, shift, width, _ = args
        kind = ir.VectorType(_I16, STRIP)
        half, shift = (c.all(builder.trunc(v, _I16), STRIP) for v in (half, shift))
        last = builder.sub(width, _I64(STRIP))

        def rows(terms: int | None) -> None:
            with cgutils.for_range_slice(builder, _I64(0), width, _I64(STRIP), intp=_I64) as (i, _):
                here = builder.select(builder.icmp_signed("<", i, last), i, last)

                def share(k: Any) -> Any:
                    place = builder.add(builder.add(at, here), builder.mul(stride, k))
                    weight = c.all(c.number(3, builder.add(first, k)), STRIP)
                    return builder.mul(builder.zext(c.load(0, place, STRIP), kind), weight)

                c.store(builder.lshr(c.summed(terms, lines, half, share), shift), 9, here)

        c.by_count(lines, rows)
        return context.get_dummy_value()

    return types.none(picture, _i8, _i8, weights, _i8, _i8, _i8, _i8, _i8, sums), code


@intrinsic
def weighted_row(typingctx: Any, sums, columns, start, weights, taps, scale, half, shift, x0, x1, out, to):
    """Pixels x0 <= x < x1 into out (u1), three bytes each from `to` on: the sum over k < taps of weights[x, k] (i4)
    times the pixel columns[x] - start + k of sums (u2), times scale, plus half, shifted down; all in 32 bits. The byte
    after the last pixel becomes 0, and one element of sums beyond the last pixel is read."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        c = _Code(context, builder, signature, args)
        _, _, start, _, taps, scale, half, shift, x0, x1, _, to = args
        scale, half, shift = (c.all(builder.trunc(v, _I32), 4) for v in (scale, half, shift))

        def row(terms: int | None) -> None:
            with cgutils.for_range_slice(builder, x0, x1, _I64(1), intp=_I64) as (x, _):
                at = builder.mul(builder.sub(c.number(1, x), start), _I64(3))
                weight = builder.mul(x, taps)

                def share(k: Any) -> Any:
                    pixel = builder.zext(c.load(0, builder.add(at, builder.mul(k, _I64(3))), 4), _COLOURS)
                    return builder.mul(pixel, c.all(c.number(3, builder.add(weight, k)), 4))

                total = c.summed(terms, taps, ir.Constant(_COLOURS, [0] * 4), share)
                value = builder.lshr(builder.add(builder.mul(total, scale), half), shift)
                value = builder.and_(value, ir.Constant(_COLOURS, [255] * 3 + [0]))
                place = builder.add(to, builder.mul(builder.sub(x, x0), _I64(3)))
                c.store(builder.trunc(value, ir.VectorType(_BYTE, 4)), 10, place)

        c.by_count(taps, row)
        return context.get_dummy_value()

    return types.none(sums, columns, _i8, weights, _i8, _i8, _i8, _i8, _i8, _i8, out, _i8), code


@intrinsic
def blended_row(typingctx: Any, picture, step, corner, part, shares, first, count, out, to):
    """`count` pixels into out (u1), three bytes each from `to` on. The n-th, from n = first on: of the pixels of
    picture (u1) at number corner[n] (i4), right of it, below (step bytes on) and right of that, shares[part[n]] (K, 4)
    u2 in 1024ths. One byte after the last pixel is written, and two beyond the pixels are read."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        c = _Code(context, builder, signature, args)
        _, step, _, _, _, first, count, _, to = args
        eight = ir.VectorType(_I16, 8)
        with cgutils.for_range(builder, count, intp=_I64) as loop:
            n = builder.add(first, loop.index)
            at = builder.mul(builder.sext(c.number(2, n), _I64), _I64(3))
            which = builder.mul(builder.zext(c.number(3, n), _I64), _I64(4))

            def beside(place: Any, share: Any) -> Any:
                """Of a pixel and the one on its right."""
                both = builder.zext(c.pick(c.load(0, place, 8), (0, 3, 1, 4, 2, 5, 6, 7)), eight)
                pair = builder.bitcast(c.load(4, share, 2), ir.VectorType(_I32, 1))
                weight = builder.bitcast(c.all(builder.extract_element(pair, _I32(0)), 4), eight)
                left, right = (
                    builder.mul(*(builder.sext(c.pick(v, range(k, 8, 2)), _COLOURS) for v in (both, weight)))
                    for k in (0, 1)
                )
                return builder.add(left, right)

            total = builder.add(beside(at, which), beside(builder.add(at, step), builder.add(which, _I64(2))))
            value = builder.lshr(builder.add(total, ir.Constant(_COLOURS, [512] * 4)), ir.Constant(_COLOURS, [10] * 4))
            place = builder.add(to, builder.mul(loop.index, _I64(3)))
            c.store(builder.trunc(value, ir.VectorType(_BYTE, 4)), 7, place)
        return context.get_dummy_value()

    return types.none(picture, _i8, corner, part, shares, _i8, _i8, out, _i8), code


@intrinsic
def outside(typingctx: Any, picture, low, high, at):
    """Bit k < GROUP of the result: the k-th pixel from byte `at` on lies in some colour outside low..high (u1)."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        c = _Code(context, builder, signature, args)
        value, least, most = (c.load(k, args[3], 3 * GROUP) for k in range(3))
        other = builder.or_(builder.icmp_unsigned("<", value, least), builder.icmp_unsigned(">", value, most))
        blue, green, red = c.of_pixels(builder.sext(other, value.type))
        some = builder.or_(builder.or_(blue, green), red)
        found = builder.icmp_unsigned("!=", some, ir.Constant(some.type, [0] * GROUP))
        return builder.zext(builder.bitcast(found, _I16), _I64)

    return types.uint64(picture, low, high, _i8), code


@intrinsic
def darker(typingctx: Any, picture, room, at, darkest, lightest, chroma):
    """Bit k < GROUP of the result: the k-th pixel from byte `at` on shows the room (f4, as pictures), darker:
    s times its colour, s = colour . room / room . room between darkest and lightest, with a rest whose square is below
    chroma. Of a black room the product with itself is 1."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        c, b = _Code(context, builder, signature, args), builder
        floats = ir.VectorType(_FLOAT, GROUP)
        colour = [b.uitofp(v, floats) for v in c.of_pixels(c.load(0, args[2], 3 * GROUP))]
        mean = c.of_pixels(c.load(1, args[2], 3 * GROUP))
        darkest, lightest, chroma, one = (c.all(v, GROUP) for v in (*args[3:], _FLOAT(1.0)))

        def product(first: Sequence[Any], second: Sequence[Any]) -> Any:
            x, y, z = (b.fmul(v, w) for v, w in zip(first, second, strict=True))
            return b.fadd(b.fadd(x, y), z)

        square = product(mean, mean)
        square = b.select(b.fcmp_ordered(">", square, one), square, one)
        s = b.fdiv(product(colour, mean), square)
        rest = [b.fsub(v, b.fmul(s, m)) for v, m in zip(colour, mean, strict=True)]
        dark = b.and_(b.fcmp_ordered(">", s, darkest), b.fcmp_ordered("<", s, lightest))
        dark = b.and_(dark, b.fcmp_ordered("<", product(rest, rest), chroma))
        return b.zext(b.bitcast(dark, _I16), _I64)

    return types.uint64(picture, room, _i8, _f4, _f4, _f4), code


@intrinsic
def mean_outside(typingctx: Any, picture, at, below, low, high, bound):
    """Whether the mean of the 2 x 2 pixels of picture at byte `at` (the lower ones `below` bytes on) lies in some
    colour outside low..high (u1) at byte bound, of which four are read."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        c = _Code(context, builder, signature, args)
        _, at, below, _, _, bound = args
        four = ir.VectorType(_I16, 4)
        total = ir.Constant(four, [2, 2, 2, 0])
        for place in (at, builder.add(at, below)):
            left, right = c.load(0, place, 4), c.pick(c.load(0, builder.add(place, _I64(2)), 4), (1, 2, 3, 3))
            for pixel in (left, right):
                total = builder.add(total, builder.zext(pixel, four))
        value = builder.lshr(total, ir.Constant(four, [2] * 4))
        least, most = (builder.zext(c.load(k, bound, 4), four) for k in (3, 4))
        other = builder.or_(builder.icmp_unsigned("<", value, least), builder.icmp_unsigned(">", value, most))
        bits = builder.and_(builder.zext(builder.bitcast(other, ir.IntType(4)), _I64), _I64(7))
        return builder.icmp_unsigned("!=", bits, _I64(0))

    return types.boolean(picture, _i8, _i8, low, high, _i8), code


@intrinsic
def ones(typingctx: Any, word):
    """How many bits of a word (u8) are set."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.int64(types.uint64), code


@intrinsic
def lowest_bit(typingctx: Any, word):
    """Number of the lowest bit that is set in a word (u8), 64 when none is."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], _BIT(0))

    return types.int64(types.uint64), code
