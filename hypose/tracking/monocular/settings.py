"""Settings of a monocular tracker, and the degrees of freedom that a single view can estimate.

Every ablation of the method is one of these settings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.body.skeleton import Skeleton
from hypose.compute.losses import leclerc, lorentzian


def body_dofs(skeleton: Skeleton) -> NDArray[np.int64]:
    """List the 30 dof of a whole body that one view shows: all but clavicles, ankle inversion, forearm twists and
    wrists.
    """
    hidden = ("clavicle", "inversion", "twist", "wrist")
    return np.flatnonzero([not any(h in name for h in hidden) for name in skeleton.dof_names])


Loss = Callable[[Any, Any], tuple[Any, Any, Any]]
"""Robust loss of a squared residual, and a factor of its derivatives; see `compute.losses`."""


class EdgeSettings(NamedTuple):
    """Settings of the edge term, which compares contours with image edges.

    loss: robust loss, a function of `compute.losses`.
    sigma_px: its scale, px.
    height: nu, the cost of one independent sample that finds no edge.
    sample_px: px of contour per independent sample.
    window_px: px that are searched along the normal on either side.
    spacing_px: distance of the contour's nodes, px.
    strength: quantile of the image gradient that counts as a full edge.
    threshold: weakest edge that counts, as a share of a full one.
    smoothing_px: standard deviation of the smoothing of the image before, px.
    background: expected cost of a node where no body is, as a share of nu, subtracted from each node. Why: a contour
        that fits worse than by chance would cost less the shorter it is, so with too low a value limbs hide.
    occluded: k of equation (5), cost of an occluded node as a share of nu; equal to background, hiding has no effect.
    boundary_floor: weight of an edge where nothing moves.
    coarse_factor: factor on sigma in the first iterations.
    """

    loss: Loss = leclerc
    sigma_px: float = 3.0
    height: float = 5.0
    sample_px: float = 8.0
    window_px: int = 14
    spacing_px: float = 6.0
    strength: float = 0.93
    threshold: float = 0.08
    smoothing_px: float = 1.2
    background: float = 0.8
    occluded: float = 0.8
    boundary_floor: float = 0.1
    coarse_factor: float = 2.0


class FlowSettings(NamedTuple):
    """Settings of the flow term, which compares inner nodes with optical flow.

    loss, sigma_px, height: loss, its scale (px) and height, as for edges.
    area_px: side of the square that makes one independent sample, px.
    spacing_px: distance of the grid's nodes, px.
    consistency_px: nodes with a larger forward-backward error are outliers.
    """

    loss: Loss = lorentzian
    sigma_px: float = 1.2
    height: float = 0.1
    area_px: float = 14.0
    spacing_px: float = 8.0
    consistency_px: float = 1.0


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search with several hypotheses (section 4.2, figure 4).

    hypotheses: k, number kept from frame to frame.
    directions: n_s, uncertain eigen-directions sampled per hypothesis; samples: on either side of each.
    reach: p_f, distance of the outermost sample in standard deviations.
    longest: no sample moves a dof by more than this many times its usual motion.
    distinct_m: hypotheses differ when a joint or landmark lies further apart than this, m.
    memory: share of the accumulated cost carried to the next frame.
    flips: also optimise and pool mirrored limbs while tracking, every flip_every frames (None: where there are key
        points).
    """

    hypotheses: int = 7
    directions: int = 3
    samples: int = 1
    reach: float = 4.0
    longest: float = 2.5
    distinct_m: float = 0.03
    memory: float = 0.8
    flips: bool | None = False
    flip_every: int = 5


@dataclass(frozen=True)
class MonoSettings:
    """All settings of a monocular tracker.

    edge, flow, search: settings of the terms and of the search.
    mask_weight: weight of a contour row of a mask, as for `contour_term` (0: masks are not used).
    edges: False leaves the edges out.
    velocity: share of the last step that is predicted again (0: none, as in the printed listing).
    motion_scale: expected error of that prediction, in units of the skeleton's usual motion per frame.
    posture_scale: spread of the weak pull to the rest posture, in the same units.
    interpenetration: weight of the prior that keeps limbs out of each other and the trunk (0: none).
    floor_sd_m: usual distance of the lower sole from a known floor, m.
    iterations, coarse_iterations: number of all and of coarse iterations of the Newton search per frame.
    inflation: factor on the standard deviations of the reported posterior, because errors of neighbouring nodes are
        correlated (chosen on other scenes).
    frame_rate: Hz.
    """

    edge: EdgeSettings = EdgeSettings()
    flow: FlowSettings = FlowSettings()
    mask_weight: float = 0.75
    search: SearchSettings = SearchSettings()
    edges: bool = True
    velocity: float = 1.0
    motion_scale: float = 3.0
    posture_scale: float = 15.0
    interpenetration: float = 1.0
    floor_sd_m: float = 0.05
    iterations: int = 10
    coarse_iterations: int = 3
    inflation: float = 2.0
    frame_rate: float = 25.0

    def robust(self, loss: Loss) -> MonoSettings:
        """Copy the settings with one loss for edges and flow (`quadratic` is the ablation without robust losses)."""
        return replace(self, edge=self.edge._replace(loss=loss), flow=self.flow._replace(loss=loss))
