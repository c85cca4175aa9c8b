"""One camera, several hypotheses: the recipe of Sminchisescu & Triggs 2001."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from hypose.body.body import Body
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Layer, Recipe
from hypose.inference.selectors import keep
from hypose.tracking.monocular.clip import solve_clip
from hypose.tracking.monocular.models import body_dofs
from hypose.tracking.monocular.picture_search import PictureSearch
from hypose.tracking.monocular.pool import accumulated, best_of
from hypose.tracking.monocular.settings import MonoSettings

TRIGGS = (
    "Sminchisescu & Triggs 2001, A robust multiple hypothesis approach to monocular human motion tracking, with a "
    "constant-velocity prediction, calibrated regions and mirrored limbs at the start."
)
PICTURE_CUES = ("auto", "edges", "silhouettes", "keypoints", "both")
"""What is used besides edges and flow: all there is, nothing, masks, key points, or both."""


def monocular(body: Body, particles: int = 7, frame_rate: float = 25.0, *, floor: float | None = None) -> Recipe:
    """The person in the pictures of one camera, by so many hypotheses; floor: its height in the world, m, None when it
    is not known. Key points tell mirrored limbs apart sooner or later, so with them these are tried while tracking."""
    usual = MonoSettings(frame_rate=frame_rate)
    search = replace(usual.search, hypotheses=particles, flips=None)
    return picture_recipe(PictureSearch(body, replace(usual, search=search), floor=floor))


def picture_recipe(search: PictureSearch) -> Recipe:
    """Figure 4: in every frame all hypotheses are optimised, sampled along uncertain directions, pooled and pruned.

    Deviation: a constant-velocity prediction comes before the optimisation; without it nothing keeps track.
    Evidence is accumulated over frames, mirrored limbs are an option; see also pool.py and compute's mono_rows.py.
    """
    layers = (
        Layer(search.predicted, None, keep, "edges"),
        Layer(search.carried, None, keep, "flow"),
        Layer(search.optimised, accumulated, keep, "optimise"),
        Layer(search.mirror, accumulated, keep, "mirror", search.mirror_now),
        Layer(search.sampled, accumulated, search.pruned, "sample"),
    )
    active = body_dofs(search.body.skeleton) if search.active is None else search.active
    return Recipe(
        "monocular",
        layers,
        search.settings.search.hypotheses,
        ("picture",),
        predict=None,
        estimate=_best,
        uncertainty=search.uncertainty,
        lost=search.lost,
        smooth=partial(solve_clip, active=active),
        citation=TRIGGS,
    )


def _best(h: Hypotheses, /) -> Array:
    return h.values[best_of(h)]
