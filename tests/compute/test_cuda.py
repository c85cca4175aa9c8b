"""The CUDA kernels against the reference, run in numba's simulator (a Python thread per device thread: tiny scenes)."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hypose import compute
from hypose.errors import InputError
from tests import missing
from tests.capsule_person import capsule_person, random_pose, ring

ROOT = Path(__file__).parents[2]
CASES = ("whole", "boxes", "parts", "border", "near", "unusable")


def simulated(tmp_path):
    """Counts (cuda, reference) of every case, computed in a process where numba simulates the device."""
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1", "PYTHONPATH": str(ROOT)}
    code = f"from tests.compute.test_cuda import run; run({str(tmp_path / 'counts.npz')!r})"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, cwd=ROOT)
    if "CudaSupportError" in done.stderr or "No module named 'numba.cuda'" in done.stderr:
        missing.skip("the CUDA back end, in numba's simulator", "pip install numba-cuda")
    assert done.returncode == 0, done.stderr[-3000:]
    with np.load(tmp_path / "counts.npz") as counts:
        return {name: counts[name] for name in counts.files}


def run(path):
    from hypose.compute.silhouettes import cuda

    cuda.THREADS = 4  # a Python thread each
    body, rig = capsule_person(0.12), ring(2, f=80.0, size=(40, 48))
    rng = np.random.default_rng(5)
    poses = np.stack([random_pose(body, rng) for _ in range(2)])
    masks = np.zeros((2, 48, 40), np.uint8)
    masks[:, 10:40, 12:30] = 1
    tree, mesh = body.skeleton.tree, body.coarse.arrays
    prepared = compute.prepare_masks(masks, [True, True], rig.sizes, rig.projections)
    aside, close = poses.copy(), poses.copy()
    aside[:, :3] += [0.4, 0.2, 0.3]
    close[:, :2] += rig[0].position[:2] * 0.93
    upper = np.isin(body.coarse.main_joint[mesh.faces[:, 0]], [0, 1, 2, 3, 4])
    cases = {
        "whole": (poses, {}),
        "boxes": (poses[:1], {"boxes": [[10, 30, 5, 33], [0, 40, 32, 45]]}),
        "parts": (poses[1:], {"faces": upper}),
        "border": (aside[:1], {}),
        "near": (close[:1], {}),
        "unusable": (poses[:1], {}),
    }
    out = {}
    for name, (q, options) in cases.items():
        data = prepared._replace(usable=np.array([True, False])) if name == "unusable" else prepared
        for backend in ("cuda", "reference"):
            with compute.use(backend):
                out[f"{name}-{backend}"] = compute.silhouette_xor(q, tree, mesh, data, **options)
        if name == "whole":
            cuda.WORDS = 32  # drawn in several bands of columns, as large images are
            with compute.use("cuda"):
                np.testing.assert_array_equal(compute.silhouette_xor(q, tree, mesh, data), out["whole-cuda"])
            cuda.WORDS = 8192
    np.savez(path, **out)


@pytest.fixture(scope="module")
def counts(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("cuda"))


@pytest.mark.parametrize("case", CASES)
def test_simulated_device_counts_what_the_reference_counts(counts, case):
    ours, plain = counts[f"{case}-cuda"], counts[f"{case}-reference"]
    assert np.abs(ours - plain).max() <= (4 if case == "near" else 2)
    assert plain[:, 0, 1].max() > (5 if case != "whole" else 100)


def test_without_a_device_the_back_end_says_what_to_do():
    from hypose.compute.silhouettes import cuda

    if cuda.available():
        pytest.skip("a CUDA device is here")
    body, rig = capsule_person(0.12), ring(1, f=80.0, size=(40, 48))
    prepared = compute.prepare_masks(np.ones((1, 48, 40), np.uint8), [True], rig.sizes, rig.projections)
    with pytest.raises(InputError, match="choose the back end cpu"), compute.use("cuda"):
        compute.silhouette_xor(body.skeleton.rest_pose()[None], body.skeleton.tree, body.coarse.arrays, prepared)
