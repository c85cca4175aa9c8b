"""The CUDA kernels against the reference and the search on the processor: in numba's simulator (a Python thread per
device thread: tiny scenes), and on a device where there is one."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hypose import compute
from hypose.errors import InputError
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import search
from hypose.inference.random_streams import stream
from hypose.tracking.device_search import search_frame
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.published_recipes import hpf, sir
from tests import missing
from tests.capsule_person import capsule_person, random_pose, ring

ROOT = Path(__file__).parents[2]
SIMULATOR = "NUMBA_ENABLE_CUDASIM"
CASES = ("whole", "boxes", "parts", "border", "near", "unusable")
FILTERS = {"hpf": hpf, "sir": sir, "hpf with exponents": partial(hpf, betas=[100.0] * 7)}


def run(path):
    """Counts and searches by both ways, into a file."""
    from hypose.compute.silhouettes import cuda, cuda_search

    particles = 300
    if SIMULATOR in os.environ:  # a Python thread each
        cuda.THREADS, cuda_search.STEPPING, cuda_search.SELECTING, cuda_search.LANES, particles = 4, 4, 8, 2, 5
    cuda.FEW = 0
    body, rig = capsule_person(0.12), ring(2, f=80.0, size=(40, 48))
    masks = np.zeros((2, 48, 40), np.uint8)
    masks[:, 10:40, 12:30] = 1
    np.savez(path, **counted(cuda, body, rig, masks), **searched(body, rig, masks, particles))


def counted(cuda, body, rig, masks):
    """{case-way: counts}"""
    rng = np.random.default_rng(5)
    poses = np.stack([random_pose(body, rng) for _ in range(2)])
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
    if SIMULATOR in os.environ:  # in several bands of columns, and lists of faces, as large images and bodies are
        sizes = cuda.WORDS, cuda.FACES
        cuda.WORDS, cuda.FACES = 16, 32
        with compute.use("cuda"):
            np.testing.assert_array_equal(compute.silhouette_xor(poses, tree, mesh, prepared), out["whole-cuda"])
        cuda.WORDS, cuda.FACES = sizes
    return out


def searched(body, rig, masks, particles):
    """{filter-way-what: of all layers}"""
    s, out = body.skeleton, {}
    given = Frame(0.0, 0, make_silhouettes(list(masks), rig))
    frame = prepare(given, body, s.rest_pose(), use_silhouettes=True, use_keypoints=False)
    noise = np.random.default_rng(7).standard_normal((particles, s.dof))
    h = Hypotheses.uniform(s.clamp(s.rest_pose() + 0.3 * noise * s.sigma))
    for name, make in FILTERS.items():
        recipe = make(body, particles=particles)
        if SIMULATOR in os.environ:
            recipe = replace(recipe, layers=recipe.layers[:2])
        for backend, find in (("cuda", search_frame), ("cpu", search)):
            with compute.use(backend):
                found = find(h, recipe, frame, partial(stream, 1, 0))
            key = f"{name}-{backend}"
            out[f"{key}-values"] = np.stack([r.weighted.values for r in found.reports])
            out[f"{key}-weights"] = np.stack([r.weighted.weights for r in found.reports])
            out[f"{key}-betas"] = np.stack([r.beta for r in found.reports])
            out[f"{key}-selected"], out[f"{key}-estimate"] = found.selected.values, found.estimate
    return out


@pytest.fixture(scope="module", params=["simulator", "device"])
def found(request, tmp_path_factory):
    """What `run` finds, in a process where numba simulates the device, or without, where there is one."""
    path = tmp_path_factory.mktemp("cuda") / "found.npz"
    found_in = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": found_in}
    if request.param == "simulator":
        environment[SIMULATOR] = "1"
    else:
        try:
            compute.require_cuda()
        except InputError:
            pytest.skip("no CUDA device is here")
    code = f"from tests.compute.test_cuda import run; run({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, cwd=ROOT)
    if "CudaSupportError" in done.stderr or "No module named 'numba.cuda'" in done.stderr:
        missing.skip("the CUDA back end, in numba's simulator", "pip install numba-cuda")
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Warning" not in done.stderr
    with np.load(path) as arrays:
        return {name: arrays[name] for name in arrays.files}


@pytest.mark.parametrize("case", CASES)
def test_counts_what_the_reference_counts(found, case):
    ours, plain = found[f"{case}-cuda"], found[f"{case}-reference"]
    assert np.abs(ours - plain).max() <= (4 if case == "near" else 2)
    assert plain[:, 0, 1].max() > (5 if case != "whole" else 100)


@pytest.mark.parametrize("name", FILTERS)
def test_searches_as_on_the_processor(found, name, request):
    on_device = "device" in request.node.callspec.id
    for what in ("betas", "estimate") if on_device else ("values", "weights", "betas", "selected", "estimate"):
        ours, plain = found[f"{name}-cuda-{what}"], found[f"{name}-cpu-{what}"]
        # a device rounds otherwise, and counts a pixel otherwise now and then
        close = {"rtol": 0.02, "atol": 0.02} if on_device else {"rtol": 1e-9, "atol": 1e-9}
        np.testing.assert_allclose(ours, plain, err_msg=what, **close)
    weights = found[f"{name}-cpu-weights"]
    assert weights.max() > 2 / weights.shape[-1]  # it does select


def test_without_a_device_the_back_end_says_what_to_do():
    from hypose.compute.silhouettes import cuda

    if cuda.device_name():
        pytest.skip("a CUDA device is here")
    body, rig = capsule_person(0.12), ring(1, f=80.0, size=(40, 48))
    prepared = compute.prepare_masks(np.ones((1, 48, 40), np.uint8), [True], rig.sizes, rig.projections)
    poses = np.tile(body.skeleton.rest_pose(), (cuda.FEW + 1, 1))
    with pytest.raises(InputError, match="use --compute auto"), compute.use("cuda"):
        compute.silhouette_xor(poses, body.skeleton.tree, body.coarse.arrays, prepared)
