"""Recipes by name: the product's default, the published filters, and those with a contour refinement.

What solves for the pose begins with a long solve, expects the last step again, knows its uncertainty from the curvature
of the cost, and recovers; see `_solving`.
"""

from __future__ import annotations

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
from hypose.inference.kernels import HeavyTail, every, reflect
from hypose.inference.layer import GoOn, Layer, Recipe, Recovery
from hypose.inference.resampling import keep
from hypose.tracking import published_recipes as published
from hypose.tracking.arm_hypotheses import RefineRivals
from hypose.tracking.arm_workspace import arm_reach, in_practice
from hypose.tracking.costs import limb_energy
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.left_right import look_for_exchange
from hypose.tracking.monocular.recipe import PICTURE_CUES, TRIGGS, monocular
from hypose.tracking.part_colours import LearnColours
from hypose.tracking.pose_covariance import uncertainty_of_pose
from hypose.tracking.published_recipes import LIMB_LAYERS
from hypose.tracking.refinement import (
    COMPOSITE,
    SOLVED,
    ContourRefinement,
    InTurn,
    SolvePrediction,
    settled_start,
    solved,
)
from hypose.tracking.smooth_motion import smooth_clip
from hypose.tracking.starts import recover

THESIS = "Alcoverro, M. (2014). Stochastic optimization and interactive machine learning for human motion analysis."
DEUTSCHER = "Deutscher, J., Reid, I. (2005). Articulated body motion capture by stochastic search. IJCV 61(2)."
MACCORMICK = (
    "MacCormick, J., Isard, M. (2000). Partitioned sampling, articulated objects, and interface-quality hand tracking."
)
ISARD = "Isard, M., Blake, A. (1998). CONDENSATION - conditional density propagation for visual tracking. IJCV 29(1)."
CONTOURS = "Particles as proposals, bounded robust Gauss-Newton on two-way contours as the refinement (hypose)."

_TURNS = ((0, 4), (2, 4), (0, 2), (1, 2))
"""The frames (of so many) in which each of LIMB_LAYERS is searched: an arm in every frame, a leg in every other one.
Legs are seldom lost where the overlap does not tell: searched twice as often, three of 32 clips differed, by 0.3 mm
at most (walk, box, run, combo, seeds 705 to 712). Arms half as often cost runs 0.6 mm in the mean."""
_WITH_DEPTH = 16
"""Each limb is searched in one of so many frames with depth. Chosen on the seeds 0 to 15 (benchmark `depth`)."""


def default(
    body: Body,
    particles: int = 192,
    frame_rate: float = 25.0,
    iterations: int = 8,
    rivals: int = 3,
    colours: bool = False,
) -> Recipe:
    """The product's default: a contour solve from the prediction, a greedy search of one limb at a time around it with
    long-tailed steps, a solve of what the search put together, and of the arms that could be elsewhere instead.

    The first solve puts the body within centimetres; the particles find limbs that went elsewhere (a local solve cannot
    pull in what lies beyond about 10 cm); the silhouettes choose between the first solve and the second. Each limb's
    best is kept (`LimbSearch`) instead of resampled: with 200 particles the mean of survivors mixes a found arm with a
    lost one. A quarter of an arm's particles are drawn again over its whole reach, for a punch is faster than any
    diffusion. An arm is searched per frame, and a leg in every other one; all four when the first solve overlaps the
    masks worse than usual, and below 20 frames per second, where more happens between two frames. In the same frames an
    arm's whole reach is looked up; of the poses found there the best live on besides the estimate, `rivals` poses in
    all. With `colours` it learns, where there are pictures, what colours the person's parts have, and asks them, and
    the edges of sleeves, where arms are: it helps folded arms and costs half as much again, so it is asked for.
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
    return _solving(replace(base, learn=LearnColours(), likes=("colours",)) if colours else base)


def _rivals(body: Body, turns: Sequence[InTurn], rivals: int, options: SolveSettings) -> RefineRivals:
    """The kernel that looks arms up in their turns (one for each of LIMB_LAYERS) and hands on so many hypotheses."""
    lower, upper = in_practice(body.skeleton)
    arms = [
        (arm_reach(body, joints, lower, upper), replace(turn, seldom=1))
        for (name, joints), turn in zip(LIMB_LAYERS, turns, strict=True)
        if name.endswith("arm")
    ]
    return RefineRivals(tuple(arms), rivals, options)


def _turns(frame_rate: float) -> list[InTurn]:
    """When each of LIMB_LAYERS is searched."""
    turns = _TURNS if frame_rate >= 20 else [(0, 1)] * len(LIMB_LAYERS)
    return [InTurn(turn, period, seldom=_WITH_DEPTH // max(period, 2)) for turn, period in turns]


def _refined(base: Recipe, name: str | None = None) -> Recipe:
    """A recipe with contour refinement after its last layer, whose result is the estimate and moves the set."""
    layer = Layer(ContourRefinement(), None, keep, "refinement")
    return _solving(replace(base, name=name or f"{base.name}+refine", layers=(*base.layers, layer)))


def hpf_plus(body: Body, particles: int = 572, frame_rate: float = 25.0) -> Recipe:
    """`published_recipes.hpf` with contour refinement, a solved start, prediction and recovery."""
    return _refined(published.hpf(body, particles, frame_rate=frame_rate), "hpf+")


def dd_hpf_rivals(body: Body, particles: int = 500, frame_rate: float = 25.0, rivals: int = 3) -> Recipe:
    """`published_recipes.dd_hpf_plus` with contour refinement and rival arms, a solved start, prediction and recovery:
    its particles find what the detections show, the rivals what they leave uncovered."""
    base = published.dd_hpf_plus(body, particles, frame_rate=frame_rate)
    layers = (
        *base.layers,
        Layer(ContourRefinement(), None, keep, "refinement"),
        Layer(_rivals(body, _turns(frame_rate), rivals, SolveSettings()), None, keep, "rivals"),
    )
    return _solving(replace(base, name="dd-hpf+rivals", layers=layers, rivals=rivals))


def _solving(base: Recipe) -> Recipe:
    return replace(
        base,
        start=settled_start,
        predict=GoOn(),
        estimate=solved,
        uncertainty=uncertainty_of_pose,
        recover=Recovery(find=recover, rival=look_for_exchange),
        smooth=smooth_clip,
    )


@dataclass(frozen=True)
class Preset:
    """Prior knowledge of a recipe before there is a body. make(body, frame_rate=Hz): the recipe for a body, whose other
    parameters are the options that only this method has; citation; whole_clip: key points alone are enough, and are
    solved in all frames together instead of frame by frame; needs: as those of the recipe, as far as they decide which
    recordings it can be used on; likes: those that are looked at where they are at hand; evidence: the choices, the
    usual one first."""

    make: Callable[..., Recipe]
    citation: str
    whole_clip: bool = False
    needs: tuple[str, ...] = ()
    likes: tuple[str, ...] = ()
    evidence: tuple[str, ...] = ("silhouettes", "keypoints", "both")

    def check(self, name: str, evidence: str, options: Iterable[str]) -> None:
        """An InputError that names what the recipe of this name does not know."""
        if evidence not in self.evidence:
            choices = f"{', '.join(self.evidence[:-1])} or {self.evidence[-1]}"
            raise InputError(f"The recipe {name!r} knows no evidence {evidence!r}; choose {choices}.")
        if evidence == "keypoints" and self.evidence == Preset.evidence and not self.whole_clip:
            raise InputError(f"The recipe {name!r} needs silhouettes; choose the evidence silhouettes or both.")
        known = inspect.signature(self.make).parameters
        for option in options:
            if option not in known:
                having = [n for n, p in RECIPES.items() if option in inspect.signature(p.make).parameters]
                raise InputError(
                    f"The recipe {name!r} has no option {option!r}; leave it out, or choose the recipe "
                    f"{' or '.join(having) or 'that has it'}."
                )


RECIPES: dict[str, Preset] = {
    "default": Preset(default, CONTOURS, whole_clip=True, likes=("colours",)),
    "sir": Preset(published.sir, ISARD),
    "apf": Preset(published.apf, DEUTSCHER),
    "partitioned": Preset(published.partitioned, MACCORMICK),
    "hpf": Preset(published.hpf, THESIS),
    "hpf+": Preset(hpf_plus, f"{THESIS} {CONTOURS}"),
    "hpf-apo": Preset(published.hpf_apo, THESIS),
    "hpf-apo+": Preset(published.hpf_apo_plus, THESIS),
    "dd-hpf": Preset(published.dd_hpf, THESIS),
    "dd-hpf+": Preset(published.dd_hpf_plus, THESIS),
    "dd-hpf+5": Preset(published.dd_hpf_plus_5, THESIS),
    "dd-hpf+rivals": Preset(dd_hpf_rivals, f"{THESIS} {CONTOURS}"),
    "monocular": Preset(monocular, TRIGGS, needs=("picture",), evidence=PICTURE_CUES),
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
    """A preset by name for a body and a frame rate (Hz); particles: None = its own number; refine: with contour
    refinement as a last layer, if it has none; own: options that only this method has.

    An InputError lists the presets when the name is unknown.
    """
    if name not in RECIPES:
        raise InputError(f"There is no recipe {name!r}; the recipes are {', '.join(RECIPES)}.")
    count = {} if particles is None else {"particles": particles}
    made = RECIPES[name].make(body, frame_rate=frame_rate, **count, **own)
    if refine and made.smooth is None:  # solved poses have been refined
        made = _refined(made)
    return replace(made, citation=citation_of(name, refine))


def citation_of(name: str, refine: bool = False) -> str:
    """Where a preset comes from, \"\" for a name that is none; refine: as for `recipe`."""
    cited = RECIPES[name].citation if name in RECIPES else ""
    return f"{cited} {CONTOURS}" if cited and refine and CONTOURS not in cited else cited


# ---- search of one limb ----
# A search of one limb at a time: many poses of it about the one that it is in, of which the best is kept.


@dataclass(frozen=True)
class LimbSearch:
    """Kernel: a greedy step of a search of single limbs. The limb takes Gaussian steps in all hypotheses, in a share
    `long` of them `longer` times as long, and in a share `again` it is drawn again between lower and upper (D,); then
    that of the best is all people's, with the rest of each body as it was.

    The hypothesis in the role SOLVED never moves, and the one in the role COMPOSITE is tried as it is, so that the
    search never loses its start. skeleton; joints: of the limb, by name; sigma (D,): sd of a step. With a budget of
    tens of hypotheses, resampling would leave most of them on values that are known to be worse. Shares are spread
    evenly over the set. Poses that are certainly worse than the first hypothesis are not measured.
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
        """(d,) the limb's coordinates."""
        return self.skeleton.dofs_of(*self.joints)

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """(J,) the limb's joints."""
        s = self.skeleton
        return np.isin(np.arange(len(s.joint_names)), [s.joint(j) for j in self.joints])

    @cached_property
    def _tail(self) -> HeavyTail:
        return HeavyTail(self.long, self.longer, np.ones(len(self.own), np.bool_))

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """The set with the best limb."""
        s, own = self.skeleton, self.own
        limb = h.values[:, own]
        steps = rng.standard_normal(limb.shape) * self.sigma[own]
        self._tail.stretch(steps, np.arange(len(own)), len(own))
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
