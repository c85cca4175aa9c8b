"""Checks that every kernel, selector and weight must pass, discovered from their modules.

A new one is found by its signature; without an example here the suite fails, so none escapes.
"""

import inspect
from dataclasses import fields
from types import ModuleType

import numpy as np
import pytest

from hypose.inference import annealing, kernels, resampling
from hypose.inference.hypotheses import Hypotheses

D = 4
LOWER, UPPER = np.array([-2.0, -1.0, -np.inf, -0.5]), np.array([2.0, 1.0, np.inf, 0.5])
SIGMA = np.array([0.5, 3.0, 0.2, 0.0])
SOME = np.array([True, False, True, False])


def gaussian():
    return kernels.GaussianDiffusion(SIGMA, LOWER, UPPER)


KERNELS = {
    "stay": [kernels.stay],
    "GaussianDiffusion": [
        gaussian(),
        kernels.GaussianDiffusion(SIGMA),
        kernels.GaussianDiffusion(np.zeros(D)),
    ],
    "AdaptiveDiffusion": [
        kernels.AdaptiveDiffusion(0.5),
        kernels.AdaptiveDiffusion(0.5, lower=LOWER, upper=UPPER),
        kernels.AdaptiveDiffusion(0.0),
    ],
    "RejectionSampling": [
        kernels.RejectionSampling(gaussian(), lambda x: -np.square(x).sum(-1), tau=0.7, trials=5),
        kernels.RejectionSampling(gaussian(), lambda x: np.full(x.shape[:-1], -np.inf), trials=2),
        kernels.RejectionSampling(gaussian(), lambda x: np.full(x.shape[:-1], np.nan), trials=2),
    ],
}
SELECTORS = {
    "systematic": [resampling.systematic],
    "keep": [resampling.keep],
    "LayeredResampling": [resampling.LayeredResampling(SOME), resampling.LayeredResampling(np.zeros(D, bool))],
}
RATES = [{"beta": 0.5}, {"beta": 0.0}, {}, {"survival": 1.0}, {"survival": 1e-3}]
# what looks like one of them by its signature but is the type itself
PROTOCOLS = {"Kernel", "Weigh", "Resample", "Energy", "LogPrior", "Estimate"}


def discovered(module: ModuleType, arguments: tuple[str, ...]) -> set[str]:
    """Names of the public functions and classes of a module that are called with these arguments."""
    found = set()
    for name, thing in vars(module).items():
        if name.startswith("_") or name in PROTOCOLS or getattr(thing, "__module__", "") != module.__name__:
            continue
        call = vars(thing).get("__call__") if inspect.isclass(thing) else thing
        if callable(call):
            names = tuple(p for p in inspect.signature(call).parameters if p != "self")
            if names == arguments:
                found.add(name)
    return found


def examples(table: dict) -> list:
    return [pytest.param(x, id=f"{name}-{i}") for name, xs in table.items() for i, x in enumerate(xs)]


def test_every_part_has_an_example():
    assert discovered(kernels, ("h", "frame", "rng")) == set(KERNELS)
    assert discovered(resampling, ("h", "rng")) == set(SELECTORS)
    assert discovered(annealing, ("h", "frame")) == {"SmoothedWeight"}


def population(shape: tuple[int, ...], lost: bool = False) -> Hypotheses:
    rng = np.random.default_rng(7)
    values = np.clip(rng.normal(size=(*shape, D)), LOWER, UPPER)
    log_weights = np.full(shape, -np.inf) if lost else rng.normal(size=shape) * 3 - 1000
    columns = {"velocity": rng.normal(size=values.shape), "cost": rng.random(shape)}
    origin, role = rng.integers(0, 3, shape), rng.integers(0, 2, shape)
    return Hypotheses(values, log_weights, origin, role, ("start",), columns)


POPULATIONS = {
    "plain": population((60,)),
    "single": population((1,)),
    "batch": population((3, 20)),
    "batch2": population((2, 1, 20)),
    "lost": population((25,), lost=True),
}


def snapshot(h: Hypotheses) -> list[bytes]:
    arrays = [getattr(h, f.name) for f in fields(h) if f.name != "columns" and getattr(h, f.name) is not None]
    return [np.asarray(a).tobytes() for a in [*arrays, *h.columns.values()]]


def well_formed(h: Hypotheses, like: Hypotheses) -> None:
    assert h.values.shape[:-2] == like.values.shape[:-2] and h.values.shape[-1] == like.values.shape[-1]
    assert h.origin.dtype == h.role.dtype == np.int32 and h.values.dtype == np.float64
    assert np.isfinite(h.values).all()
    weights = h.weights
    assert np.isfinite(weights).all() and (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(-1), 1, rtol=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("h", POPULATIONS.values(), ids=POPULATIONS.keys())
@pytest.mark.parametrize("kernel", examples(KERNELS))
def test_kernels(kernel, h):
    before = snapshot(h)
    moved = kernel(h, None, np.random.default_rng(3))
    assert snapshot(h) == before
    well_formed(moved, h)
    assert moved.values.shape == h.values.shape
    np.testing.assert_array_equal(moved.log_weights, h.log_weights)
    assert snapshot(moved) == snapshot(kernel(h, None, np.random.default_rng(3)))
    if getattr(kernel, "lower", None) is not None:
        assert (moved.values >= LOWER).all() and (moved.values <= UPPER).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("h", POPULATIONS.values(), ids=POPULATIONS.keys())
@pytest.mark.parametrize("selector", examples(SELECTORS))
def test_selectors(selector, h):
    before = snapshot(h)
    chosen = selector(h, np.random.default_rng(3))
    assert snapshot(h) == before
    well_formed(chosen, h)
    assert snapshot(chosen) == snapshot(selector(h, np.random.default_rng(3)))
    if selector is not resampling.keep:
        np.testing.assert_array_equal(chosen.log_weights, np.full(chosen.origin.shape, -np.log(chosen.count)))
    for d in range(D):  # nothing is invented: each coordinate comes from the set
        assert np.isin(chosen.values[..., d], h.values[..., d]).all()


ENERGIES = {
    "plain": np.random.default_rng(1).random((3, 40)),
    "equal": np.full(40, 0.3),
    "ties": np.repeat([1.0, 2.0], 20),
    "some not finite": np.where(
        np.arange(40) % 3 == 0, np.array([np.nan, np.inf, -np.inf, 1.0])[np.arange(40) % 4], 0.5
    ),
    "none finite": np.array([np.nan, np.inf, -np.inf]),
    "huge": np.array([-1e308, 1e308, 0.0, 1.0]),
    "tiny differences": 1e6 + 1e-8 * np.arange(30.0),
    "subnormal": np.array([0.0, 5e-324, 1.0, 2.0]),
    "one": np.array([0.7]),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("energies", ENERGIES.values(), ids=ENERGIES.keys())
@pytest.mark.parametrize("rate", RATES)
def test_weights(rate, energies):
    h = Hypotheses.uniform(np.zeros((*energies.shape, D)))
    before = energies.tobytes()
    log_weights = annealing.SmoothedWeight(lambda h, frame: energies, **rate)(h, None)
    beta = annealing.solve_annealing_rate(energies, 0.15)
    assert energies.tobytes() == before
    assert log_weights.shape == energies.shape and beta.shape == energies.shape[:-1]
    assert np.isfinite(beta).all() and (beta >= 0).all()
    assert not np.isnan(log_weights).any() and (log_weights <= 0).all()
    np.testing.assert_array_equal(np.isneginf(log_weights), ~np.isfinite(energies))
    weighted = h.reweighted(log_weights)
    well_formed(weighted, h)
    kept = np.where(np.isfinite(energies), energies, np.inf)  # a lower energy never weighs less
    order = np.argsort(kept, axis=-1)
    assert (np.diff(np.take_along_axis(weighted.weights, order, -1), axis=-1) <= 0).all()
