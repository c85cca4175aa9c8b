"""Build the published particle filters as recipes of the one search.

Every recipe is a function of the body and a few numbers. The published recipes start from the given pose, neither
predict nor recover, and report the spread of their set as uncertainty. The layer settings are the printed ones. What
the thesis does not print is the same for all of them: Sigma_0, the steps of the kernel K_t between two frames and of
the layers, is the motion of captured people (`CAPTURED_MOTION`); beta is solved for a survival rate, because a fixed
exponent <= 1 hardly selects on the flat energies of eq. 2.8.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Landmarks
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array
from hypose.inference.annealing import Energy, SmoothedWeight
from hypose.inference.kernels import (
    AdaptiveDiffusion,
    GaussianDiffusion,
    annealed_sigma,
    filtered_mask,
    layered_sigma,
    stay,
)
from hypose.inference.layer import Kernel, Layer, Recipe
from hypose.inference.resampling import LayeredResampling, keep, systematic
from hypose.tracking.detection_kernels import DetectionCost, DetectorDriven, ends_of
from hypose.tracking.frame_evidence import SilhouetteXor
from hypose.tracking.partitioned_observations import (
    PartitionedXor,
    Region,
    bounding_region,
    chain_region,
    faces_of_parts,
    torso_region,
)
from hypose.tracking.refinement import pose_mean

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
# whole limbs, for filters with one layer per limb and for a search of one limb at a time
LIMB_LAYERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    *HPF_LAYERS[1:3],
    ("left_arm", ("left_clavicle", "left_shoulder", "left_elbow")),
    ("right_arm", ("right_clavicle", "right_shoulder", "right_elbow")),
)


CAPTURED_MOTION: dict[str, float | tuple[float, ...]] = {
    "pelvis": (0.051, 0.051, 0.014, *np.radians((1.2, 1.2, 6.9))),
    "spine": np.radians(1.7),
    "neck": np.radians(1.8),
    "clavicle": np.radians(0.6),
    "shoulder": np.radians(3.9),
    "elbow": np.radians(4.5),
    "hip": np.radians(3.2),
    "knee": np.radians(8.2),
    "ankle": (np.radians(4.6), np.radians(0.65)),
}
"""Root mean square of the change of each coordinate between two frames at 25 fps, m and rad (Sigma_0 of the published
filters), by joint: one number for all axes of a joint, or one per axis.

Source: a walk, a run and a boxer (CMU 02_01, 02_03, 02_05), in equal parts; table in docs/presets.md. The clavicles,
which do not move in these captures, have the value of the default body. The heading is that of the run on a circle of
0.9 m, because these people go straight ahead, and people in a room turn: with their 2.3 degrees a filter falls behind
a runner's turn and ends back to front.
"""


def frame_sigma(skeleton: Skeleton, frame_rate: float) -> Array:
    """Return the usual change between two frames (D,) at a frame rate (Hz), m and rad: `CAPTURED_MOTION`, scaled by the
    duration of a frame within 0.4 to 2.
    """
    sigma = np.zeros(skeleton.dof)
    for joint in skeleton.joint_names:
        kind = joint.split("_")[-1]
        if kind in CAPTURED_MOTION:
            sigma[skeleton.dofs_of(joint)] = CAPTURED_MOTION[kind]
    return sigma * float(np.clip(25.0 / frame_rate, 0.4, 2.0))


def sir(body: Body, particles: int = 4000, survival: float = 0.05, frame_rate: float = 25.0) -> Recipe:
    """Build the plain particle filter: one layer over all coordinates.

    particles: number of hypotheses.
    survival: survival rate of the layer; frame_rate: Hz.
    Source: Isard & Blake 1998 (Alcoverro 2014, Alg. 1).
    """
    s = body.skeleton
    layer = Layer(
        diffusion(s, frame_sigma(s, frame_rate)), SmoothedWeight(SilhouetteXor(), survival), systematic, "all"
    )
    return Recipe("sir", (layer,), particles, ("silhouettes",), estimate=pose_mean(s))


def apf(
    body: Body,
    particles: int = 240,
    layers: int = 15,
    survival: float = 0.50,
    scale: float = 0.5,
    frame_rate: float = 25.0,
    betas: Sequence[float] | None = None,
    decay: float = 0.64,
) -> Recipe:
    """Build the annealed particle filter.

    particles: number of hypotheses; layers: number of layers; frame_rate: Hz.
    The first layer moves all coordinates by the usual motion of a frame (K_t). Every further layer moves them by
    `scale` times the spread of the set that the previous layer left (adaptive diffusion, at most Sigma_0), or,
    with `betas`, by Sigma_0, decayed from the third layer on.
    survival: survival rate of every layer.
    betas: fixed exponents, one per layer, with the steps of eq. 2.10 (the listing as printed); None: adaptive diffusion
        and the survival rate.
    decay: decay of the variance from layer to layer, alpha of eq. 2.10, where betas are given.
    Source: Deutscher & Reid 2005; 15 layers x 240 particles with adaptive diffusion as in Alcoverro 2014, section 2.4.
        The thesis prints neither scale, survival rate, betas nor alpha. With betas: Algorithm 2, eqs. 2.9 and 2.10.
    """
    s = body.skeleton
    sigma = frame_sigma(s, frame_rate)
    between_layers = AdaptiveDiffusion(scale, s.lower, s.upper, sigma)
    rows = []
    for n, beta in enumerate(betas or layers * [None]):
        fixed = diffusion(s, annealed_sigma(sigma, n * (decay,), max(n - 1, 0)))
        step = between_layers if n and betas is None else fixed
        rows.append(Layer(step, SmoothedWeight(SilhouetteXor(), survival, beta), systematic, f"annealing {n}"))
    return Recipe("apf", rows, particles, ("silhouettes",), estimate=pose_mean(s))


def partitioned(body: Body, particles: int = 572, survival: float = 0.05, frame_rate: float = 25.0) -> Recipe:
    """Build the partitioned sampling filter: each layer moves only its own coordinates and resamples whole states.

    particles: number of hypotheses; frame_rate: Hz.
    survival: survival rate of every layer.
    Deviation: every partition is weighted by the whole silhouettes, with the exponent that the survival rate sets.
    Source: MacCormick & Isard 2000 (Alcoverro 2014, section 2.2.3).
    """
    s = body.skeleton
    sigma = frame_sigma(s, frame_rate)
    rows = [Layer(diffusion(s, sigma), None, keep, "between frames")]
    for name, joints in HPF_LAYERS:
        own = _only(sigma, s.dofs_of(*joints))
        rows.append(Layer(diffusion(s, own), SmoothedWeight(SilhouetteXor(), survival), systematic, name))
    return Recipe("partitioned", rows, particles, ("silhouettes",), estimate=pose_mean(s))


def hpf(
    body: Body,
    particles: int = 572,
    survival: float = 0.05,
    nu: float = 0.7,
    frame_rate: float = 25.0,
    betas: Sequence[float] | None = None,
) -> Recipe:
    """Build the hierarchical (layered) particle filter: 7 layers x 572 particles as published.

    Coordinates are first filtered in their own layer with full steps; in later layers their steps shrink by `nu`
    (Algorithm 3). Only coordinates filtered so far are resampled (Algorithm 4).
    survival: survival rate of every layer; frame_rate: Hz.
    betas: fixed exponents, one per layer, as in the thesis; None: the survival rate sets them.
    Source: Alcoverro 2014, sections 2.2.4 and 2.4.
    """
    return _hierarchical("hpf", body, HPF_LAYERS, particles, survival, nu, frame_rate, betas)


def _hierarchical(
    recipe: str,
    body: Body,
    layers: Sequence[tuple[str, tuple[str, ...]]],
    particles: int,
    survival: float,
    nu: float,
    frame_rate: float,
    betas: Sequence[float] | None,
    *,
    energies: Sequence[Energy] | None = None,
    ends: Landmarks | None = None,
    last: tuple[str, Energy, float] | None = None,
) -> Recipe:
    """Build a layered filter: all coordinates move between two frames, then each layer filters its own.

    recipe: name of the filter; layers: name and joints of each layer; the other numbers are those of `hpf`.
    energies: energy of each layer (default: the silhouettes').
    ends: body ends on which a share of the particles is posed; None: none. A forearm is posed together with its upper
        arm, so both are resampled from the first of their layers on.
    last: name, energy and survival rate of a last layer that does not move; None: none.
    """
    s, fixed = body.skeleton, list(betas or (len(layers) + 1) * [None])
    sigma, psi = frame_sigma(s, frame_rate), [s.dofs_of(*joints) for _, joints in layers]
    rows = [Layer(diffusion(s, sigma), None, keep, "between frames")]
    for n, (name, _) in enumerate(layers):
        filtered = filtered_mask(psi, s.dof, n)
        kernel: Kernel = diffusion(s, layered_sigma(sigma, psi, nu, n))
        if ends is not None:
            limb = name if name in _DRIVEN else name.split("_")[0]
            kernel = DetectorDriven(body, ends, kernel, _DRIVEN[limb], _only(sigma, psi[n]), limb)
            if name.endswith("shoulder"):
                filtered[s.dofs_of(name.replace("shoulder", "elbow"))] = True
        weigh = SmoothedWeight(SilhouetteXor() if energies is None else energies[n], survival, fixed[n])
        rows.append(Layer(kernel, weigh, LayeredResampling(filtered), name))
    if last is not None:
        everything = LayeredResampling(filtered_mask(psi, s.dof, len(layers)))
        rows.append(Layer(stay, SmoothedWeight(*last[1:], fixed[-1]), everything, last[0]))
    needs = ("silhouettes",) if ends is None else ("silhouettes", "detections")
    return Recipe(recipe, rows, particles, needs, estimate=pose_mean(s))


def _only(sigma: Array, own: NDArray[np.int64]) -> Array:
    """Set the steps (D,) of all coordinates but `own` to 0."""
    return np.where(np.isin(np.arange(len(sigma)), own), sigma, 0.0)


def diffusion(skeleton: Skeleton, sigma: Array) -> GaussianDiffusion:
    """Build a search kernel that adds Gaussian steps with standard deviations sigma (D,) to poses, inside the joint
    limits.
    """
    return GaussianDiffusion(sigma, skeleton.lower, skeleton.upper)


# for each layer of the partitioned filter: joints and landmarks of its box, parts that are first drawn in it
_SEEN_PARTS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    "torso": (
        ("pelvis", "chest", "neck", "head", "left_shoulder", "right_shoulder", "left_hip", "right_hip"),
        ("head_top",),
        ("pelvis", "spine", "chest", "neck", "head", "left_clavicle", "right_clavicle"),
    ),
}
for _side in ("left", "right"):
    _SEEN_PARTS[f"{_side}_leg"] = (
        (f"{_side}_hip", f"{_side}_knee", f"{_side}_ankle"),
        (f"{_side}_big_toe",),
        (f"{_side}_hip", f"{_side}_knee", f"{_side}_ankle"),
    )
    _SEEN_PARTS[f"{_side}_shoulder"] = ((f"{_side}_shoulder", f"{_side}_elbow"), (), (f"{_side}_shoulder",))
    _SEEN_PARTS[f"{_side}_elbow"] = (
        (f"{_side}_elbow", f"{_side}_wrist"),
        (f"{_side}_hand_tip",),
        (f"{_side}_elbow", f"{_side}_wrist"),
    )


def layer_regions(body: Body) -> list[tuple[Region, NDArray[np.bool_]]]:
    """List, for each layer of HPF_LAYERS, the region and the faces that are compared there.

    Returns: pairs (region, (F,) true for faces of the layer's own parts and of those of the previous layers).
    """
    out, drawn = [], []
    for name, _ in HPF_LAYERS:
        joints, ends, parts = _SEEN_PARTS[name]
        drawn += parts
        build = torso_region if name == "torso" else chain_region
        out.append((build(body, joints, ends), faces_of_parts(body, tuple(drawn))))
    return out


def hpf_apo(
    body: Body,
    particles: int = 500,
    survival: float = 0.10,
    nu: float = 0.7,
    frame_rate: float = 25.0,
    betas: Sequence[float] | None = None,
) -> Recipe:
    """Build the hierarchical filter with approximate partitioned observations (APO): 7 + 1 layers x 500 particles.

    nu: decay of the steps per layer; frame_rate: Hz.
    The layers and steps of `hpf`, weights by eq. 2.15 inside fixed boxes, and a last layer that weighs the set again in
    a box of the whole body.
    betas: fixed exponents, one per layer (8); None: the survival rate sets them.
    Source: Alcoverro 2014, section 2.4.
    """
    whole = PartitionedXor(body, bounding_region(body, body.skeleton.joint_names, (), margin=0.25))
    return _hierarchical(
        "hpf-apo",
        body,
        HPF_LAYERS,
        particles,
        survival,
        nu,
        frame_rate,
        betas,
        energies=[PartitionedXor(body, region, faces) for region, faces in layer_regions(body)],
        last=("whole body", whole, survival),
    )


# one layer per limb instead of two per arm: the (5+1) form
FIVE_LAYERS = (HPF_LAYERS[0], *LIMB_LAYERS)
# the ends that drive each limb's layers, in the order they are tried (END_NAMES)
_DRIVEN = {"torso": (2,), "left": (0, 3), "right": (1, 4), "left_leg": (5,), "right_leg": (6,)}


def dd_hpf(
    body: Body,
    particles: int = 500,
    survival: float = 0.05,
    nu: float = 0.7,
    frame_rate: float = 25.0,
    betas: Sequence[float] | None = None,
    *,
    layers: tuple[tuple[str, tuple[str, ...]], ...] = HPF_LAYERS,
    refinement: bool = False,
    kappa: float = 4.0,
    last_survival: float = 0.4,
    name: str = "dd-hpf",
) -> Recipe:
    """Build the detector-driven hierarchical filter: `hpf` with a share of each layer's particles posed on detected
    body ends.

    particles: number of hypotheses; nu: decay of the steps per layer; frame_rate: Hz; name: name of the recipe.
    survival: survival rate of every layer; betas: fixed exponents, one per layer, None: the survival rate sets them.
    layers: name and joints of each layer.
    7 layers x 500 particles. Detected ends are hands, head or ankles; they come with the frames (`Frame.detections`) or
    from key points; without any this is `hpf`.
    refinement: add a layer without propagation whose cost includes the distances to the detections (`dd-hpf+`).
    kappa: weight of these distances relative to the silhouettes' cost, 1 / m.
    last_survival: survival rate of that layer.
    Source: Alcoverro 2014, section 2.5.2.
    """
    ends = ends_of(body)
    last = ("refinement", DetectionCost(body, ends, SilhouetteXor(), kappa), last_survival) if refinement else None
    return _hierarchical(name, body, layers, particles, survival, nu, frame_rate, betas, ends=ends, last=last)


def dd_hpf_plus(body: Body, particles: int = 500, frame_rate: float = 25.0) -> Recipe:
    """Build `dd_hpf` with the refinement layer: 7 + 1 layers x 500 particles. Source: Alcoverro 2014, section 2.5.2."""
    return dd_hpf(body, particles, frame_rate=frame_rate, refinement=True, name="dd-hpf+")


def dd_hpf_plus_5(body: Body, particles: int = 500, frame_rate: float = 25.0) -> Recipe:
    """Build `dd_hpf` with whole arms in one layer and the refinement layer: 5 + 1 layers x 500 particles."""
    return dd_hpf(body, particles, frame_rate=frame_rate, layers=FIVE_LAYERS, refinement=True, name="dd-hpf+5")
