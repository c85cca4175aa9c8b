"""Presets of Alcoverro 2014, sections 2.4 and 2.5, as published, and what improves them, as presets of their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.geometry import Array
from hypose.inference.kernels import HeavyTail, filtered_mask, layered_sigma, stay
from hypose.inference.layer import Kernel, Layer, Recipe
from hypose.inference.selectivity import Annealed
from hypose.inference.selectors import LayeredSystematic
from hypose.tracking.costs import SilhouetteXor
from hypose.tracking.detections import DetectionCost, DetectorDriven, ends_of
from hypose.tracking.limb_kernels import BallStep, LimbDiffusion, ball_step
from hypose.tracking.partitioned_observations import (
    PartitionedXor,
    Region,
    bounding_region,
    chain_region,
    faces_of_parts,
)
from hypose.tracking.recipes import HPF_LAYERS, LIMB_LAYERS, THESIS, partitions_of, selectivity_of, step_sigma
from hypose.tracking.refinement import pose_mean

# what a layer of the partitioned filter places: (points of its box: joints, landmarks), parts drawn first in it
_SEEN: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    "torso": (
        ("pelvis", "chest", "neck", "head", "left_shoulder", "right_shoulder", "left_hip", "right_hip"),
        ("head_top",),
        ("pelvis", "spine", "chest", "neck", "head", "left_clavicle", "right_clavicle"),
    ),
}
for _side in ("left", "right"):
    _SEEN[f"{_side}_leg"] = (
        (f"{_side}_hip", f"{_side}_knee", f"{_side}_ankle"),
        (f"{_side}_big_toe",),
        (f"{_side}_hip", f"{_side}_knee", f"{_side}_ankle"),
    )
    _SEEN[f"{_side}_shoulder"] = ((f"{_side}_shoulder", f"{_side}_elbow"), (), (f"{_side}_shoulder",))
    _SEEN[f"{_side}_elbow"] = (
        (f"{_side}_elbow", f"{_side}_wrist"),
        (f"{_side}_hand_tip",),
        (f"{_side}_elbow", f"{_side}_wrist"),
    )


def layer_regions(body: Body, *, bounding: bool, margin: float = 0.18) -> list[tuple[Region, NDArray[np.bool_]]]:
    """For each layer of HPF_LAYERS its region and the faces drawn (its own parts and those of the layers before), and
    one more of the whole body. bounding: boxes about the posed limb instead of fixed ones."""
    s, out, drawn = body.skeleton, [], []
    for name, _ in HPF_LAYERS:
        joints, ends, parts = _SEEN[name]
        drawn += parts
        if bounding:
            region = bounding_region(body, joints, ends, margin=margin)
        elif name == "torso":
            region = _torso_region(body, joints, ends)
        else:
            region = chain_region(body, joints, ends)
        out.append((region, faces_of_parts(body, tuple(drawn))))
    whole = bounding_region(body, s.joint_names, (), margin=0.25)
    return [*out, (whole, np.ones(len(body.coarse.faces), dtype=bool))]


def _torso_region(body: Body, joints: tuple[str, ...], ends: tuple[str, ...]) -> Region:
    """The fixed box of the trunk with the head: as wide as the shoulders, from the hips to the top of the head."""
    region = bounding_region(body, joints, ends, margin=0.12)
    low, high = region.box(body, np.zeros(body.skeleton.dof))
    half = 0.5 * (high - low)
    half[:2] = half[:2].max()  # whichever way the person faces
    return Region(region.joints, region.ends, half, 0.0)


def hpf_apo(
    body: Body,
    particles: int = 500,
    survival: float = 0.15,
    decay: float = 0.8,
    frame_rate: float = 25.0,
    betas: Sequence[float] | None = None,
    *,
    bounding: bool = False,
    own: bool = False,
    twist: bool = False,
    tails: bool = False,
    moving_end: bool = False,
    name: str = "hpf-apo",
) -> tuple[Recipe, int]:
    """The hierarchical filter weighed by approximate partitions of the observations: 7 + 1 layers x 500 particles.

    As published: the layers and steps of `hpf`, eq. 2.15 in fixed boxes, and a last layer that weighs the set again in
    a box of the whole body. `betas` gives fixed exponents, one per layer (8); by default the survival rate sets them.
    The departures, each for itself: bounding: boxes about the posed limb. own: a limb's layer moves its own coordinates
    and the torso's (the forearm's also the upper arm's) only: the legs are not seen in the arms' boxes, where further
    steps would shake them. twist: the shoulder's twist is searched with the forearm. tails: 15 % of a limb's steps are
    four times as long. moving_end: the last layer moves all coordinates by their small steps.
    Source: Alcoverro 2014, section 2.4.
    """
    s = body.skeleton
    sigma = step_sigma(s, frame_rate)
    psi = partitions_of(s, HPF_LAYERS)
    regions = layer_regions(body, bounding=bounding)
    rows = []
    for n in range(len(HPF_LAYERS) + 1):
        selectivity = selectivity_of(n, betas, survival)
        region, faces = regions[n]
        last = n == len(HPF_LAYERS)
        kernel: Kernel = stay
        if not last or moving_end:
            step = layered_sigma(sigma, psi, decay, n)
            kernel = _steps(body, sigma, step, psi, n, own=own, twist=twist, tails=tails)
        rows.append(
            Layer(
                kernel,
                Annealed(PartitionedXor(body, region, None if last else faces), selectivity),
                LayeredSystematic(filtered_mask(psi, s.dof, n)),
                "whole body" if last else HPF_LAYERS[n][0],
            )
        )
    return Recipe(name, tuple(rows), pose_mean(s), THESIS), particles


def _steps(
    body: Body, full: Array, step: Array, psi: list[NDArray[np.int64]], n: int, *, own: bool, twist: bool, tails: bool
) -> LimbDiffusion:
    """The kernel of layer n of the partitioned filter from the steps of Algorithm 3."""
    s, last = body.skeleton, n == len(HPF_LAYERS)
    name = "whole body" if last else HPF_LAYERS[n][0]
    side = name.split("_")[0]
    sigma = step.copy()
    limb = np.zeros(s.dof, dtype=bool)
    if not last and name != "torso":
        limb[psi[n]] = True
    if own and not last:
        keep = np.zeros(s.dof, dtype=bool)
        keep[psi[0]] = True
        keep[psi[n]] = True
        if name.endswith("elbow"):
            keep[s.dofs_of(f"{side}_clavicle", f"{side}_shoulder")] = True
        sigma[~keep] = 0
    balls: tuple[BallStep, ...] = ()
    if twist and name.endswith(("shoulder", "elbow")):
        start = int(s.dofs_of(f"{side}_shoulder")[0])
        swing = float(sigma[start])
        # with the forearm the twist moves by its whole step, for the first time
        turning = float(full[start]) if name.endswith("elbow") else 0.0
        balls = (ball_step(s, f"{side}_shoulder", f"{side}_elbow", swing, turning),)
        sigma[start : start + 3] = 0
        if turning:
            limb[start : start + 3] = True
    tail = HeavyTail(0.15, 4.0, limb) if tails and limb.any() else None
    return LimbDiffusion(s, sigma, balls, tail)


def hpf_apo_plus(body: Body, particles: int = 500, frame_rate: float = 25.0) -> tuple[Recipe, int]:
    """The improved form of `hpf_apo`, at the same number of evaluations."""
    return hpf_apo(
        body,
        particles,
        frame_rate=frame_rate,
        bounding=True,
        own=True,
        twist=True,
        tails=True,
        name="hpf-apo+",
    )


# one layer per limb instead of two per arm: the (5+1) form
FIVE_LAYERS = (HPF_LAYERS[0], *LIMB_LAYERS)
# the end that drives each layer, in the order they are tried (END_NAMES), and its pair of bits
_DRIVEN = {"torso": ((2,), 0), "left": ((0, 3), 1), "right": ((1, 4), 2), "left_leg": ((5,), 3), "right_leg": ((6,), 4)}


def dd_hpf(
    body: Body,
    particles: int = 500,
    survival: float = 0.15,
    decay: float = 0.8,
    frame_rate: float = 25.0,
    betas: Sequence[float] | None = None,
    *,
    layers: tuple[tuple[str, tuple[str, ...]], ...] = HPF_LAYERS,
    refinement: bool = False,
    kappa: float = 4.0,
    last_survival: float = 0.4,
    name: str = "dd-hpf",
) -> tuple[Recipe, int]:
    """The detector-driven hierarchical filter: 7 layers x 500 particles, `hpf` with part of each layer's particles
    posed on the detected hand, head (or ankle); refinement: one more layer, without propagation, whose cost knows the
    detections (`dd-hpf+`).

    Detections come with the frames (`Frame.detections`) or from key points; without any this is `hpf`. An arm's forearm
    is posed with its upper arm, in both of its layers, and both are resampled from the first on. kappa (1 / m) balances
    metres against the silhouettes' cost. Source: Alcoverro 2014, section 2.5.2.
    """
    s = body.skeleton
    ends, sigma, psi = ends_of(body), step_sigma(s, frame_rate), partitions_of(s, layers)
    rows = []
    for n, (layer, _) in enumerate(layers):
        selectivity = selectivity_of(n, betas, survival)
        step = layered_sigma(sigma, psi, decay, n)
        driven, bit = _DRIVEN[layer if layer in _DRIVEN else layer.split("_")[0]]
        own = np.zeros(s.dof)
        own[psi[n]] = sigma[psi[n]]
        kernel = DetectorDriven(body, ends, LimbDiffusion(s, step), driven, own, bit)
        filtered = filtered_mask(psi, s.dof, n)
        if layer.endswith("shoulder"):
            filtered = filtered.copy()
            filtered[s.dofs_of(layer.replace("shoulder", "elbow"))] = True
        weigh = Annealed(SilhouetteXor(body), selectivity)
        rows.append(Layer(kernel, weigh, LayeredSystematic(filtered), layer))
    if refinement:
        last = selectivity_of(len(layers), betas, last_survival)
        weigh = Annealed(DetectionCost(body, ends, SilhouetteXor(body), kappa), last)
        everything = filtered_mask(psi, s.dof, len(layers))
        rows.append(Layer(stay, weigh, LayeredSystematic(everything), "refinement"))
    return Recipe(name, tuple(rows), pose_mean(s), THESIS), particles


def dd_hpf_plus(body: Body, particles: int = 500, frame_rate: float = 25.0) -> tuple[Recipe, int]:
    """`dd_hpf` with the refinement layer: 7 + 1 layers x 500 particles. Source: Alcoverro 2014, section 2.5.2."""
    return dd_hpf(body, particles, frame_rate=frame_rate, refinement=True, name="dd-hpf+")


def dd_hpf_plus_5(body: Body, particles: int = 500, frame_rate: float = 25.0) -> tuple[Recipe, int]:
    """`dd_hpf` with whole arms in one layer and the refinement layer: 5 + 1 layers x 500 particles."""
    return dd_hpf(body, particles, frame_rate=frame_rate, layers=FIVE_LAYERS, refinement=True, name="dd-hpf+5")


PRESETS = {
    "hpf-apo": hpf_apo,
    "hpf-apo+": hpf_apo_plus,
    "dd-hpf": dd_hpf,
    "dd-hpf+": dd_hpf_plus,
    "dd-hpf+5": dd_hpf_plus_5,
}
