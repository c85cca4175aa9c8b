"""The same bytes for any number of threads of the linear algebra library (set before numpy is loaded)."""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import hashlib
from functools import partial
import numpy as np
from hypose.inference.estimates import tangent_mean
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import AdaptiveDiffusion
from hypose.inference.layer import Layer, Recipe, search
from hypose.inference.layer import stream
from hypose.compute.losses import geman_mcclure
from hypose.compute.linear import SharedEquations, weighted_squares
from hypose.inference.annealing import SmoothedWeight
from hypose.inference.resampling import systematic

rng = np.random.default_rng(0)
weigh = SmoothedWeight(lambda h, z: (h.values**2).sum(-1))
layer = Layer(AdaptiveDiffusion(0.4), weigh, systematic)
start = Hypotheses.uniform(rng.normal(size=(600, 36)))
recipe = Recipe("r", (layer,) * 3, estimate=partial(tangent_mean, rotations=(3, 6)))
result = search(start, recipe, None, partial(stream, 0, 0))
a, b = rng.normal(size=(2000, 36)), rng.normal(size=2000)

hessian, gradient = weighted_squares(a, geman_mcclure(b**2)[1], b)
own = np.repeat(hessian[None, 6:, 6:], 5, 0)
cross = np.repeat(hessian[None, 6:, :6], 5, 0)
equations = SharedEquations(10 * hessian[:6, :6], gradient[:6], own, np.repeat(gradient[None, 6:], 5, 0), cross)
step = equations.reduced(0.01).step()
parts = result.estimate, result.resampled.values, result.weighted.log_weights, hessian, step
print(hashlib.sha256(b"".join(p.tobytes() for p in parts)).hexdigest())
"""


def digest(threads: int) -> str:
    names = "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"
    environment = {**os.environ, **dict.fromkeys(names, str(threads))}
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, cwd=root, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_the_number_of_threads_changes_nothing():
    assert digest(1) == digest(2) != ""
