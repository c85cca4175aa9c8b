"""numba: the outline of one pose in VIEWS views at once, a vector lane to each view.

The steps are those of cpu_silhouettes.py, and so are the bits: what is the same in all views, which corners a face has
and which faces meet in an edge, is read once for all of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from hypose.compute.compiled import kernel
from hypose.compute.cpu_kinematics import camera_about_root
from hypose.compute.silhouettes.cpu_silhouettes import cross_columns
from hypose.compute.vector_code import Arrays, Vector, constant, splat

VIEWS = 4
"""views that are looked at together: a register of every processor"""

f4, u4 = np.float32, np.uint32
_FLOAT, _BYTE, _I64 = ir.FloatType(), ir.IntType(8), ir.IntType(64)
_FLOATS = ir.VectorType(_FLOAT, VIEWS)


@intrinsic
def _project_views(typingctx: Any, vertices, p, uv, bounds):
    """Pixels uv (V, 2, VIEWS) of vertices (V, 3) under projections p (12, VIEWS), all f4; bounds (5, VIEWS) gets
    x0, x1, y0, y1 and the nearest depth."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        m = [at.load(1, _I64(k * VIEWS), _FLOATS) for k in range(12)]
        far = [constant(builder, _FLOATS, [s * 1e9] * VIEWS) for s in (1, -1, 1, -1, 1)]
        extremes = [cgutils.alloca_once_value(builder, f.v) for f in far]
        one = constant(builder, _FLOATS, [1.0] * VIEWS)
        count = builder.extract_value(context.make_array(signature.args[0])(context, builder, args[0]).shape, 0)
        with cgutils.for_range(builder, count, intp=_I64) as loop:
            row = builder.mul(loop.index, _I64(3))
            x, y, z = (splat(builder, at.scalar(0, builder.add(row, _I64(i))), _FLOATS) for i in range(3))
            a, b, depth = (m[4 * i] * x + m[4 * i + 1] * y + m[4 * i + 2] * z + m[4 * i + 3] for i in range(3))
            inverse = one / depth
            a, b = a * inverse, b * inverse
            place = builder.mul(loop.index, _I64(2 * VIEWS))
            at.store(a, 2, place)
            at.store(b, 2, builder.add(place, _I64(VIEWS)))
            for k, value in enumerate((a, a, b, b, depth)):
                old = Vector(builder, builder.load(extremes[k]))
                new = value.at_least(old) if k in (1, 3) else value.at_most(old)
                builder.store(new.v, extremes[k])
        for k, extreme in enumerate(extremes):
            at.store(Vector(builder, builder.load(extreme)), 3, _I64(k * VIEWS))
        return context.get_dummy_value()

    return types.none(vertices, p, uv, bounds), code


@intrinsic
def _front_views(typingctx: Any, uv, a, b, c):
    """Bit k of the result: the triangle of vertices a, b, c (rows of uv (V, 2, VIEWS) f4) is clockwise in view k."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = Arrays(context, builder, signature, args)
        rows = [builder.mul(builder.sext(r, _I64), _I64(2 * VIEWS)) for r in args[1:]]
        (ua, ub, uc), (va, vb, vc) = (
            [at.load(0, builder.add(r, _I64(k * VIEWS)), _FLOATS) for r in rows] for k in range(2)
        )
        clockwise = (ub - ua) * (vc - va) < (uc - ua) * (vb - va)
        return builder.zext(clockwise.bits(ir.IntType(VIEWS)), _BYTE)

    return types.uint8(uv, types.int32, types.int32, types.int32), code


@kernel
def project_views(vertices, projections, first, q, p, turned, uv, bounds):
    """Pixels uv (V, 2, VIEWS) of vertices (V, 3) f4, about the root of pose q, in the views from `first` on (the last
    one repeated) of projections (C, 3, 4) f8, which become p (VIEWS, 3, 4) f4; bounds (5, VIEWS) gets x0, x1, y0, y1
    and the nearest depth; turned (12, VIEWS) f4: scratch."""
    for k in range(VIEWS):
        camera_about_root(projections[min(first + k, projections.shape[0] - 1)], q, p[k])
        for r in range(3):
            for c in range(4):
                turned[4 * r + c, k] = p[k, r, c]
    _project_views(vertices, turned, uv, bounds)


@kernel
def front_views(faces, uv, front):
    """front (F,) u1: bit k where a face turns its outside to the camera of view k."""
    for f in range(faces.shape[0]):
        front[f] = _front_views(uv, faces[f, 0], faces[f, 1], faces[f, 2])


@kernel
def contours_of_any(edges, front, union):
    """union (E,) i4: the edges that are on a contour in some view; returns how many."""
    n = 0
    for e in range(edges.shape[0]):
        union[n] = e
        n += front[u4(edges[e, 2])] != front[u4(edges[e, 3])]
    return n


@kernel
def contours_of_view(k, n_union, union, edges, front, uv, start, end, lines):
    """Directed contour edges of view k as in cpu_silhouettes.contour_edges, and lines (4, E) f4: where they start and
    end, u, v, u, v px; returns how many."""
    n, bit = 0, np.uint8(1 << k)
    for i in range(n_union):
        e = u4(union[i])
        left, right = front[u4(edges[e, 2])] & bit, front[u4(edges[e, 3])] & bit
        a, b = edges[e, 0], edges[e, 1]
        start[n] = a if left else b
        end[n] = b if left else a
        n += left != right
    for i in range(n):
        a, b = u4(start[i]), u4(end[i])
        lines[0, i], lines[1, i], lines[2, i], lines[3, i] = uv[a, 0, k], uv[a, 1, k], uv[b, 0, k], uv[b, 1, k]
    return n


@kernel
def emit_lines(n, lines, x0, y0, width, height, difference):
    """Winding differences of n directed contour edges, as cpu_silhouettes.emit_contours makes them."""
    fx, fy = f4(x0), f4(y0)
    for e in range(n):
        xa, ya, xb, yb = lines[0, e] - fx, lines[1, e] - fy, lines[2, e] - fx, lines[3, e] - fy
        cross_columns(xa, ya, xb, yb, 1, width, height, difference)
