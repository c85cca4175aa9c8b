"""Anthropometry by layered particle filtering from one known pose, as the thesis has it.

State X = {shape factors, pose}: the K of hypose.body.anthropometry.SHAPE_FACTORS, then the D degrees of freedom.
The start is found limb by limb with Powell's method; the layers of Table 2.2 follow, with the rejection-sampling kernel
whose prior is eq. 2.13 over the sizes of Table 2.1. It is a recipe for the common search loop. The joint contour
solution over several poses (shape_refinement.py) is more exact and is what the product uses.
Source: Alcoverro 2014, section 2.3.3; Carranza et al. 2003 for fitting limb by limb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import minimize

from hypose.body.anthropometry import SHAPE_FACTORS, TABLE_2_1, body_of, entity
from hypose.body.body import Body, Landmarks
from hypose.body.default_body import JOINT_NAMES
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array
from hypose.inference.annealing import SmoothedWeight
from hypose.inference.estimates import tangent_mean
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import GaussianDiffusion, RejectionSampling, layered_sigma
from hypose.inference.layer import Layer, Recipe
from hypose.inference.resampling import systematic
from hypose.tracking.frame_evidence import PreparedFrame
from hypose.tracking.recipes import THESIS

K = len(SHAPE_FACTORS)
BETAS = (0.1, 0.3, 0.8, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
"""Annealing rates of Table 2.2."""

# Table 2.2: entities and joints of each layer; "shoulder height" scales torso and legs together, which with the head's
# and arms' own factors is the global scale
_HEAD, _UPPER_ARMS = ("head", "neck length"), ("upper arm length", "upper arm girth", "shoulder width")
TABLE_2_2: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    *((f"all {n}", (*_HEAD, *_UPPER_ARMS, "scale"), ("*",)) for n in range(4)),
    ("head and root", _HEAD, ("pelvis",)),
    ("upper arms", _UPPER_ARMS, ("left_clavicle", "left_shoulder", "right_clavicle", "right_shoulder")),
    ("lower arms", ("forearm length", "forearm girth", "hands"), ("left_elbow", "right_elbow")),
    ("upper legs", ("thigh length", "shank length"), ("left_hip", "right_hip")),
    (
        "lower legs",
        ("shank length", "shank girth", "feet"),
        ("left_knee", "left_ankle", "right_knee", "right_ankle"),
    ),
    (
        "torso, legs, hip width",
        (
            *("torso length", "chest width", "chest depth", "waist width", "waist depth"),
            *("pelvis width", "pelvis depth", "hip width", "thigh girth"),
        ),
        (),
    ),
)


@dataclass(frozen=True)
class SizePrior:
    """Log of eq. 2.13 for states (..., K + D): sizes of Table 2.1 from the factors, without building a mesh.

    Sizes are those of `sizes_2_1` at the template, each part scaled by its own factor."""

    template: Body

    def __call__(self, values: Array, /) -> Array:
        """(...,) log-probability up to a constant."""
        total = np.zeros(np.shape(values)[:-1])
        for name, size in self.sizes(values).items():
            mean, variance = TABLE_2_1[name]
            total -= (size - mean) ** 2 / (2 * variance)
        return total

    def sizes(self, values: Array) -> dict[str, Array]:
        """Sizes in cm by entity of Table 2.1, (...,) each."""
        base, f = sizes_2_1(self.template), np.exp(values[..., :K])

        def factor(name: str) -> Array:
            return f[..., 0] * f[..., entity(name)]

        lengths = self.template.segment_lengths()
        thigh, shank = 100 * lengths["left_thigh"], 100 * lengths["left_shank"]
        neck, forearm = 100 * lengths["neck"], 100 * lengths["left_forearm"]
        upper = base["upper arms"] * factor("upper arm length")
        lower = forearm * factor("forearm length") + (base["lower arms"] - forearm) * factor("hands")
        foot = base["legs"] - thigh - shank
        legs = thigh * factor("thigh length") + shank * factor("shank length") + foot * factor("feet")
        return {
            "shoulder height": legs + (base["shoulder height"] - base["legs"]) * factor("torso length"),
            "head": neck * factor("neck length") + (base["head"] - neck) * factor("head"),
            "clavicles": base["clavicles"] * factor("shoulder width"),
            "arms": upper + lower,
            "upper arms": upper,
            "lower arms": lower,
            "legs": legs,
            "torso": base["torso"] * factor("torso length"),
        }


@dataclass(frozen=True)
class ShapeXor:
    """Energy of eq. 2.8 for states (N, K + D): every hypothesis has a body of its own."""

    template: Body

    def __call__(self, h: Hypotheses, frame: PreparedFrame, /) -> Array:
        """(N,) energies."""
        return np.array([shape_energy(self.template, x, frame) for x in h.values])


def shape_energy(template: Body, state: Array, frame: PreparedFrame) -> float:
    """Silhouette energy (eq. 2.8) of one state (K + D,)."""
    return float(frame.silhouettes.energy(body_of(template, state[:K]), state[None, K:])[0])


def anthropometry_recipe(
    template: Body, particles: int = 150, nu: float = 0.8, betas: Sequence[float] | None = None, step: float = 0.25
) -> Recipe:
    """The layers of Table 2.2 with the rejection-sampling kernel (tau = 0.7, ten trials).

    betas: fixed exponents as in the table (BETAS); by default the exponent is solved for a survival rate of 15 %,
    because exponents up to 1 hardly select on energies below 2. Layers resample whole states. step: factor on the steps
    (the spread of people for factors, the motion per frame for the pose): Powell's method leaves little to find, and
    with full steps 150 particles in some 60 dimensions end above where they began.
    """
    light = without_display(template)
    s = light.skeleton
    sigma = step * np.concatenate([[0.35 * e.sd for e in SHAPE_FACTORS], s.sigma])
    sigma[entity("clothing")] = 0.0  # the thesis does not know clothes: they are girth here
    sigma[entity("scale")] = 0.02 * step
    psi = [_coordinates(s, entities, joints) for _, entities, joints in TABLE_2_2]
    lower = np.concatenate([np.full(K, -0.6), s.lower])
    upper = np.concatenate([np.full(K, 0.6), s.upper])
    layers = []
    for n, (name, _, _) in enumerate(TABLE_2_2):
        own = np.zeros(K + s.dof)
        # the first four layers anneal the same coordinates; afterwards each layer moves its own
        own[psi[n]] = layered_sigma(sigma, psi[:4], nu, n)[psi[n]] if n < 4 else sigma[psi[n]]
        kernel = RejectionSampling(GaussianDiffusion(own, lower, upper), SizePrior(light), 0.7, 10)
        weigh = SmoothedWeight(ShapeXor(light), 0.15, None if betas is None else betas[n])
        layers.append(Layer(kernel, weigh, systematic, name))
    balls = tuple(int(K + b) for b in s.ball_starts)
    mean = partial(tangent_mean, rotations=balls)
    return Recipe("anthropometry", layers, particles, ("silhouettes",), estimate=mean, citation=THESIS)


def _coordinates(skeleton: Skeleton, entities: tuple[str, ...], joints: tuple[str, ...]) -> np.ndarray:
    shape = np.array([entity(n) for n in entities], dtype=np.int64)
    if joints == ("*",):
        dofs = np.arange(skeleton.dof)
    else:
        dofs = skeleton.dofs_of(*joints) if joints else np.zeros(0, dtype=np.int64)
    return np.concatenate([shape, K + dofs])


_LIMBS = (
    ("pelvis",),
    ("spine", "neck"),
    ("left_hip", "left_knee", "left_ankle"),
    ("right_hip", "right_knee", "right_ankle"),
    ("left_clavicle", "left_shoulder", "left_elbow"),
    ("right_clavicle", "right_shoulder", "right_elbow"),
)


def powell_start(template: Body, pose: Array, frame: PreparedFrame, evaluations: int = 250) -> Array:
    """State (K + D,): global scale and pose that lower the silhouette energy from `pose` (D,), with Powell's method one
    limb after another, the root and the scale first. evaluations: at most so many per limb."""
    light, s = without_display(template), template.skeleton
    state = np.concatenate([np.zeros(K), pose])
    for n, joints in enumerate(_LIMBS):
        coordinates = K + s.dofs_of(*joints)
        if n == 0:
            coordinates = np.concatenate([[entity("scale")], coordinates])
        step = np.concatenate([[0.05] * K, 3 * s.sigma])[coordinates]
        low = np.concatenate([np.full(K, -0.5), s.lower])[coordinates]
        high = np.concatenate([np.full(K, 0.5), s.upper])[coordinates]

        def energy(
            z: Array,
            coordinates: np.ndarray = coordinates,
            low: Array = low,
            high: Array = high,
            step: Array = step,
            base: Array = state,
        ) -> float:
            trial = base.copy()
            trial[coordinates] = np.clip(base[coordinates] + step * z, low, high)
            return shape_energy(light, trial, frame) + 1e-3 * float((z**2).mean())

        found = minimize(
            energy, np.zeros(len(coordinates)), method="Powell", options={"maxfev": evaluations, "xtol": 0.05}
        )
        if found.fun < energy(np.zeros(len(coordinates))):
            state = state.copy()
            state[coordinates] = np.clip(state[coordinates] + step * found.x, low, high)
    return state


def without_display(body: Body) -> Body:
    """The body with its scoring mesh only, for searches that deform it thousands of times."""
    body.coarse.edges  # noqa: B018 - built once, shared by all deformed copies
    # sizes need the fine mesh's extent: kept where it is asked for by the template, not by its copies
    return replace(body, fine=body.coarse, landmarks=Landmarks((), np.zeros(0, dtype=np.int64), np.zeros((0, 3))))


def log_prior_2_1(sizes_cm: Sequence[tuple[str, float]]) -> float:
    """Logarithm of eq. 2.13: -sum (S_k - M_k)^2 / (2 sigma_k^2) over (name, size in cm) of Table 2.1."""
    return -sum((s - TABLE_2_1[n][0]) ** 2 / (2 * TABLE_2_1[n][1]) for n, s in sizes_cm)


def sizes_2_1(body: Body) -> dict[str, float]:
    """The entities of Table 2.1 on a body at rest, cm.

    The thesis does not say where it measures; taken here: shoulder height above the sole; head from the neck's joint to
    the crown; clavicles between the shoulder joints; arms and lower arms to the middle of the hand (the table's 30.5 cm
    are more than elbow to wrist); legs from the hip joint to the sole; torso from
    the hip joints' middle to the neck's joint.
    """
    j, at, z = body.skeleton.rest_joints, JOINT_NAMES.index, body.fine.vertices[:, 2]
    lengths = body.segment_lengths()
    hips = 0.5 * (j[at("left_hip")] + j[at("right_hip")])
    hand = body.fine.vertices[body.fine.main_joint == at("left_wrist")].mean(0)
    upper, lower = lengths["left_upper_arm"], float(np.linalg.norm(hand - j[at("left_elbow")]))
    out = {
        "shoulder height": j[at("left_shoulder"), 2] - z.min(),
        "head": z.max() - j[at("neck"), 2],
        "clavicles": lengths["shoulder_width"],
        "arms": upper + lower,
        "upper arms": upper,
        "lower arms": lower,
        "legs": hips[2] - z.min(),
        "torso": np.linalg.norm(j[at("neck")] - hips),
    }
    return {k: 100 * float(v) for k, v in out.items()}
