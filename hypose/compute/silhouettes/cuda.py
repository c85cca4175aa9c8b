"""numba-cuda: the silhouette scorer on an NVIDIA device; poses in, counts out.

Three kernels: joint frames (a thread per pose), skinning and projection (a thread per pose and vertex), and drawing (a
block per pose and view). A block draws every front triangle as bits into shared memory, 32 rows of a column to a word,
and counts against the mask's words: on a device plain triangles are simpler than contours, and as fast (thousands of
triangles are drawn at once, and nothing is sorted or listed). The sampling is that of reference.py.

A frame's masks go to the device once, the body's arrays once per call. Not measured: no device was at hand; tests run
these kernels in numba's simulator.
"""

# pyright: reportOperatorIssue=false, reportOptionalSubscript=false
from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numba import cuda, float32, int32, uint32
from numpy.typing import NDArray

from hypose.compute.arrays import BALL, HINGES, TreeArrays
from hypose.compute.silhouettes.lane_mesh import LaneMesh
from hypose.compute.solver.terms import PreparedMasks
from hypose.errors import InputError

NEAR = 0.05
"""Near plane, m."""
THREADS = 128
"""Per block; a power of two."""
WORDS = 8192
"""Words of 32 pixels that a block holds: 32 KiB of shared memory, enough for 546 columns of 480 rows at a time."""
POSES = 1024
"""Per launch: bounds the device memory (13 MB per 1000 silhouettes of 1000 vertices)."""


@cuda.jit
def joint_maps(poses, parents, kind, dof_start, dof_count, axes, joints, frames, centres, maps):
    """maps (N, J, 12) f4 from the model at rest to the world about the pose's root; frames (N, J, 9), centres (N, J, 3)
    f8 are scratch."""
    n = cuda.grid(1)
    if n >= poses.shape[0]:
        return
    e = cuda.local.array(9, np.float64)
    row = cuda.local.array(3, np.float64)
    for j in range(parents.shape[0]):
        a = parents[j]
        for i in range(9):
            frames[n, j, i] = frames[n, a, i] if a >= 0 else (1.0 if i % 4 == 0 else 0.0)
        for i in range(3):
            centres[n, j, i] = 0.0
            if a >= 0:
                centres[n, j, i] = centres[n, a, i]
                for k in range(3):
                    centres[n, j, i] += frames[n, a, 3 * i + k] * (joints[j, k] - joints[a, k])
        turns = 0
        if kind[j] == BALL:
            turns = 1
        elif kind[j] == HINGES:
            turns = dof_count[j]
        for turn in range(turns):
            d = dof_start[j] + turn
            if kind[j] == BALL:
                x, y, z = poses[n, d], poses[n, d + 1], poses[n, d + 2]
            else:
                x, y, z = poses[n, d] * axes[d, 0], poses[n, d] * axes[d, 1], poses[n, d] * axes[d, 2]
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
                    row[k] = frames[n, j, 3 * i + k]
                for k in range(3):
                    frames[n, j, 3 * i + k] = row[0] * e[k] + row[1] * e[3 + k] + row[2] * e[6 + k]
        for i in range(3):
            offset = centres[n, j, i]
            for k in range(3):
                offset -= frames[n, j, 3 * i + k] * joints[j, k]
                maps[n, j, 4 * i + k] = frames[n, j, 3 * i + k]
            maps[n, j, 4 * i + 3] = offset


@cuda.jit
def skin_and_project(poses, maps, vertices, start, joint, weight, projections, out):
    """out (N, C, V, 3) f4: homogeneous pixel coordinates of the skinned vertices in every view."""
    n = cuda.blockIdx.y
    v = cuda.grid(1)
    if v >= vertices.shape[0]:
        return
    x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
    p = cuda.local.array(3, np.float32)
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
            value = float32(offset)
            for k in range(3):
                value += float32(projections[c, i, k]) * p[k]
            out[n, c, v, i] = value


@cuda.jit(device=True)
def polygon_of_face(h, a, b, c, polygon):
    """Pixels of the triangle a, b, c of homogeneous h (V, 3), cut at the near plane: polygon (4, 2); how many."""
    n = 0
    for k in range(3):
        i = a if k == 0 else (b if k == 1 else c)
        j = b if k == 0 else (c if k == 1 else a)
        di, dj = h[i, 2], h[j, 2]
        if di >= float32(NEAR):
            inverse = float32(1.0) / di
            polygon[n, 0] = h[i, 0] * inverse
            polygon[n, 1] = h[i, 1] * inverse
            n += 1
        if (di >= float32(NEAR)) != (dj >= float32(NEAR)):
            if di > dj:  # one direction for both faces of an edge: the same float on both sides
                i, j, di, dj = j, i, dj, di
            t = (float32(NEAR) - di) / (dj - di)
            polygon[n, 0] = (h[i, 0] + t * (h[j, 0] - h[i, 0])) / float32(NEAR)
            polygon[n, 1] = (h[i, 1] + t * (h[j, 1] - h[i, 1])) / float32(NEAR)
            n += 1
    return n


@cuda.jit(device=True)
def within(x, low, high):
    """ceil(x) as an integer between low and high (x may be beyond any integer)."""
    return int32(math.ceil(min(max(x, float32(low)), float32(high))))


@cuda.jit
def draw_and_count(homogeneous, faces, one_sided, masks, usable, boxes, out):
    """out (N, C, 3) i8 = (xor without the box's own mask pixels, model, intersection) of one pose and view per block.

    masks (C, w, words) u4: 32 rows of a column to a word, first row lowest."""
    n, c, thread = cuda.blockIdx.x, cuda.blockIdx.y, cuda.threadIdx.x
    image = cuda.shared.array(WORDS, uint32)
    total = cuda.shared.array(3, int32)
    polygon = cuda.local.array((4, 2), np.float32)
    if not usable[c]:
        return
    h = homogeneous[n, c]
    x0, x1, y0, y1 = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3]
    if thread < 3:
        total[thread] = 0
    cuda.syncthreads()
    near = 0
    for v in range(thread, h.shape[0], cuda.blockDim.x):
        near |= int32(h[v, 2] < float32(NEAR))
    if near:
        cuda.atomic.add(total, 2, 1)
    cuda.syncthreads()
    both_sides = total[2] > 0 and not one_sided
    first_word = y0 >> 5
    words = ((y1 + 31) >> 5) - first_word
    band = x1 - x0
    if words > 0:
        band = min(band, WORDS // words)
    left = x0
    while left < x1 and words > 0:
        right = min(left + band, x1)
        for i in range(thread, (right - left) * words, cuda.blockDim.x):
            image[i] = uint32(0)
        cuda.syncthreads()
        for f in range(thread, faces.shape[0], cuda.blockDim.x):
            k = polygon_of_face(h, faces[f, 0], faces[f, 1], faces[f, 2], polygon)
            if k < 3:
                continue
            area = float32(0.0)
            low = high = polygon[0, 0]
            for i in range(1, k):
                j = i + 1 if i + 1 < k else 0
                low, high = min(low, polygon[i, 0]), max(high, polygon[i, 0])
                area += (polygon[i, 0] - polygon[0, 0]) * (polygon[j, 1] - polygon[0, 1])
                area -= (polygon[j, 0] - polygon[0, 0]) * (polygon[i, 1] - polygon[0, 1])
            if area >= float32(0.0) and not both_sides:
                continue
            for x in range(within(low, left, right), within(high, left, right)):
                top, bottom, crossed = float32(1e30), float32(-1e30), 0
                for i in range(k):
                    j = i + 1 if i + 1 < k else 0
                    xa, ya, xb, yb = polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1]
                    if xa > xb:
                        xa, ya, xb, yb = xb, yb, xa, ya
                    if math.ceil(xa) <= x and x < math.ceil(xb):
                        y = ya + (float32(x) - xa) * ((yb - ya) / (xb - xa))
                        top, bottom, crossed = min(top, y), max(bottom, y), crossed + 1
                if crossed < 2:
                    continue
                r0, r1 = within(top, y0, y1), within(bottom, y0, y1)
                for word in range(r0 >> 5, (r1 + 31) >> 5):
                    a, b = max(r0 - 32 * word, 0), min(r1 - 32 * word, 32)
                    if a < b:
                        # bits a .. b - 1
                        bits = (uint32(0xFFFFFFFF) >> uint32(32 - (b - a))) << uint32(a)
                        cuda.atomic.or_(image, (x - left) * words + word - first_word, uint32(bits))
        cuda.syncthreads()
        model, hit = 0, 0
        for i in range(thread, (right - left) * words, cuda.blockDim.x):
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
        out[n, c, 0] = total[0] - 2 * total[1]
        out[n, c, 1] = total[0]
        out[n, c, 2] = total[1]


def available() -> bool:
    """A device is there (or its simulator)."""
    try:
        return bool(cuda.is_available())
    except Exception:  # noqa: BLE001 - whatever a half-installed driver raises, it means no
        return False


_frame: tuple[NDArray[np.uint8], Any] | None = None
_lock = threading.Lock()


def _masks_on_device(prepared: PreparedMasks) -> Any:
    """The masks' words on the device; sent once for all calls with the same prepared masks."""
    global _frame
    with _lock:
        if _frame is None or _frame[0] is not prepared.masks:
            m = prepared.masks
            packed = np.packbits(m.transpose(0, 2, 1), axis=2, bitorder="little")
            words = np.zeros((m.shape[0], m.shape[2], 4 * -(-packed.shape[2] // 4)), dtype=np.uint8)
            words[:, :, : packed.shape[2]] = packed
            _frame = prepared.masks, cuda.to_device(words.view("<u4"))
        return _frame[1]


def silhouette_xor(
    poses: NDArray[np.float64],
    tree: TreeArrays,
    mesh: LaneMesh,
    prepared: PreparedMasks,
    boxes: NDArray[np.int64],
    areas: NDArray[np.int64],
) -> NDArray[np.int64]:
    """(N, C, 3) = (xor, model, intersection) pixels of poses (N, D) inside boxes (C, 4) whose masks have areas (C,)."""
    if not available():
        raise InputError(
            "No CUDA device can be used here; install the cuda extra and NVIDIA's driver, or choose the back end cpu."
        )
    views, joints, vertices = len(prepared.masks), len(tree.parents), len(mesh.vertices)
    if prepared.masks.shape[1] > 32 * WORDS:
        raise InputError(f"Images of {prepared.masks.shape[1]} rows are too high for the CUDA back end; choose cpu.")
    out = np.zeros((len(poses), views, 3), dtype=np.int64)
    if not len(mesh.faces):
        out[..., 0] = np.where(prepared.usable, areas, 0)
        return out
    masks = _masks_on_device(prepared)
    skeleton = [cuda.to_device(a) for a in tree[:6]]
    body = [cuda.to_device(a) for a in (mesh.vertices, mesh.start, mesh.joint, mesh.weight)]
    faces, box, usable = (cuda.to_device(a) for a in (mesh.faces, boxes, prepared.usable))
    projections = cuda.to_device(prepared.projections)
    for begin in range(0, len(poses), POSES):
        q = cuda.to_device(np.ascontiguousarray(poses[begin : begin + POSES]))
        n = q.shape[0]
        frames, centres = (cuda.device_array((n, joints, k), np.float64) for k in (9, 3))
        maps = cuda.device_array((n, joints, 12), np.float32)
        homogeneous = cuda.device_array((n, views, vertices, 3), np.float32)
        counts = cuda.to_device(np.zeros((n, views, 3), dtype=np.int64))
        joint_maps[-(-n // 32), 32](q, *skeleton, frames, centres, maps)
        skin_and_project[(-(-vertices // THREADS), n), THREADS](q, maps, *body, projections, homogeneous)
        draw_and_count[(n, views), THREADS](homogeneous, faces, mesh.one_sided, masks, usable, box, counts)
        out[begin : begin + n] = counts.copy_to_host()
    out[..., 0] += np.where(prepared.usable, areas, 0)
    return out
