"""Recipes: the published particle filters and the product's default, as named data for the one search loop.

Every recipe is a function of the body and a few numbers. Published layer settings are the presets; the step sizes are
half of what one would first guess (too large is worse than too small: limbs jump) and the selectivity is solved for a
survival rate, because a fixed exponent <= 1 hardly selects on the flat energies of eq. 2.8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.fitting.articulated import SolveOptions
from hypose.geometry import Array
from hypose.inference.kernels import (
    Compose,
    GaussianDiffusion,
    HeavyTail,
    KeepFirst,
    UniformShare,
    filtered_mask,
    layered_sigma,
)
from hypose.inference.layer import Kernel, Layer, Recipe
from hypose.inference.selectivity import Annealed, FixedSelectivity, Selectivity, SurvivalRate
from hypose.inference.selectors import Elite, LayeredSystematic, keep, systematic
from hypose.tracking.costs import SilhouetteXor, no_evidence
from hypose.tracking.refinement import (
    ContourRefinement,
    InTurn,
    RefineComposite,
    RefinedEstimate,
    SolvePrediction,
    pose_mean,
)

THESIS = "Alcoverro, M. (2014). Stochastic optimization and interactive machine learning for human motion analysis."
DEUTSCHER = "Deutscher, J., Reid, I. (2005). Articulated body motion capture by stochastic search. IJCV 61(2)."
MACCORMICK = (
    "MacCormick, J., Isard, M. (2000). Partitioned sampling, articulated objects, and interface-quality hand tracking."
)
ISARD = "Isard, M., Blake, A. (1998). CONDENSATION - conditional density propagation for visual tracking. IJCV 29(1)."
CONTOURS = "Particles as proposals, bounded robust Gauss-Newton on two-way contours as the refinement (hypose)."

# the layers of the hierarchical filter (Alcoverro 2014, section 2.5.2): joints whose dof a layer filters first
HPF_LAYERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("torso", ("pelvis", "spine", "neck")),
    ("left_leg", ("left_hip", "left_knee", "left_ankle")),
    ("right_leg", ("right_hip", "right_knee", "right_ankle")),
    ("left_shoulder", ("left_clavicle", "left_shoulder")),
    ("right_shoulder", ("right_clavicle", "right_shoulder")),
    ("left_elbow", ("left_elbow",)),
    ("right_elbow", ("right_elbow",)),
)
# the limbs that the default recipe searches one at a time; the torso is where the contours are surest
LIMB_LAYERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    *HPF_LAYERS[1:3],
    ("left_arm", ("left_clavicle", "left_shoulder", "left_elbow")),
    ("right_arm", ("right_clavicle", "right_shoulder", "right_elbow")),
)
_TURNS = (0, 1, 0, 1)
"""the frames (modulo 2) in which each of LIMB_LAYERS is searched: one leg and one arm in every frame; one limb per
frame costs a tenth of the accuracy where the body is not the person's own"""


def partitions_of(skeleton: Skeleton, layers: Sequence[tuple[str, tuple[str, ...]]]) -> list[NDArray[np.int64]]:
    """The coordinate subset Psi_l of every layer."""
    return [skeleton.dofs_of(*joints) for _, joints in layers]


def sir(body: Body, particles: int = 4000, survival: float = 0.15, frame_rate: float = 25.0) -> tuple[Recipe, int]:
    """Plain particle filter: one layer over all coordinates. Source: Isard & Blake 1998 (Alcoverro 2014, Alg. 1)."""
    s = body.skeleton
    layer = Layer(_diffusion(s, step_sigma(s, frame_rate)), _weigh(body, SurvivalRate(survival)), systematic, "all")
    return Recipe("sir", (layer,), pose_mean(s), ISARD), particles


def apf(
    body: Body,
    particles: int = 240,
    layers: int = 15,
    survival: float = 0.30,
    decay: float = 0.8,
    frame_rate: float = 25.0,
) -> tuple[Recipe, int]:
    """Annealed particle filter: every layer moves all coordinates, with steps shrinking by `decay` per layer.

    Source: Deutscher & Reid 2005; 15 layers x 240 particles as run by Alcoverro 2014, section 2.4.
    """
    s = body.skeleton
    sigma = step_sigma(s, frame_rate)
    everything = [np.arange(s.dof)] * layers
    rows = tuple(
        Layer(
            _diffusion(s, layered_sigma(sigma, everything, decay, n)),
            _weigh(body, SurvivalRate(survival)),
            systematic,
            f"annealing {n}",
        )
        for n in range(layers)
    )
    return Recipe("apf", rows, pose_mean(s), DEUTSCHER), particles


def partitioned(
    body: Body, particles: int = 572, survival: float = 0.15, frame_rate: float = 25.0
) -> tuple[Recipe, int]:
    """Partitioned sampling: each layer moves only its own coordinates and resamples whole states.

    Source: MacCormick & Isard 2000 (Alcoverro 2014, section 2.2.5).
    """
    s = body.skeleton
    sigma = step_sigma(s, frame_rate)
    rows = []
    for (name, _), psi in zip(HPF_LAYERS, partitions_of(s, HPF_LAYERS), strict=True):
        own = np.zeros(s.dof)
        own[psi] = sigma[psi]
        rows.append(Layer(_diffusion(s, own), _weigh(body, SurvivalRate(survival)), systematic, name))
    return Recipe("partitioned", tuple(rows), pose_mean(s), MACCORMICK), particles


def hpf(
    body: Body,
    particles: int = 572,
    survival: float = 0.10,
    decay: float = 0.8,
    frame_rate: float = 25.0,
    betas: Sequence[float] | None = None,
) -> tuple[Recipe, int]:
    """Hierarchical (layered) particle filter: 7 layers x 572 particles as published.

    Coordinates are first filtered in their own layer with full steps and go on moving with steps shrinking by `decay`
    (Algorithm 3); only coordinates filtered so far are resampled (Algorithm 4). `betas` gives fixed exponents, one per
    layer, as the thesis has them; by default the survival rate sets them.
    Source: Alcoverro 2014, sections 2.2.6 and 2.4.
    """
    s = body.skeleton
    sigma = step_sigma(s, frame_rate)
    psi = partitions_of(s, HPF_LAYERS)
    rows = []
    for n, (name, _) in enumerate(HPF_LAYERS):
        selectivity = selectivity_of(n, betas, survival)
        rows.append(
            Layer(
                _diffusion(s, layered_sigma(sigma, psi, decay, n)),
                _weigh(body, selectivity),
                LayeredSystematic(filtered_mask(psi, s.dof, n)),
                name,
            )
        )
    return Recipe("hpf", tuple(rows), pose_mean(s), THESIS), particles


def default(body: Body, particles: int = 192, frame_rate: float = 25.0, iterations: int = 8) -> tuple[Recipe, int]:
    """The product's default: a contour solve from the prediction, a greedy search of one limb at a time around it with
    long-tailed steps, and a solve of what the search put together.

    The first solve puts the body within centimetres; the particles find limbs that went elsewhere (a local solve cannot
    pull in what lies beyond about 10 cm); the silhouettes choose between the first solve and the second. Each limb's
    best is kept (`Elite`) instead of resampled: with 200 particles the mean of survivors mixes a found arm with a
    lost one. A quarter of an arm's particles are drawn anew over its whole reach, for a punch is faster than any
    diffusion. One leg and one arm are searched per frame, in turn; all four when the first solve overlaps the masks
    worse than usual, and below 20 frames per second, where more happens between two frames.
    """
    s = body.skeleton
    sigma = 2.0 * step_sigma(s, frame_rate)
    options = SolveOptions(iterations=iterations, coarse_iterations=iterations // 2)
    turns = _TURNS if frame_rate >= 20 else (0,) * len(LIMB_LAYERS)
    period = 1 + max(turns)
    rows = [Layer(SolvePrediction(body, options), no_evidence, keep, "contours")]
    for (name, joints), turn in zip(LIMB_LAYERS, turns, strict=True):
        own = s.dofs_of(*joints)
        step = np.zeros(s.dof)
        step[own] = sigma[own]
        mask = np.zeros(s.dof, dtype=bool)
        mask[own] = True
        # the first hypothesis stays the solved pose, the second what the search has put together so far
        moves: list[Kernel] = [_diffusion(s, step, HeavyTail(0.3, 4.0, mask))]
        if name.endswith("arm"):
            moves.append(UniformShare(0.25, *_reach(s), mask))
        kernel = KeepFirst(Compose(tuple(moves)), 2)
        moving = np.isin(np.arange(len(s.joint_names)), [s.joint(j) for j in joints])
        weigh = Annealed(SilhouetteXor(body, moving), FixedSelectivity(1.0))  # the best is best under any exponent
        rows.append(Layer(kernel, weigh, Elite(1, mask, keep=1), name, InTurn(turn, period)))
    rows.append(Layer(RefineComposite(body, options), no_evidence, keep, "refinement"))
    return Recipe("default", tuple(rows), RefinedEstimate(s), CONTOURS), particles


def _published(name: str) -> Callable[..., tuple[Recipe, int]]:
    def make(body: Body, **settings: Any) -> tuple[Recipe, int]:
        from hypose.tracking import published_recipes  # which is built on this module

        return published_recipes.PRESETS[name](body, **settings)

    return make


RECIPES: dict[str, Callable[..., tuple[Recipe, int]]] = {
    "default": default,
    "sir": sir,
    "apf": apf,
    "partitioned": partitioned,
    "hpf": hpf,
    **{name: _published(name) for name in ("hpf-apo", "hpf-apo+", "dd-hpf", "dd-hpf+", "dd-hpf+5")},
}


def recipe(name: str, body: Body, *, frame_rate: float = 25.0, refine: bool = False) -> tuple[Recipe, int]:
    """A preset by name with its number of particles; `refine` adds the contour refinement as a last layer.

    An InputError lists the presets when the name is unknown.
    """
    if name not in RECIPES:
        raise InputError(f"There is no recipe {name!r}; the recipes are {', '.join(RECIPES)}.")
    made, particles = RECIPES[name](body, frame_rate=frame_rate)
    return (with_refinement(made, body), particles) if refine and name != "default" else (made, particles)


def with_refinement(base: Recipe, body: Body, options: SolveOptions | None = None) -> Recipe:
    """The recipe with contour refinement and feedback after its last layer."""
    kernel = ContourRefinement(body, options or SolveOptions(), best=1, from_prediction=True)
    layer = Layer(kernel, no_evidence, keep, "refinement")
    return replace(
        base,
        name=f"{base.name}+refine",
        layers=(*base.layers, layer),
        estimate=RefinedEstimate(body.skeleton),
        citation=f"{base.citation} {CONTOURS}",
    )


def selectivity_of(layer: int, betas: Sequence[float] | None, survival: float) -> Selectivity:
    """A fixed exponent per layer, as the thesis has them, or the exponent at which the share `survival` lives on."""
    return SurvivalRate(survival) if betas is None else FixedSelectivity(betas[layer])


def step_sigma(skeleton: Skeleton, frame_rate: float) -> Array:
    """(D,) usual motion per frame at this frame rate: proportional to the time between frames within limits."""
    return skeleton.sigma * float(np.clip(25.0 / frame_rate, 0.4, 2.0))


def _reach(skeleton: Skeleton) -> tuple[Array, Array]:
    """(D,), (D,): the range that joints use in practice: 60 % of the limits for balls, whose corners are unnatural."""
    lower, upper = skeleton.lower.copy(), skeleton.upper.copy()
    lower[:6] = upper[:6] = 0
    for start in skeleton.ball_starts[1:]:
        lower[start : start + 3] *= 0.6
        upper[start : start + 3] *= 0.6
    return lower, upper


def _diffusion(skeleton: Skeleton, sigma: Array, tail: HeavyTail | None = None) -> GaussianDiffusion:
    return GaussianDiffusion(sigma, skeleton.lower, skeleton.upper, tail)


def _weigh(body: Body, selectivity: Selectivity) -> Annealed:
    return Annealed(SilhouetteXor(body), selectivity)
