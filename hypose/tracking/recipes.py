"""Recipes by name: the product's default, the published filters, and those with a contour refinement.

Recipes that solve for the pose have in common: a long solve at the start, a prediction by the last step, uncertainty
from the curvature of the cost, and recovery after a loss; see `_solving`.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.errors import InputError
from hypose.fitting.articulated import SolveSettings
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import every, reflect
from hypose.inference.layer import Layer, Recipe, Recovery, go_on
from hypose.inference.resampling import keep
from hypose.tracking import published_recipes as published
from hypose.tracking.arm_hypotheses import RefineRivals, SolvePrediction
from hypose.tracking.arm_workspace import ArmReach, in_practice
from hypose.tracking.frame_evidence import PreparedFrame, limb_energy
from hypose.tracking.left_right import look_for_exchange
from hypose.tracking.part_colours import learn_colours
from hypose.tracking.published_recipes import LIMB_LAYERS
from hypose.tracking.refinement import (
    COMPOSITE,
    SOLVED,
    ContourRefinement,
    InTurn,
    settled_start,
    solved,
    uncertainty_of_pose,
)
from hypose.tracking.smoothing import smooth_clip
from hypose.tracking.start_search import recover

THESIS = "Alcoverro, M. (2014). Stochastic optimization and interactive machine learning for human motion analysis."
DEUTSCHER = "Deutscher, J., Reid, I. (2005). Articulated body motion capture by stochastic search. IJCV 61(2)."
MACCORMICK = (
    "MacCormick, J., Isard, M. (2000). Partitioned sampling, articulated objects, and interface-quality hand tracking."
)
ISARD = "Isard, M., Blake, A. (1998). CONDENSATION - conditional density propagation for visual tracking. IJCV 29(1)."
TRIGGS = (
    "Sminchisescu & Triggs 2001, A robust multiple hypothesis approach to monocular human motion tracking, with a "
    "constant-velocity prediction, calibrated regions and mirrored limbs at the start."
)
CONTOURS = "Particles as proposals, bounded robust Gauss-Newton on two-way contours as the refinement (hypose)."

PICTURE_CUES = ("auto", "edges", "silhouettes", "keypoints", "both")
"""Cues of one camera used in addition to edges and flow: all there is, nothing, masks, key points, or both."""

_TURNS = ((0, 4), (2, 4), (0, 2), (1, 2))
"""(turn, period) of each of LIMB_LAYERS: an arm is searched in every frame (the two in turn), a leg in every other one.
Legs are seldom lost without a change of the overlap: searched twice as often, three of 32 clips differed, by 0.3 mm
at most (walk, box, run, combo, seeds 705 to 712). Arms half as often cost runs 0.6 mm in the mean.
"""
_WITH_DEPTH = 16
"""With depth each limb is searched in one of this many frames. Chosen on the seeds 0 to 15 (benchmark `depth`)."""


def default(
    body: Body,
    particles: int = 192,
    frame_rate: float = 25.0,
    iterations: int = 8,
    rivals: int = 3,
    colours: bool = False,
) -> Recipe:
    """Build the product's default recipe: contour solve, greedy search of one limb at a time, and solves of alternative
    arms.

    frame_rate: Hz.
    Layers: (1) a contour solve from the prediction, accurate to centimetres; (2) a search of single limbs around it
    with long-tailed steps (`LimbSearch`), because a local solve cannot move a limb by more than about 10 cm; (3) solves
    of the search result and of alternative arms (rivals), of which the silhouettes choose the best.
    particles: number of hypotheses.
    iterations: number of iterations of a solve.
    rivals: largest number of poses kept from frame to frame, with the estimate.
    colours: also learn the colours of the person's parts, where there are pictures, and use them and the edges of
        sleeves to find arms. It helps with folded arms and takes half as much time again, so it is off by default.
    Each limb's best pose is kept instead of resampled: with 200 particles the mean of the survivors mixes a found arm
    with a lost one. A quarter of an arm's particles are drawn from its whole reach, because a punch is faster than any
    diffusion. An arm is searched in every frame, a leg in every other one; all limbs when the first solve overlaps the
    masks worse than usual, and below 20 frames per second, where more happens between two frames. In the same frames
    the table of an arm's reach is searched.
    """
    s = body.skeleton
    sigma = 2.0 * s.step_sigma(frame_rate)
    options = SolveSettings(iterations=iterations, coarse_iterations=iterations // 2)
    turns = _turns(frame_rate)
    rival_arms = _rivals(body, turns, rivals, options)
    rows = [Layer(SolvePrediction(options, rival_arms), None, keep, "contours")]
    for (name, joints), turn in zip(LIMB_LAYERS, turns, strict=True):
        search = LimbSearch(s, joints, sigma, *in_practice(s), redrawn=0.25 if name.endswith("arm") else 0.0)
        rows.append(Layer(search, None, keep, name, turn))
    rows.append(Layer(rival_arms, None, keep, "rivals"))
    base = Recipe("default", rows, particles, rivals=rivals)
    return _solving(replace(base, learn=learn_colours, likes=("colours",)) if colours else base)


def _rivals(body: Body, turns: Sequence[InTurn], rivals: int, options: SolveSettings) -> RefineRivals:
    """Build the kernel that searches the tables of arms in their turns (one for each of LIMB_LAYERS).

    rivals: largest number of poses kept, with the estimate; options: options of solves.
    """
    lower, upper = in_practice(body.skeleton)
    arms = [
        (ArmReach(body, joints, lower, upper), replace(turn, seldom=1))
        for (name, joints), turn in zip(LIMB_LAYERS, turns, strict=True)
        if name.endswith("arm")
    ]
    return RefineRivals(tuple(arms), rivals, options)


def _turns(frame_rate: float) -> list[InTurn]:
    """Build the conditions that decide when each of LIMB_LAYERS is searched."""
    turns = _TURNS if frame_rate >= 20 else [(0, 1)] * len(LIMB_LAYERS)
    return [InTurn(turn, period, seldom=_WITH_DEPTH // max(period, 2)) for turn, period in turns]


def _refined(base: Recipe, name: str | None = None) -> Recipe:
    """Add contour refinement after a recipe's last layer; its result is the estimate and moves the set.

    base: the recipe; name: name of the result (default: that of the base with "+refine").
    """
    layer = Layer(ContourRefinement(), None, keep, "refinement")
    return _solving(replace(base, name=name or f"{base.name}+refine", layers=(*base.layers, layer)))


def hpf_plus(body: Body, particles: int = 572, frame_rate: float = 25.0) -> Recipe:
    """Build `published_recipes.hpf` with contour refinement, a solved start, prediction and recovery.

    particles: number of hypotheses; frame_rate: Hz.
    """
    return _refined(published.hpf(body, particles, frame_rate=frame_rate), "hpf+")


def dd_hpf_rivals(body: Body, particles: int = 500, frame_rate: float = 25.0, rivals: int = 3) -> Recipe:
    """Build `published_recipes.dd_hpf_plus` with contour refinement, rival arms, a solved start, prediction and
    recovery.

    The particles find limbs whose ends are detected; the rivals (alternative arms) find arms whose detection is
    missing.
    """
    base = published.dd_hpf_plus(body, particles, frame_rate=frame_rate)
    layers = (
        *base.layers,
        Layer(ContourRefinement(), None, keep, "refinement"),
        Layer(_rivals(body, _turns(frame_rate), rivals, SolveSettings()), None, keep, "rivals"),
    )
    return _solving(replace(base, name="dd-hpf+rivals", layers=layers, rivals=rivals))


def _solving(base: Recipe) -> Recipe:
    """Add to a recipe the solved start, the prediction by the last step, the uncertainty by curvature, recovery and
    smoothing.
    """
    return replace(
        base,
        start=settled_start,
        predict=go_on,
        estimate=solved,
        uncertainty=uncertainty_of_pose,
        recover=Recovery(find=recover, rival=look_for_exchange),
        smooth=smooth_clip,
    )


@dataclass(frozen=True)
class Preset:
    """Description of a named recipe that is not built for a body yet: how to build it, and which evidence it can
    use.

    make: function (body, frame_rate=Hz, ...) that builds the recipe; its other parameters are this recipe's options.
    citation: source of the method.
    whole_clip: key points alone are enough; they are solved in all frames together instead of frame by frame.
    needs: cues without which the recipe cannot be used; likes: cues that are used where they exist.
    evidence: the choices of evidence, the default first.
    """

    make: Callable[..., Recipe]
    citation: str
    whole_clip: bool = False
    needs: tuple[str, ...] = ()
    likes: tuple[str, ...] = ()
    evidence: tuple[str, ...] = ("silhouettes", "keypoints", "both")

    def check(self, name: str, evidence: str, options: Iterable[str]) -> None:
        """Check that the recipe has this kind of evidence and these options.

        name: name of the recipe, for the message.
        Raises: InputError that names the wrong evidence or option and the recipes that have it.
        """
        if evidence not in self.evidence:
            choices = f"{', '.join(self.evidence[:-1])} or {self.evidence[-1]}"
            raise InputError(f"The recipe {name!r} has no evidence {evidence!r}; choose {choices}.")
        if evidence == "keypoints" and self.evidence == Preset.evidence and not self.whole_clip:
            raise InputError(f"The recipe {name!r} needs silhouettes; choose the evidence silhouettes or both.")
        for option in options:
            if option not in inspect.signature(self.make).parameters:
                having = [n for n, p in RECIPES.items() if option in inspect.signature(p.make).parameters]
                raise InputError(
                    f"The recipe {name!r} has no option {option!r}; leave it out, or choose the recipe "
                    f"{' or '.join(having) or 'that has it'}."
                )


def _monocular(body: Body, particles: int = 7, frame_rate: float = 25.0, *, floor: float | None = None) -> Recipe:
    """Build `hypose.tracking.monocular.recipe.monocular`, whose modules are imported only where it is chosen."""
    recipe = importlib.import_module("hypose.tracking.monocular.recipe")
    return recipe.monocular(body, particles, frame_rate, floor=floor)


RECIPES: dict[str, Preset] = {
    "default": Preset(default, CONTOURS, whole_clip=True, likes=("colours",)),
    "sir": Preset(published.sir, ISARD),
    "apf": Preset(published.apf, DEUTSCHER),
    "partitioned": Preset(published.partitioned, MACCORMICK),
    "hpf": Preset(published.hpf, THESIS),
    "hpf+": Preset(hpf_plus, f"{THESIS} {CONTOURS}"),
    "hpf-apo": Preset(published.hpf_apo, THESIS),
    "dd-hpf": Preset(published.dd_hpf, THESIS),
    "dd-hpf+": Preset(published.dd_hpf_plus, THESIS),
    "dd-hpf+5": Preset(published.dd_hpf_plus_5, THESIS),
    "dd-hpf+rivals": Preset(dd_hpf_rivals, f"{THESIS} {CONTOURS}"),
    "monocular": Preset(_monocular, TRIGGS, needs=("picture",), evidence=PICTURE_CUES),
}


def recipe(
    name: str,
    body: Body,
    *,
    frame_rate: float = 25.0,
    particles: int | None = None,
    refine: bool = False,
    **own: Any,
) -> Recipe:
    """Build a recipe by its name, for a body and a frame rate (Hz).

    particles: number of hypotheses; None: the recipe's own.
    refine: add contour refinement as a last layer, where the recipe has none.
    own: options of this recipe alone.
    Raises: InputError that lists the recipes where the name is unknown.
    """
    if name not in RECIPES:
        raise InputError(f"There is no recipe {name!r}; the recipes are {', '.join(RECIPES)}.")
    count = {} if particles is None else {"particles": particles}
    made = RECIPES[name].make(body, frame_rate=frame_rate, **count, **own)
    if refine and made.smooth is None:  # solved poses have been refined
        made = _refined(made)
    return replace(made, citation=citation_of(name, refine))


def citation_of(name: str, refine: bool = False) -> str:
    """Return the citation of a recipe, "" for an unknown name; refine: contour refinement is added as a last layer."""
    cited = RECIPES[name].citation if name in RECIPES else ""
    return f"{cited} {CONTOURS}" if cited and refine and CONTOURS not in cited else cited


# ---- search of one limb ----
# A search of one limb at a time: many poses around its current one are drawn, and the best is kept.


@dataclass(frozen=True)
class LimbSearch:
    """Kernel of a greedy search of one limb: draw many poses of the limb, and put the best into all hypotheses.

    The limb takes Gaussian steps in all hypotheses; the rest of each body stays. The hypothesis with the role SOLVED
    never moves, and that with the role COMPOSITE is tried as it is, so that the search never loses its start.
    joints: names of the limb's joints.
    sigma: (D,) sd of a step.
    lower, upper: (D,) range in which a share `redrawn` of the hypotheses is drawn uniformly.
    long, longer: share of the steps that are lengthened, and the factor by which they are.
    Why: with tens of hypotheses, resampling would leave most of them on values that are known to be worse. Poses that
        are certainly worse than the first hypothesis are not evaluated in full.
    """

    skeleton: Skeleton
    joints: tuple[str, ...]
    sigma: Array
    lower: Array
    upper: Array
    redrawn: float = 0.0
    long: float = 0.3
    longer: float = 4.0

    @cached_property
    def own(self) -> NDArray[np.int64]:
        """Indices (d,) of the limb's coordinates."""
        return self.skeleton.dofs_of(*self.joints)

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Mask (J,) of the limb's joints."""
        s = self.skeleton
        return np.isin(np.arange(len(s.joint_names)), [s.joint(j) for j in self.joints])

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Return the set in which all hypotheses but the solved one have the best limb found."""
        s, own = self.skeleton, self.own
        limb = h.values[:, own]
        steps = rng.standard_normal(limb.shape) * self.sigma[own]
        steps[every(self.long, h.count)] *= self.longer
        tried = reflect(limb + steps, s.lower[own], s.upper[own])
        if self.redrawn > 0:
            rows, low, high = every(self.redrawn, h.count), self.lower[own], self.upper[own]
            tried[rows] = low + (high - low) * rng.random((len(rows), len(own)))
        solved = h.has(SOLVED)
        staying = solved | h.has(COMPOSITE)
        tried[staying] = limb[staying]
        values = h.values.copy()
        values[:, own] = tried
        energies = limb_energy(values, frame, self.moving)
        best = np.where(np.isfinite(energies), energies, np.inf).argmin()
        values[:, own] = np.where(solved[:, None], limb, tried[best])
        return h.equal(values)
