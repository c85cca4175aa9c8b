"""numba-cuda: the silhouette scorer on an NVIDIA device; poses in, counts out.

Three kernels: joint frames (a thread per pose), skinning and projection (a thread per pose and vertex), and drawing (a
block per pose and view). A block draws every front triangle as bits into shared memory, 32 rows of a column to a word,
and counts against the mask's words: on a device plain triangles are simpler than contours, and as fast (thousands of
triangles are drawn at once, and nothing is sorted or listed). The sampling is that of reference.py.

The layers of a search stay on the device altogether: cuda_search.py. What does not change from call to call, body and
masks, is sent once (`kept_on_device`).
"""

# pyright: reportOperatorIssue=false, reportOptionalSubscript=false
from __future__ import annotations

import math
import os
import threading
from typing import Any, NamedTuple

import numpy as np
from numba import config, cuda, float32, int32, uint32
from numpy.typing import NDArray

from hypose.compute.arrays import BALL, HINGES, TreeArrays
from hypose.compute.cache_place import cache_folder
from hypose.compute.selection import require_cuda
from hypose.compute.silhouettes.lane_mesh import LaneMesh
from hypose.compute.solver.terms import PreparedMasks
from hypose.errors import InputError

config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # pyright: ignore[reportAttributeAccessIssue] - one block selects

NEAR = 0.05
"""Near plane, m."""
THREADS = 128
"""Per block; a power of two."""
WORDS = 3072
"""Words of 32 pixels that a block holds: 12 KiB of shared memory, a body of 250 x 380 pixels at a time."""
FACES = 2048
"""Of which a block lists at a time those that are seen from the front."""
POSES = 4096
"""Per launch: bounds the device memory (38 MB per 1000 poses of 600 vertices in 4 views)."""
FEW = 32
"""Up to so many poses are scored sooner by the processor than sent to a device."""
JOINTS = 64
"""A body's at most: a thread keeps the frames of a pose's joints."""


@cuda.jit(device=True)
def turn_joints(n, pose, parents, kind, dof_start, dof_count, axes, joints, maps):
    """maps (N, J, 12) f4 of pose n, whose dof are pose (D,): from the model at rest to the world about the root."""
    frames = cuda.local.array((JOINTS, 9), np.float64)
    centres = cuda.local.array((JOINTS, 3), np.float64)
    e = cuda.local.array(9, np.float64)
    row = cuda.local.array(3, np.float64)
    for j in range(parents.shape[0]):
        a = parents[j]
        for i in range(9):
            frames[j, i] = frames[a, i] if a >= 0 else (1.0 if i % 4 == 0 else 0.0)
        for i in range(3):
            centres[j, i] = 0.0
            if a >= 0:
                centres[j, i] = centres[a, i]
                for k in range(3):
                    centres[j, i] += frames[a, 3 * i + k] * (joints[j, k] - joints[a, k])
        turns = 0
        if kind[j] == BALL:
            turns = 1
        elif kind[j] == HINGES:
            turns = dof_count[j]
        for turn in range(turns):
            d = dof_start[j] + turn
            if kind[j] == BALL:
                x, y, z = pose[d], pose[d + 1], pose[d + 2]
            else:
                x, y, z = pose[d] * axes[d, 0], pose[d] * axes[d, 1], pose[d] * axes[d, 2]
            t2 = x * x + y * y + z * z
            t = math.sqrt(t2)
            if t < 1e-3:  # as in cpu_kinematics.so3_exp_and_jacobian
                s, c = 1 - t2 / 6 + t2 * t2 / 120, 0.5 - t2 / 24 + t2 * t2 / 720
            else:
                h = math.sin(0.5 * t)
                s, c = 2 * h * math.cos(0.5 * t) / t, 2 * h * h / t2
            e[0], e[4], e[8] = 1 + c * (x * x - t2), 1 + c * (y * y - t2), 1 + c * (z * z - t2)
            e[1], e[3] = c * x * y - s * z, c * x * y + s * z
            e[2], e[6] = c * x * z + s * y, c * x * z - s * y
            e[5], e[7] = c * y * z - s * x, c * y * z + s * x
            for i in range(3):
                for k in range(3):
                    row[k] = frames[j, 3 * i + k]
                for k in range(3):
                    frames[j, 3 * i + k] = row[0] * e[k] + row[1] * e[3 + k] + row[2] * e[6 + k]
        for i in range(3):
            offset = centres[j, i]
            for k in range(3):
                offset -= frames[j, 3 * i + k] * joints[j, k]
                maps[n, j, 4 * i + k] = frames[j, 3 * i + k]
            maps[n, j, 4 * i + 3] = offset


@cuda.jit
def joint_maps(poses, parents, kind, dof_start, dof_count, axes, joints, maps):
    """maps (N, J, 12) f4 of poses (N, D)."""
    n = cuda.grid(1)
    if n < poses.shape[0]:
        turn_joints(n, poses[n], parents, kind, dof_start, dof_count, axes, joints, maps)


@cuda.jit
def words_of_masks(bits, height, words):
    """words (C, w, W) u4 of the masks' bits (C, h, B): 32 rows of a column to a word, first row lowest."""
    c, i = cuda.blockIdx.y, cuda.grid(1)
    if i >= words.shape[1] * words.shape[2]:
        return
    x, word = i % words.shape[1], i // words.shape[1]
    out = uint32(0)
    for k in range(min(32, height - 32 * word)):
        out |= uint32((bits[c, 32 * word + k, x >> 3] >> (x & 7)) & 1) << uint32(k)
    words[c, x, word] = out


@cuda.jit
def skin_and_project(poses, maps, vertices, start, joint, weight, projections, out):
    """out (N, C, V, 4) f4: pixels u, v and depth w of the skinned vertices in every view (u w, v w before the near
    plane); the fourth number fills up the line."""
    n = cuda.blockIdx.y
    v = cuda.grid(1)
    if v >= vertices.shape[0]:
        return
    x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
    p = cuda.local.array(3, np.float32)
    h = cuda.local.array(3, np.float32)
    for i in range(3):
        p[i] = float32(0.0)
        for k in range(start[v], start[v + 1]):
            j = joint[k]
            p[i] += weight[k] * (
                maps[n, j, 4 * i] * x + maps[n, j, 4 * i + 1] * y + maps[n, j, 4 * i + 2] * z + maps[n, j, 4 * i + 3]
            )
    for c in range(projections.shape[0]):
        for i in range(3):
            # the root's part in float64, the rest about the root
            offset = projections[c, i, 3]
            for k in range(3):
                offset += projections[c, i, k] * poses[n, k]
            h[i] = float32(offset)
            for k in range(3):
                h[i] += float32(projections[c, i, k]) * p[k]
        before = float32(1.0) / h[2] if h[2] >= float32(NEAR) else float32(1.0)
        out[n, c, v, 0], out[n, c, v, 1], out[n, c, v, 2] = h[0] * before, h[1] * before, h[2]


@cuda.jit(device=True)
def within(x, low, high):
    """ceil(x) as an integer between low and high (x may be beyond any integer)."""
    return int32(math.ceil(min(max(x, float32(low)), float32(high))))


@cuda.jit(device=True)
def twice_area(ax, ay, bx, by, cx, cy):
    """Of a triangle in pixels; negative when its front is seen."""
    return (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)


@cuda.jit(device=True)
def draw_triangle(ax, ay, bx, by, cx, cy, left, right, y0, y1, first_word, words, image):
    """The pixels whose centres lie in a triangle, as bits, in columns left .. right - 1 and rows y0 .. y1 - 1."""
    if ax > bx:
        ax, ay, bx, by = bx, by, ax, ay
    if bx > cx:
        bx, by, cx, cy = cx, cy, bx, by
        if ax > bx:
            ax, ay, bx, by = bx, by, ax, ay
    begin, turn, end = within(ax, left, right), within(bx, left, right), within(cx, left, right)
    if begin >= end:
        return
    # every edge from its left end to its right one: the same float for both faces of it
    whole = (cy - ay) / (cx - ax)
    sx, sy = ax, ay
    slope = (by - ay) / (bx - ax) if bx > ax else float32(0.0)
    if begin >= turn:
        sx, sy, slope = bx, by, (cy - by) / (cx - bx)
    for x in range(begin, end):
        if x == turn and begin < turn:
            sx, sy, slope = bx, by, (cy - by) / (cx - bx)
        one, other = ay + (float32(x) - ax) * whole, sy + (float32(x) - sx) * slope
        r0, r1 = within(min(one, other), y0, y1), within(max(one, other), y0, y1)
        row = (x - left) * words - first_word
        for word in range(r0 >> 5, (r1 + 31) >> 5):
            a, b = max(r0 - 32 * word, 0), min(r1 - 32 * word, 32)
            if a < b:  # bits a .. b - 1
                bits = (uint32(0xFFFFFFFF) >> uint32(32 - (b - a))) << uint32(a)
                cuda.atomic.or_(image, row + word, uint32(bits))


@cuda.jit(device=True)
def cut_at_near(p, a, b, c, polygon):
    """Pixels of the triangle a, b, c of p (V, 4), cut at the near plane: polygon (4, 2); how many."""
    n = 0
    for k in range(3):
        i = a if k == 0 else (b if k == 1 else c)
        j = b if k == 0 else (c if k == 1 else a)
        if p[i, 2] >= float32(NEAR):
            polygon[n, 0], polygon[n, 1] = p[i, 0], p[i, 1]
            n += 1
        if (p[i, 2] >= float32(NEAR)) != (p[j, 2] >= float32(NEAR)):
            if p[i, 2] > p[j, 2]:  # one direction for both faces of an edge: the same float on both sides
                i, j = j, i
            t = (float32(NEAR) - p[i, 2]) / (p[j, 2] - p[i, 2])
            for k2 in range(2):
                far = p[j, k2] * p[j, 2]
                polygon[n, k2] = (p[i, k2] + t * (far - p[i, k2])) / float32(NEAR)
            n += 1
    return n


@cuda.jit(device=True)
def draw_cut(p, a, b, c, both_sides, left, right, y0, y1, first_word, words, image):
    """`draw_triangle` of one that reaches behind the near plane."""
    polygon = cuda.local.array((4, 2), np.float32)
    k = cut_at_near(p, a, b, c, polygon)
    area = float32(0.0)
    for i in range(1, k - 1):
        area += twice_area(
            polygon[0, 0], polygon[0, 1], polygon[i, 0], polygon[i, 1], polygon[i + 1, 0], polygon[i + 1, 1]
        )
    if area < float32(0.0) or both_sides:
        for i in range(1, k - 1):
            draw_triangle(
                *(polygon[0, 0], polygon[0, 1], polygon[i, 0], polygon[i, 1], polygon[i + 1, 0], polygon[i + 1, 1]),
                *(left, right, y0, y1, first_word, words, image),
            )


@cuda.jit
def draw_and_count(pixels, faces, one_sided, masks, usable, boxes, out):
    """out (N, C, 3) i8 = (xor without the box's own mask pixels, model, intersection) of one pose and view per block;
    zeros where a view is not usable.

    pixels (N, C, V, 4) as skin_and_project has them; masks (C, w, W) u4: 32 rows of a column to a word, first row
    lowest. Only the part of the box that the body reaches is drawn, WORDS of it at a time."""
    n, c, thread = cuda.blockIdx.x, cuda.blockIdx.y, cuda.threadIdx.x
    image = cuda.shared.array(WORDS, uint32)
    front = cuda.shared.array(FACES, int32)
    total = cuda.shared.array(4, int32)
    reach = cuda.shared.array(4, int32)
    if thread == 0:
        for k in range(4):
            total[k] = 0
        reach[0], reach[1], reach[2], reach[3] = boxes[c, 1], boxes[c, 0], boxes[c, 3], boxes[c, 2]
    cuda.syncthreads()
    p = pixels[n, c]
    if usable[c]:
        x0, x1, y0, y1 = int32(boxes[c, 0]), int32(boxes[c, 1]), int32(boxes[c, 2]), int32(boxes[c, 3])
        low_x, high_x, low_y, high_y, near = float32(1e9), float32(-1e9), float32(1e9), float32(-1e9), False
        for v in range(thread, p.shape[0], cuda.blockDim.x):
            near |= p[v, 2] < float32(NEAR)
            low_x, high_x = min(low_x, p[v, 0]), max(high_x, p[v, 0])
            low_y, high_y = min(low_y, p[v, 1]), max(high_y, p[v, 1])
        if near:  # pixels of what is cut off say nothing
            cuda.atomic.add(total, 2, 1)
            low_x, high_x, low_y, high_y = float32(-1e9), float32(1e9), float32(-1e9), float32(1e9)
        if low_x <= high_x:
            cuda.atomic.min(reach, 0, within(low_x, x0, x1))
            cuda.atomic.max(reach, 1, within(high_x, x0, x1))
            cuda.atomic.min(reach, 2, within(low_y, y0, y1))
            cuda.atomic.max(reach, 3, within(high_y, y0, y1))
    cuda.syncthreads()
    left, end, y0, y1 = reach[0], reach[1], reach[2], reach[3]
    both_sides = total[2] > 0 and not one_sided
    first_word = y0 >> 5
    words = ((y1 + 31) >> 5) - first_word
    if y0 >= y1:
        left = end
    while left < end:
        right = min(left + max(WORDS // words, 1), end)
        size = (right - left) * words
        for i in range(thread, size, cuda.blockDim.x):
            image[i] = uint32(0)
        first_face = 0
        while first_face < faces.shape[0]:
            if thread == 0:
                total[3] = 0
            cuda.syncthreads()
            # the faces that show their front are drawn by as many threads as there are
            for f in range(first_face + thread, min(first_face + FACES, faces.shape[0]), cuda.blockDim.x):
                i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
                cut = min(p[i, 2], p[j, 2], p[k, 2]) < float32(NEAR)
                if cut or both_sides or twice_area(p[i, 0], p[i, 1], p[j, 0], p[j, 1], p[k, 0], p[k, 1]) < float32(0.0):
                    front[cuda.atomic.add(total, 3, 1)] = f
            cuda.syncthreads()
            for listed in range(thread, total[3], cuda.blockDim.x):
                f = front[listed]
                i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
                if min(p[i, 2], p[j, 2], p[k, 2]) < float32(NEAR):
                    draw_cut(p, i, j, k, both_sides, left, right, y0, y1, first_word, words, image)
                else:
                    draw_triangle(
                        *(p[i, 0], p[i, 1], p[j, 0], p[j, 1], p[k, 0], p[k, 1]),
                        *(left, right, y0, y1, first_word, words, image),
                    )
            cuda.syncthreads()
            first_face += FACES
        model, hit = int32(0), int32(0)
        for i in range(thread, size, cuda.blockDim.x):
            drawn = image[i]
            if drawn:
                model += cuda.popc(drawn)
                hit += cuda.popc(drawn & masks[c, left + i // words, first_word + i % words])
        if model:
            cuda.atomic.add(total, 0, model)
            cuda.atomic.add(total, 1, hit)
        cuda.syncthreads()
        left = right
    if thread == 0:
        out[n, c, 0], out[n, c, 1], out[n, c, 2] = total[0] - 2 * total[1], total[0], total[1]


def device_name() -> str:
    """The device's name; empty when there is none, or no driver. What that keeps goes where hypose's cache is."""
    folder = cache_folder()
    if folder is None:
        os.environ.setdefault("CUDA_CACHE_DISABLE", "1")
    else:
        os.environ.setdefault("CUDA_CACHE_PATH", str(folder / "cuda"))
    try:
        if not cuda.is_available():
            return ""
        name = getattr(cuda.get_current_device(), "name", "simulated")
    except Exception:  # noqa: BLE001 - whatever a half-installed driver raises, it means no
        return ""
    return name.decode() if isinstance(name, bytes) else str(name)


class OnDevice(NamedTuple):
    """What a launch reads beside the poses, on the device."""

    tree: tuple[Any, ...]
    """parents, kind, dof_start, dof_count, axes, joints"""
    body: tuple[Any, ...]
    """vertices, start, joint, weight of the mesh"""
    faces: Any
    projections: Any
    usable: Any
    words: Any
    """(C, w, W) u4: the masks"""


_kept: list[tuple[tuple[Any, ...], Any]] = []
_lock = threading.Lock()
_KEPT = 12


def _once(sources: tuple[NDArray[Any], ...], make: Any) -> Any:
    """What `make` has made of these very arrays, on the device; the last few are kept. (The sources are kept with it,
    so that no other array gets the identity of one that is gone; they must not be changed in place.)"""
    with _lock:
        for k, (known, made) in enumerate(_kept):
            if len(known) == len(sources) and all(a is b for a, b in zip(known, sources, strict=True)):
                _kept.insert(0, _kept.pop(k))
                return made
        made = make()
        _kept.insert(0, (sources, made))
        del _kept[_KEPT:]
        return made


def kept_on_device(tree: TreeArrays, mesh: LaneMesh, vertices: NDArray[Any], prepared: PreparedMasks) -> OnDevice:
    """Body and masks on the device. vertices: the array that mesh.vertices were taken from."""
    require_cuda()
    if prepared.masks.shape[1] > 32 * WORDS:
        raise InputError(f"Images of {prepared.masks.shape[1]} rows are too high for the CUDA back end; choose cpu.")
    if len(tree.parents) > JOINTS:
        raise InputError(f"A body of {len(tree.parents)} joints has too many for the CUDA back end; choose cpu.")

    def masks() -> tuple[Any, ...]:
        views, height, width = prepared.masks.shape
        words = cuda.device_array((views, width, -(-height // 32)), np.uint32)
        blocks = -(-width * words.shape[2] // THREADS)
        words_of_masks[(blocks, views), THREADS](cuda.to_device(prepared.bits), height, words)
        return cuda.to_device(prepared.projections), cuda.to_device(prepared.usable), words

    moving = _once((tree.joints, tree.axes), lambda: tuple(cuda.to_device(a) for a in tree[:6]))
    skin = _once((vertices, mesh.faces), lambda: tuple(cuda.to_device(a) for a in (*mesh[:1], *mesh[3:6], mesh.faces)))
    known = prepared.masks, prepared.usable, prepared.projections
    projections, usable, words = _once(known, masks)
    return OnDevice(moving, skin[:4], skin[4], projections, usable, words)


def silhouette_xor(
    poses: NDArray[np.float64],
    tree: TreeArrays,
    mesh: LaneMesh,
    vertices: NDArray[Any],
    prepared: PreparedMasks,
    boxes: NDArray[np.int64],
    areas: NDArray[np.int64],
) -> NDArray[np.int64]:
    """(N, C, 3) = (xor, model, intersection) pixels of poses (N, D) inside boxes (C, 4) whose masks have areas (C,).
    vertices: the array that mesh.vertices were taken from."""
    there = kept_on_device(tree, mesh, vertices, prepared)
    out = np.zeros((len(poses), len(areas), 3), dtype=np.int64)
    box = cuda.to_device(boxes)
    for begin in range(0, len(poses) if len(mesh.faces) else 0, POSES):
        q = cuda.to_device(np.ascontiguousarray(poses[begin : begin + POSES]))
        n = q.shape[0]
        maps = cuda.device_array((n, len(tree.parents), 12), np.float32)
        pixels = cuda.device_array((n, len(areas), len(mesh.vertices), 4), np.float32)
        counts = cuda.device_array((n, len(areas), 3), np.int64)
        joint_maps[-(-n // 32), 32](q, *there.tree, maps)
        count(q, maps, there, box, mesh.one_sided, pixels, counts)
        out[begin : begin + n] = counts.copy_to_host()
    out[..., 0] += np.where(prepared.usable, areas, 0)
    return out


def count(q: Any, maps: Any, there: OnDevice, boxes: Any, one_sided: bool, pixels: Any, counts: Any) -> None:
    """Launch what draws poses q (N, D), of these maps, and counts: counts (N, C, 3) without the boxes' own mask pixels,
    nothing in views that are not usable. pixels (N, C, V, 4) f4: scratch."""
    n, views, vertices = pixels.shape[:3]
    blocks = -(-vertices // THREADS)
    skin_and_project[(blocks, n), THREADS](q, maps, *there.body, there.projections, pixels)
    draw_and_count[(n, views), THREADS](pixels, there.faces, one_sided, there.words, there.usable, boxes, counts)
