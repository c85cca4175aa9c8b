"""What one search looks at, put together: the body's moving parts, a frame's evidence, the priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Mesh
from hypose.body.skeleton import Skeleton
from hypose.cameras.camera import Camera
from hypose.compute import FloorArrays, MonoModel, MonoPriors, MonoProblem, SphereArrays, mono
from hypose.errors import InputError
from hypose.evidence.edges import edge_field
from hypose.evidence.flow import Flow
from hypose.evidence.frame import Picture
from hypose.geometry import Array
from hypose.tracking.contacts import soles_of
from hypose.tracking.monocular.evidence import edge_arrays, flow_arrays, mark_arrays, mask_arrays
from hypose.tracking.monocular.interpenetration import part_spheres
from hypose.tracking.monocular.points import MonoPoints
from hypose.tracking.monocular.settings import CueSettings, MonoSettings

LONGEST_STEP = 2.0
"""times the expected error of a prediction: the longest Newton step"""


@dataclass(frozen=True)
class Fixed:
    """What does not change from frame to frame: the model, the spheres, the floor, limits (A,), and how far each active
    dof usually is from its prediction (A,)."""

    model: MonoModel
    spheres: SphereArrays
    floor: FloorArrays
    lower: Array
    upper: Array
    spread: Array


def fixed_parts(
    body: Body,
    mesh: Mesh,
    camera: Camera,
    active: NDArray[np.int64],
    settings: MonoSettings,
    floor: float | None = None,
) -> Fixed:
    """The parts of the problem that do not change; floor: its height in the world, m, None where there is none or it is
    not known. An InputError when the active dof are not dof of the body."""
    s = body.skeleton
    if active.ndim != 1 or len(active) == 0 or (np.diff(active) <= 0).any() or active[0] < 0 or active[-1] >= s.dof:
        raise InputError(f"The dof to estimate must be ascending indices between 0 and {s.dof - 1}, got {active}.")
    unbounded = np.full(len(active), np.inf)
    return Fixed(
        mono.model(s.tree, mesh.arrays, s.moves, active, camera.projection),
        part_spheres(body, settings.interpenetration),
        floor_arrays(body, floor, settings.cues),
        np.array(s.lower[active]) if settings.limits else -unbounded,
        np.array(s.upper[active]) if settings.limits else unbounded,
        prediction_spread(s, settings)[active],
    )


def floor_arrays(body: Body, height: float | None, settings: CueSettings) -> FloorArrays:
    """The soles of a body on a floor at a height in the world, m; None: the term is left out."""
    if height is None:
        return FloorArrays(np.zeros(0, np.int64), np.zeros((0, 3)), 0.0, 1.0, 0.0)
    soles = soles_of(body)
    return FloorArrays(soles.joint, soles.offset, float(height), float(settings.floor_sd_m), 1.0)


def prediction_spread(skeleton: Skeleton, settings: MonoSettings) -> Array:
    """(D,) how far a pose usually is from its prediction, 1 sd, at the settings' frame rate."""
    return settings.motion_scale * skeleton.sigma * (25.0 / settings.frame_rate)


def frame_problem(
    fixed: Fixed,
    picture: Picture,
    points: MonoPoints | None,
    field: NDArray[np.float32],
    flow: Flow | None,
    settings: MonoSettings,
) -> MonoProblem:
    """The problem of one frame, whose edges are `field`, with the pull to the rest posture but no prediction yet."""
    edge = settings.edge
    a = len(fixed.model.active)
    posture = np.zeros(a)
    angles = fixed.model.active >= 6  # where the body is and which way it faces has no usual value
    posture[angles] = (settings.motion_scale / (settings.posture_scale * fixed.spread[angles])) ** 2
    priors = MonoPriors(
        np.zeros((2, a)),
        np.stack([np.zeros(a), posture]),
        fixed.lower,
        fixed.upper,
        LONGEST_STEP * fixed.spread,
    )
    return MonoProblem(
        fixed.model,
        edge_arrays(field, flow, edge, use=settings.edges),
        flow_arrays(flow, settings.flow),
        mask_arrays(picture.mask, settings.cues, edge.sample_px),
        mark_arrays(points, settings.cues),
        fixed.spheres,
        fixed.floor,
        priors,
        settings.second_order,
    )


def field_of(image: NDArray[np.uint8], settings: MonoSettings) -> NDArray[np.float32]:
    """The edges (h, w, 2) of a picture."""
    if not settings.edges:
        return np.zeros((*image.shape[:2], 2), np.float32)
    return edge_field(image, settings.edge.smoothing_px, settings.edge.strength)


def with_prediction(problem: MonoProblem, prediction: Array, spread: Array) -> MonoProblem:
    """The problem with a pull to the predicted pose (D,), spread (A,)."""
    centre, weight = problem.priors.centre.copy(), problem.priors.weight.copy()
    centre[0], weight[0] = prediction[problem.model.active], 1 / spread**2
    return problem._replace(priors=problem.priors._replace(centre=centre, weight=weight))
