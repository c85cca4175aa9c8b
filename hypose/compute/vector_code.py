"""LLVM's vectors with the operators of formulas, and the places of numbers in arrays: for who writes explicit vector
instructions."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils


class Vector:
    """A vector in the code being written, with the operators that the formulas below need."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.b, self.v = builder, value

    def _float(self) -> bool:
        return self.v.type.element == ir.FloatType()

    def _do(self, name: str, other: Vector) -> Vector:
        return Vector(self.b, getattr(self.b, ("f" if self._float() else "") + name)(self.v, other.v))

    def __add__(self, other: Vector) -> Vector:
        return self._do("add", other)

    def __sub__(self, other: Vector) -> Vector:
        return self._do("sub", other)

    def __mul__(self, other: Vector) -> Vector:
        return self._do("mul", other)

    def __truediv__(self, other: Vector) -> Vector:
        return Vector(self.b, self.b.fdiv(self.v, other.v))

    def __lt__(self, other: Vector) -> Vector:
        compare = self.b.fcmp_ordered if self._float() else self.b.icmp_signed
        return Vector(self.b, compare("<", self.v, other.v))

    def __gt__(self, other: Vector) -> Vector:
        return other < self

    def __and__(self, other: Vector) -> Vector:
        return Vector(self.b, self.b.and_(self.v, other.v))

    def __or__(self, other: Vector) -> Vector:
        return Vector(self.b, self.b.or_(self.v, other.v))

    def where(self, yes: Vector, no: Vector) -> Vector:
        """Of truth values: `yes` where true, else `no`."""
        return Vector(self.b, self.b.select(self.v, yes.v, no.v))

    def at_least(self, low: Vector) -> Vector:
        """The larger one in each lane; not a number gives low."""
        return (self > low).where(self, low)

    def at_most(self, high: Vector) -> Vector:
        """The smaller one in each lane; not a number gives high."""
        return (self < high).where(self, high)

    def times_plus(self, factor: Vector, term: Vector) -> Vector:
        """Times a factor, plus a term, fused where the processor can."""
        return self._call("llvm.fmuladd", factor, term)

    def ceil(self) -> Vector:
        """Rounded up."""
        return self._call("llvm.ceil")

    def _call(self, name: str, *others: Vector) -> Vector:
        kind = self.v.type
        signature = ir.FunctionType(kind, [kind] * (1 + len(others)))
        f = cgutils.get_or_insert_function(self.b.module, signature, f"{name}.v{kind.count}f32")
        return Vector(self.b, self.b.call(f, [self.v, *(o.v for o in others)]))

    def bits(self, kind: Any) -> Any:
        """A vector of truth values as one integer, first lane lowest."""
        return self.b.bitcast(self.v, kind)


def constant(builder: Any, kind: Any, values: list) -> Vector:
    """A vector of these numbers."""
    return Vector(builder, ir.Constant(kind, values))


def splat(builder: Any, scalar: Any, kind: Any) -> Vector:
    """A vector of one number in all lanes."""
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), scalar, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), kind.count), [0] * kind.count)
    return Vector(builder, builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), zeros))


class Arrays:
    """Element addresses of the arrays among an intrinsic's arguments."""

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any) -> None:
        self.builder = builder
        self.data = [
            context.make_array(t)(context, builder, a).data if isinstance(t, types.Array) else a
            for t, a in zip(signature.args, args, strict=True)
        ]

    def vector(self, argument: int, index: Any, kind: Any) -> Any:
        """Address of a vector that starts at a flat index."""
        return self.builder.bitcast(self.builder.gep(self.data[argument], [index]), kind.as_pointer())

    def load(self, argument: int, index: Any, kind: Any, align: int = 4) -> Vector:
        """A vector that starts at a flat index of an argument."""
        return Vector(self.builder, self.builder.load(self.vector(argument, index, kind), align=align))

    def store(self, value: Vector, argument: int, index: Any, align: int = 4) -> None:
        """Puts a vector at a flat index of an argument."""
        self.builder.store(value.v, self.vector(argument, index, value.v.type), align=align)

    def scalar(self, argument: int, index: Any) -> Any:
        """One number at a flat index of an argument."""
        return self.builder.load(self.builder.gep(self.data[argument], [index]))
