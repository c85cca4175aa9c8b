"""Compile kernels before they are needed: every kernel of a group is called once, on a toy body before a toy camera.

Kernels that are not in the cache are compiled in several processes at once, because numba compiles one kernel at a time
in each process; they leave the result in the cache.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import cache
from pathlib import Path

import numpy as np

from hypose.compute import picture_to_mask, reach
from hypose.compute.arrays import (
    BALL,
    FIXED,
    NO_KEYPOINTS,
    NO_POINTS,
    ContourTerm,
    Cues,
    DepthArrays,
    DepthTerm,
    MeshArrays,
    PreparedMasks,
    PriorArrays,
    SolveSettings,
    Standing,
    TreeArrays,
    prepare_masks,
)
from hypose.compute.compiled import cache_file, failures, make_folder
from hypose.compute.kinematics import forward_kinematics, joint_frames, skin
from hypose.compute.linear import weighted_squares
from hypose.compute.parts import covered
from hypose.compute.rows import outline_points
from hypose.compute.scorer import limb_energies, silhouette_xor
from hypose.compute.solver import bounded_step, solve, workspace
from hypose.compute.threads import default_threads
from hypose.compute.zbuffer import rasterize

# it imports the same modules as this process, and nothing from the folder in which it runs
_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[1].split('\\n'); "
    "from hypose.compute.warming import run_for_another; run_for_another()"
)


def _toy() -> tuple[TreeArrays, MeshArrays, np.ndarray, PreparedMasks]:
    """Make a body of one ball joint and a tetrahedron, its pose (6,), and a pinhole's mask (32, 32) of a square."""
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
    mask, pinhole = np.zeros((1, 32, 32), dtype=np.uint8), np.array([[[40.0, 0, 16, 0], [0, 40, 16, 0], [0, 0, 1, 0]]])
    mask[:, 8:24, 8:24] = 1
    return tree, mesh, np.array([0.0, 0, 4, 0, 0, 0]), prepare_masks(mask, np.array([True]), [[32, 32]], pinhole)


def _scorer() -> None:
    """Call the scorers of silhouettes and of points."""
    tree, mesh, q, prepared = _toy()
    skin(*forward_kinematics(q[None], tree), tree, mesh)
    limb = np.array([False, True])
    silhouette_xor(q[None], tree, mesh, prepared, np.array([[0, 32, 0, 32]]), moving=limb)
    limb_energies(np.repeat(q[None], 40, 0), tree, mesh, prepared, limb)
    rest = Standing(np.zeros_like(prepared.bits), np.zeros((1, 2), dtype=np.int64))
    reach.score_points(np.zeros((1, 1, 3)), np.ones(1), np.eye(3), q[:3], prepared, rest)


def _outlines() -> None:
    """Call the kernels of a mask's outline and of a body's parts."""
    outline_points(np.zeros((32, 32), np.float32), (32, 32), 16)
    mesh = _toy()[1]
    covered(mesh.vertices[:, :2], mesh.vertices[:, 2] + 1, mesh.faces, (32, 32), closed=True)


def _solver(depth: DepthArrays | None = None) -> None:
    """Call the solver, with the arrays of a depth map or without depth."""
    tree, mesh, q, seen = _toy()
    sdf = np.zeros(seen.masks.shape, dtype=np.float32)
    outline, size = np.zeros((1, 16, 2), dtype=np.float32), seen.sizes
    given = sdf, outline, seen.usable, size, seen.projections, 1.0, 2.0, 4.0, 2.0, 16, 30.0
    contours = ContourTerm(*given, np.ones(1), 0 * size, size)
    priors = PriorArrays(np.zeros((1, 6)), np.ones((1, 6)), np.full(6, -np.inf), np.full(6, np.inf))
    cues, ws = Cues(contours, NO_KEYPOINTS, NO_POINTS, depth), workspace(tree, mesh, 32, 32)
    solve(q, tree, mesh, cues, priors, SolveSettings(1, 0), ws)


def _depth() -> None:
    """Call the solver with depth of no sensor."""
    none, first, sizes = np.zeros((0, 3)), np.zeros(1, np.int64), np.zeros((0, 2), np.int64)
    maps, ring = np.zeros((0, 1, 1), np.float32), np.zeros((0, 3), np.int32)
    surface = DepthTerm(none, none, np.zeros(0), first, none, maps, sizes, np.zeros((0, 3, 4)))
    _solver(DepthArrays(surface, first, ring))


def _monocular() -> None:
    """Call the kernels that draw a body for one camera, and those of its least-squares steps."""
    tree, mesh, q, _ = _toy()
    joint_frames(q, tree, np.zeros((2, 3, 3)), np.zeros((2, 3)), np.zeros((6, 6)))
    bounded_step(*weighted_squares(np.eye(1), np.ones(1), np.ones(1)), np.zeros(1), -np.ones(1), np.ones(1), 1.0)
    rasterize(mesh.vertices[:, :2], mesh.vertices[:, 2] + 1, mesh.faces, (32, 32))


KERNEL_GROUPS: dict[str, tuple[Callable[[], None], ...]] = {
    "solver": (_solver,),
    "scorer": (_scorer,),
    "outlines": (_outlines,),
    "pictures": (picture_to_mask.warm_up,),
    "monocular": (_outlines, _monocular),
    "depth": (_depth,),
}
"""Groups of kernels by name, the one that takes longest in mask tracking first. solver: poses from contours, key points
and points. scorer: silhouettes of many poses. outlines: outlines of masks, and a body's parts against them. pictures:
masks from pictures. monocular: one camera. depth: poses from depth as well.
"""


def _run(parts: Iterable[str]) -> None:
    """Call all kernels of these groups in this process, and mark the groups as ready in the cache."""
    was = gc.isenabled()
    gc.disable()  # a compiler makes many long-lived objects, which the collector would visit again and again
    try:
        for part in parts:
            for call in KERNEL_GROUPS[part]:
                call()
            mark = _mark(part)
            if mark is not None and not failures:
                with contextlib.suppress(OSError):
                    mark.touch()
    finally:
        if was:
            gc.enable()


TRACKING_KERNELS = ("solver", "scorer", "outlines", "pictures")
"""Groups of kernels that mask tracking needs."""


def warm_up(*names: str, load: bool = True, progress: Callable[[int, int], None] | None = None) -> float:
    """Compile groups of kernels, in one process per core where that is worth it; return the seconds that it took.

    names: names of KERNEL_GROUPS; none: TRACKING_KERNELS.
    load: whether to load kernels that are in the cache into this process too; else they are loaded at their first call.
    progress: called with how many of the groups that have to be compiled are done, when there are any.

    The first time on a machine this takes some tens of seconds; afterwards the compiled code is in the cache.
    """
    start = time.perf_counter()
    parts = [part for part in KERNEL_GROUPS if part in (names or TRACKING_KERNELS)]
    missing = [part for part in parts if not _is_ready(part)]
    total = len(missing) + 1  # the last step loads what the others have compiled
    report = progress if progress is not None and missing else lambda done, total: None
    report(0, total)
    # where Python is embedded in a program or frozen, sys.executable is that program
    if len(missing) > 1 and _can_keep() and Path(sys.executable or "").name.lower().startswith("python"):
        began: list[subprocess.Popen[bytes]] = []
        with ThreadPoolExecutor(default_threads()) as pool:
            try:
                jobs = [pool.submit(_in_another_process, part, began) for part in missing]
                for done, job in enumerate(as_completed(jobs), 1):
                    job.result()
                    report(done, total)
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
                for process in began:
                    process.kill()
    _run([part for part in parts if load or not _is_ready(part)])
    report(total, total)
    return time.perf_counter() - start


def kept(*names: str) -> bool:
    """Return whether all kernels of these groups are in the cache, for later starts."""
    return all(map(_is_ready, names))


def _is_ready(part: str) -> bool:
    """Return whether all kernels of a group are in the cache, by the existence of its mark."""
    mark = _mark(part)
    return mark is not None and os.path.exists(mark)


def _can_keep() -> bool:
    """Return whether this process will find what other processes compile."""
    mark = _mark("")
    if mark is None:
        return False
    try:
        make_folder(mark.parent)
        tempfile.TemporaryFile(dir=mark.parent).close()
    except OSError:
        return False
    return True


def _mark(part: str) -> Path | None:
    """Return the path of the file that marks a group as being in the cache; None without a cache folder."""
    return cache_file(part, "ready", _digest_of_room())


@cache
def _digest_of_room() -> str:
    """Compute the digest of all sources of this folder."""
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"\0".join(p.read_bytes() for p in sources)).hexdigest()


def _in_another_process(part: str, began: list[subprocess.Popen[bytes]]) -> None:
    """Compile a group in another process; where that fails, this process compiles it later.

    part: name of the group.
    began: gets the process, so that the caller can end it.
    """
    with (
        contextlib.suppress(OSError),
        subprocess.Popen(
            [sys.executable, "-P", "-c", _PROGRAM, "\n".join(map(str, sys.path)), part],
            cwd=Path(__file__).parent,
            env={**os.environ, "NUMBA_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        ) as process,
    ):
        began.append(process)
        process.wait()


def run_for_another() -> None:
    """Compile the kernel groups named on the command line; main program of a process that `warm_up` starts.

    The process ends when its standard input ends, which happens when the process that started it ends.
    """

    def watch() -> None:
        """End this process when its input ends."""
        sys.stdin.read()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    _run(sys.argv[2:])
