"""numba-cuda: the layers of a particle filter on an NVIDIA device; random numbers in, weighted sets out.

Four launches a layer, and nothing waits for the processor in between: step and joint frames (a thread per particle),
skinning and projection, drawing and counting (cuda.py), and energies, exponent, weights and ancestors (one block). The
definitions are those of hypose.inference: GaussianDiffusion, Annealed with SurvivalRate or FixedSelectivity on eq. 2.8,
systematic selection of the coordinates filtered so far (Alcoverro 2014, Algorithms 3 and 4).
"""

# pyright: reportOperatorIssue=false, reportOptionalSubscript=false
from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import cuda, int32
from numpy.typing import NDArray

from hypose.compute.arrays import TreeArrays
from hypose.compute.silhouettes import cuda as scorer
from hypose.compute.silhouettes.lane_mesh import LaneMesh
from hypose.compute.silhouettes.layers import SearchLayers, WeightedSets
from hypose.compute.silhouettes.reach import whole_images
from hypose.compute.solver.terms import PreparedMasks

Array = NDArray[np.float64]

LANES = 32
"""Threads that add up the weights of one exponent."""
SELECTING = 512
"""Threads of the block that selects; a power of two, LANES times another one."""
STEPPING = 32
"""Threads of a block that moves particles: few, so that all multiprocessors have some."""
BITS = 56
"""Halvings of the exponent's range, as the bisection on the processor has them; SELECTING / LANES exponents are tried
at a time here."""


@cuda.jit
def step_and_turn(layer, values, chosen, filtered, noise, first, width, place, sigma, lower, upper, tree, maps):
    """values (L + 1, N, D): row `layer`, selected and moved, into the next one, whose joint maps are maps (N, J, 12).

    chosen (L + 1, N) i4: ancestors, whose coordinates filtered (L + 1, D) are taken; noise: standard normal numbers,
    those of the layer (N, width[layer]) from first[layer] on; place (L, D) i4: a coordinate's column there, -1: it is
    not moved; sigma (L, D) its step; lower, upper (D,): mirrored there once, then clamped."""
    n = cuda.grid(1)
    if n >= values.shape[1]:
        return
    ancestor = chosen[layer, n]
    for d in range(values.shape[2]):
        x = values[layer, ancestor if filtered[layer, d] else n, d]
        k = place[layer, d]
        if k >= 0:
            x += noise[first[layer] + n * width[layer] + k] * sigma[layer, d]
            x = max(min(x, 2 * upper[d] - x), 2 * lower[d] - x)
            x = min(max(x, lower[d]), upper[d])
        values[layer + 1, n, d] = x
    parents, kind, dof_start, dof_count, axes, joints = tree
    scorer.turn_joints(n, values[layer + 1, n], parents, kind, dof_start, dof_count, axes, joints, maps)


@cuda.jit(device=True)
def least(part, t, value):
    """The least of what every thread t of the block gives, to all of them; part: shared, a number per thread."""
    part[t] = value
    cuda.syncthreads()
    half = cuda.blockDim.x >> 1
    while half > 0:
        if t < half:
            part[t] = min(part[t], part[t + half])
        cuda.syncthreads()
        half >>= 1
    out = part[0]
    cuda.syncthreads()
    return out


@cuda.jit
def weigh_and_select(layer, counts, masks, survival, drawn, log_weights, energies, below, chosen):
    """log_weights (L, N) = -beta (E - min E), E by eq. 2.8 of counts (N, C, 3), which lack the masks' own pixels, and
    ancestors chosen (L + 1, N), row layer + 1, by systematic selection.

    masks (C, 2): the masks' pixels and what counts as the whole person, 0: not usable; survival (L,): the share of the
    set that is to live on; drawn (2, L): the exponent, solved for where survival is a number, and where selection
    begins, in [0, 1). energies (N,), below (N,) i4: scratch. One block."""
    t, n = cuda.threadIdx.x, counts.shape[0]
    part = cuda.shared.array(SELECTING, np.float64)
    other = cuda.shared.array(SELECTING, np.float64)
    base = largest = smallest = math.inf
    for i in range(t, n, cuda.blockDim.x):
        energy = 0.0
        for c in range(counts.shape[1]):
            if masks[c, 1] > 0:
                energy += (counts[i, c, 0] + masks[c, 0]) / masks[c, 1]
        energies[i] = energy
        base = min(base, energy)
    base = least(part, t, base)
    for i in range(t, n, cuda.blockDim.x):
        excess = energies[i] - base
        largest = min(largest, -excess)
        if excess > 0:
            smallest = min(smallest, excess)
    largest, smallest = -least(part, t, largest), least(part, t, smallest)
    beta = drawn[0, layer]
    if not math.isnan(survival[layer]):
        wanted = survival[layer] * n
        if smallest == math.inf:  # all the same
            beta = 1.0
        elif survival[layer] >= 1.0:
            beta = 0.0
        else:
            low, high = math.log(1e-7) - math.log(largest), min(math.log(800.0) - math.log(smallest), 700.0)
            tried, lane, own = cuda.blockDim.x // LANES, t % LANES, t // LANES
            for _ in range(1 + int(BITS * math.log(2.0) / math.log(tried + 1.0))):
                step = (high - low) / (tried + 1)
                b, total, squares = math.exp(low + step * (own + 1)), 0.0, 0.0
                for i in range(lane, n, LANES):
                    w = math.exp(-b * (energies[i] - base))
                    total += w
                    squares += w * w
                part[t], other[t] = total, squares
                cuda.syncthreads()
                if lane == 0:
                    for k in range(1, LANES):
                        total += part[t + k]
                        squares += other[t + k]
                cuda.syncthreads()
                if lane == 0:
                    part[own] = 1.0 if total * total > wanted * squares else 0.0
                cuda.syncthreads()
                passed = 0
                while passed < tried and part[passed] > 0:
                    passed += 1
                low += step * passed
                high = low + step
                cuda.syncthreads()
            beta = math.exp(0.5 * (low + high))
    # cumulated weights: of a run of particles per thread, then of all runs before it
    run = (n + cuda.blockDim.x - 1) // cuda.blockDim.x
    total = 0.0
    for i in range(t * run, min((t + 1) * run, n)):
        total += math.exp(-beta * (energies[i] - base))
    part[t] = total
    cuda.syncthreads()
    reach = 1
    while reach < cuda.blockDim.x:
        before = part[t - reach] if t >= reach else 0.0
        cuda.syncthreads()
        part[t] += before
        cuda.syncthreads()
        reach <<= 1
    whole = part[cuda.blockDim.x - 1]
    cumulated = part[t - 1] if t > 0 else 0.0
    for i in range(t * run, min((t + 1) * run, n)):
        weight = -beta * (energies[i] - base)
        log_weights[layer, i] = weight
        cumulated += math.exp(weight)
        share = cumulated / whole
        below[i] = n if share >= 1.0 or i == n - 1 else min(max(int32(math.ceil(n * share - drawn[1, layer])), 0), n)
    cuda.syncthreads()
    if t == 0:
        drawn[0, layer] = beta
    for j in range(t, n, cuda.blockDim.x):
        low_row, high_row = 0, n - 1  # the first row with more than j points below its cumulated weight
        while low_row < high_row:
            middle = (low_row + high_row) >> 1
            if below[middle] > j:
                high_row = middle
            else:
                low_row = middle + 1
        chosen[layer + 1, j] = low_row


class _Room(NamedTuple):
    """What a search of this size keeps on the device; noise: also a page that the device reads from directly."""

    values: Any
    rows: tuple[Any, ...]
    chosen: Any
    maps: Any
    pixels: Any
    counts: Any
    energies: Any
    log_weights: Any
    below: Any
    page: Any
    noise: Any


@lru_cache(4)
def _room(layers: int, particles: int, dof: int, joints: int, views: int, vertices: int, noise: int) -> _Room:
    values = cuda.device_array((layers + 1, particles, dof), np.float64)
    return _Room(
        values,
        tuple(values[k] for k in range(layers + 1)),
        cuda.to_device(np.zeros((layers + 1, particles), np.int32)),
        cuda.device_array((particles, joints, 12), np.float32),
        cuda.device_array((particles, views, vertices, 4), np.float32),
        cuda.device_array((particles, views, 3), np.int64),
        cuda.device_array(particles, np.float64),
        cuda.device_array((layers, particles), np.float64),
        cuda.device_array(particles, np.int32),
        cuda.pinned_array(noise, np.float64),
        cuda.device_array(noise, np.float64),
    )


class _Steps(NamedTuple):
    """What step_and_turn and weigh_and_select read of the layers, the same in all frames."""

    filtered: Any
    first: Any
    width: Any
    place: Any
    sigma: Any
    lower: Any
    upper: Any
    survival: Any


@lru_cache(8)
def _steps(shape: tuple[int, int], particles: int, *layers: bytes) -> _Steps:
    sigma, filtered, lower, upper, survival = (
        np.frombuffer(a, np.bool_ if k == 1 else np.float64) for k, a in enumerate(layers)
    )
    sigma = sigma.reshape(shape)
    width = (sigma > 0).sum(1)
    taken = np.zeros((shape[0] + 1, shape[1]), np.bool_)
    taken[1:] = filtered.reshape(shape)
    first = particles * np.concatenate([[0], np.cumsum(width)])
    place = np.where(sigma > 0, np.cumsum(sigma > 0, 1) - 1, -1).astype(np.int32)
    return _Steps(*(cuda.to_device(a.copy()) for a in (taken, first, width, place, sigma, lower, upper, survival)))


def layered_search(
    poses: Array,
    tree: TreeArrays,
    mesh: LaneMesh,
    vertices: NDArray[Any],
    prepared: PreparedMasks,
    layers: SearchLayers,
) -> WeightedSets:
    """See `compute.layered_search`. vertices: the array that mesh.vertices were taken from."""
    there = scorer.kept_on_device(tree, mesh, vertices, prepared)
    (count, dof), depth, views = poses.shape, len(layers.sigma), len(prepared.masks)
    told = (a.tobytes() for a in (layers.sigma, layers.filtered, layers.lower, layers.upper, layers.survival))
    steps = _steps(layers.sigma.shape, count, *told)
    numbers = sum(block.size for block in layers.noise)
    room = _room(depth, count, dof, len(tree.parents), views, len(mesh.vertices), numbers)
    np.concatenate([block.ravel() for block in layers.noise], out=room.page)
    room.noise.copy_to_device(room.page)
    room.rows[0].copy_to_device(poses)
    counted = np.where(prepared.usable, [prepared.areas, prepared.norm], 0.0).T
    boxes, masks = cuda.to_device(whole_images(prepared)), cuda.to_device(np.ascontiguousarray(counted))
    drawn = cuda.to_device(np.stack([layers.betas, layers.u]))
    blocks = -(-count // STEPPING)
    for k in range(depth):
        step_and_turn[blocks, STEPPING](
            *(k, room.values, room.chosen, steps.filtered, room.noise, steps.first, steps.width, steps.place),
            *(steps.sigma, steps.lower, steps.upper, there.tree, room.maps),
        )
        scorer.count(room.rows[k + 1], room.maps, there, boxes, False, room.pixels, room.counts)
        weigh_and_select[1, SELECTING](
            *(k, room.counts, masks, steps.survival, drawn),
            *(room.log_weights, room.energies, room.below, room.chosen),
        )
    sets = room.values.copy_to_host()[1:], room.log_weights.copy_to_host(), drawn.copy_to_host()[0]
    return WeightedSets(*sets, room.chosen.copy_to_host()[1:].astype(np.intp))
