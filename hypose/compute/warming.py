"""Compiling before it is needed: every kernel of a part of the room is called once, on a toy body before a toy camera.

What is on disk already is found there. What is not is compiled by several processes at once: numba compiles one kernel
at a time in each. They leave what they made in the cache, and whoever asked takes it from there.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hypose.compute.arrays import BALL, FIXED, MeshArrays, TreeArrays
from hypose.compute.compiled import can_keep, not_kept, ready
from hypose.compute.monocular import mono
from hypose.compute.pictures import picture_to_mask
from hypose.compute.pictures.parts import parts_against_mask
from hypose.compute.selection import default_threads, use
from hypose.compute.silhouettes import glance, reach
from hypose.compute.solver import outline_rows
from hypose.compute.solver.terms import (
    NO_KEYPOINTS,
    NO_POINTS,
    ContourArrays,
    PriorArrays,
    SolveLimits,
    no_depth,
)

# imports what this process would, nothing of the folder that it happens to stand in
_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[1].split('\\n'); from hypose import compute; "
    "from hypose.compute.warming import run_for_another; sys.exit(run_for_another(compute, sys.argv[2:]))"
)


def _toy() -> tuple[TreeArrays, MeshArrays, np.ndarray, np.ndarray]:
    """A body of one ball joint and a tetrahedron, its pose (6,), and a pinhole (1, 3, 4) that sees it."""
    tree = TreeArrays(
        np.array([-1, 0]),
        np.array([BALL, FIXED]),
        np.array([3, 0]),
        np.array([3, 0]),
        np.tile(np.eye(3), (2, 1)),
        np.zeros((2, 3)),
        np.zeros(6, dtype=np.int64),
    )
    mesh = MeshArrays(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32),
        np.array([[0, 2, 0, 2], [2, 1, 0, 3], [1, 0, 0, 1], [1, 3, 1, 3], [3, 0, 1, 2], [3, 2, 2, 3]], dtype=np.int32),
        np.zeros((4, 4), dtype=np.int32),
        np.tile(np.float32([1, 0, 0, 0]), (4, 1)),
        np.ones(4, dtype=np.int32),
    )
    return tree, mesh, np.array([0.0, 0, 4, 0, 0, 0]), np.array([[[40.0, 0, 16, 0], [0, 40, 16, 0], [0, 0, 1, 0]]])


def _mask() -> tuple[np.ndarray, np.ndarray]:
    mask = np.zeros((1, 32, 32), dtype=np.uint8)
    mask[:, 8:24, 8:24] = 1
    return mask, np.array([[32, 32]])


def _scorer(compute: Any) -> None:
    tree, mesh, q, projection = _toy()
    mask, sizes = _mask()
    compute.skin(*compute.forward_kinematics(q[None], tree), tree, mesh)
    prepared = compute.prepare_masks(mask, np.array([True]), sizes, projection)
    limb = np.array([False, True])
    compute.silhouette_xor(q[None], tree, mesh, prepared, np.array([[0, 32, 0, 32]]), moving=limb)
    compute.limb_energies(np.repeat(q[None], 40, 0), tree, mesh, prepared, limb)
    rest = reach.standing(q, tree, mesh, prepared, limb)
    reach.score_points(np.zeros((1, 1, 3)), np.ones(1), np.eye(3), q[:3], prepared, rest)


def _pictures(compute: Any) -> None:
    picture_to_mask.warm_up()
    glance.warm_up()


def _outlines(compute: Any) -> None:
    (_, mesh, _, _), (mask, sizes) = _toy(), _mask()
    compute.outline_points(compute.signed_distance(mask, sizes)[0], (32, 32), 16)
    picture_to_mask.warm_up_masks()
    uv, z, part = mesh.vertices[:, :2], mesh.vertices[:, 2], np.zeros(len(mesh.faces), np.uint16)
    parts_against_mask(mask[0], uv, z, mesh.faces, part, 1, uv, z)


def _shape(compute: Any) -> None:
    outline_rows.warm_up(_toy()[1])


def _evidence(compute: Any) -> tuple[np.ndarray, tuple[Any, ...], Any]:
    """A pose, and all that the solver takes beside it."""
    tree, mesh, q, projection = _toy()
    mask, sizes = _mask()
    sdf = compute.signed_distance(mask, sizes)
    outline = np.zeros((1, 16, 2), dtype=np.float32)
    contours = ContourArrays(
        sdf, outline, np.array([True]), sizes, projection, 1.0, 1.0, 2.0, 4.0, 2.0, 2, np.ones(1), 0 * sizes, sizes
    )
    priors = PriorArrays(np.zeros((1, 6)), np.ones((1, 6)), np.full(6, -np.inf), np.full(6, np.inf))
    given = (tree, mesh, contours, NO_KEYPOINTS, NO_POINTS, no_depth(), priors)
    return q, given, compute.workspace(tree, mesh, 32, 32)


def _solver(compute: Any) -> None:
    q, given, ws = _evidence(compute)
    compute.solve(q, *given, SolveLimits(1, 0, 1e-3, 1e-2, 4), ws)
    compute.joint_covariances(q, given[0], np.eye(6))


def _monocular(compute: Any) -> None:
    tree, mesh, q, projection = _toy()
    mono.warm_up(tree, mesh, q, projection[0])


PARTS: dict[str, Callable[[Any], None]] = {
    "solver": _solver,
    "scorer": _scorer,
    "outlines": _outlines,
    "shape": _shape,
    "pictures": _pictures,
    "monocular": _monocular,
}
"""By name; solver: poses from contours, key points, points and depth; scorer: silhouettes of many poses; outlines: what
is followed of masks, and a body's parts against them; shape: what a body is fitted to outlines with; pictures: masks
from pictures; monocular: one camera."""

_COST = {"solver": 30, "scorer": 24, "outlines": 7, "shape": 4, "pictures": 8, "monocular": 30}
"""Compiling them, in any unit."""


def run(compute: Any, names: Sequence[str]) -> None:
    """Call all kernels of these parts in this process; compute: the room."""
    with use("numba"), _no_collection():
        for name in names:
            PARTS[name](compute)


def run_for_another(compute: Any, names: Sequence[str]) -> int:
    """`run` for the process at the other end of standard input, with which this one ends; 1: not all is on disk."""

    def end_with_it() -> None:
        os.read(0, 1)
        os._exit(1)

    threading.Thread(target=end_with_it, daemon=True).start()
    run(compute, names)
    return int(not_kept() > 0)


def warm(compute: Any, names: Sequence[str], load: bool) -> None:
    """See `compute.warm_up`."""
    missing = [n for n in PARTS if n in names and not _is_ready(n)]
    if missing:
        before = not_kept()
        # nobody could take from others what they cannot keep
        shares = _shared_out(missing, min(default_threads(), len(missing)) if can_keep() else 1)
        with _processes(shares[1:]) as made:
            run(compute, shares[0])
        run(compute, [n for n in (names if load else missing) if load or n not in (*shares[0], *made)])
        for name in missing if not_kept() == before else ():
            _note_ready(name)
    elif load:
        run(compute, names)


def kept(names: Sequence[str]) -> bool:
    """See `compute.kept`."""
    return all(map(_is_ready, names))


def _shared_out(names: Sequence[str], count: int) -> list[list[str]]:
    """The parts in `count` shares of about the same cost, the dearest part in the first; in the order of PARTS."""
    shares: list[list[str]] = [[] for _ in range(count)]
    for name in sorted(names, key=lambda n: -_COST[n]):
        min(shares, key=lambda share: sum(_COST[n] for n in share)).append(name)
    return [[n for n in PARTS if n in share] for share in shares]


def _is_ready(name: str) -> bool:
    file = ready(name)
    return file is not None and os.path.exists(file)  # which is False where we may not look


def _note_ready(name: str) -> None:
    file = ready(name)
    if file is not None:
        with contextlib.suppress(OSError):
            file.touch()


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """A compiler makes many objects that live, which Python's collector of cycles would look at again and again."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def _command(share: Sequence[str]) -> list[str]:
    return [sys.executable, "-c", _PROGRAM, "\n".join(map(str, sys.path)), *share]


@contextlib.contextmanager
def _processes(shares: Sequence[Sequence[str]]) -> Iterator[list[str]]:
    """A process for each share of parts; they have ended afterwards, and the list holds the parts that were done. What
    one of them could not do is no error here: whoever asked compiles it."""
    began: list[tuple[subprocess.Popen[bytes], Sequence[str]]] = []
    done: list[str] = []
    quiet = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        # in a program that Python is embedded in or frozen into, this is that program
        if Path(sys.executable or "").name.lower().startswith("python") and not getattr(sys, "frozen", False):
            for share in shares:
                with contextlib.suppress(OSError):
                    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
                    began.append((subprocess.Popen(_command(share), env=environment, **quiet), share))
        yield done
        for process, share in began:
            done += share if process.wait() == 0 else []
    finally:
        for process, _ in began:
            process.kill()
            process.communicate()
