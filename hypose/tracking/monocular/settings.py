"""Settings of a monocular tracker, and the degrees of freedom that a single view can estimate.

Every ablation of the method is one of these settings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.skeleton import Skeleton


def body_dofs(skeleton: Skeleton) -> NDArray[np.int64]:
    """List the 30 dof of a whole body that one view shows: all but clavicles, ankle inversion, forearm twists and
    wrists."""
    hidden = ("clavicle", "inversion", "twist", "wrist")
    return np.flatnonzero([not any(h in name for h in hidden) for name in skeleton.dof_names])


@dataclass(frozen=True)
class EdgeSettings:
    """Settings of the edge term, which compares contours with image edges.

    form: of the cost: 'gaussian', 'lorentzian' or 'leclerc'; sigma_px: its scale, px.
    height: nu, the cost of one independent sample that finds no edge.
    sample_px: px of contour per independent sample; spacing_px: distance of the contour's nodes.
    window_px: reach of the line search to either side.
    strength: quantile of the image gradient that counts as a full edge; threshold: weakest edge used, as a share of it.
    smoothing_px: smoothing of the image before.
    background: expected cost of a node where no body is, as a share of nu, subtracted from each node. Why: a contour
        that fits worse than by chance would cost less the shorter it is, so with too low a value limbs hide.
    occluded: k of equation (5), cost of an occluded node as a share of nu; equal to background, hiding has no effect.
    motion_boundaries: weight the edges by motion boundaries; boundary_floor: weight of an edge where nothing moves.
    coarse_factor: factor on sigma in the first iterations.
    """

    form: str = "leclerc"
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
    motion_boundaries: bool = True
    boundary_floor: float = 0.1
    coarse_factor: float = 2.0


@dataclass(frozen=True)
class FlowSettings:
    """Settings of the flow term, which compares inner nodes with optical flow.

    use: False leaves the term out.
    form, sigma_px, height: as for edges.
    area_px: side of the square that makes one independent sample, px.
    spacing_px: distance of the grid's nodes, px.
    consistency_px: nodes with a larger forward-backward error are outliers.
    """

    use: bool = True
    form: str = "lorentzian"
    sigma_px: float = 1.2
    height: float = 0.1
    area_px: float = 14.0
    spacing_px: float = 8.0
    consistency_px: float = 1.0


@dataclass(frozen=True)
class CueSettings:
    """Settings of silhouettes, 2D points (key points, clicked joints) and the floor.

    silhouette_height, silhouette_form, silhouette_sigma_px: as for edges; height 0: not used.
    point_weight: factor on all points; 0: not used. The points carry their own scales.
    point_form: form of the cost of points.
    floor_sd_m: usual distance of the lower sole from a known floor, m.
    """

    silhouette_height: float = 2.0
    silhouette_form: str = "lorentzian"
    silhouette_sigma_px: float = 4.0
    point_weight: float = 1.0
    point_form: str = "lorentzian"
    floor_sd_m: float = 0.05


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search with several hypotheses (section 4.2, figure 4).

    hypotheses: k, number kept from frame to frame.
    directions: n_s, uncertain eigen-directions sampled per hypothesis; samples: on either side of each.
    reach: p_f, distance of the outermost sample in standard deviations.
    longest: no sample moves a dof by more than this many times its usual motion.
    isotropic: use random directions instead.
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
    isotropic: bool = False
    distinct_m: float = 0.03
    memory: float = 0.8
    flips: bool | None = False
    flip_every: int = 5


@dataclass(frozen=True)
class MonoSettings:
    """All settings of a monocular tracker.

    edge, flow, cues, search: settings of the terms and of the search.
    edges: False leaves the edges out.
    velocity: share of the last step that is predicted again (0: none, as in the printed listing).
    motion_scale: expected error of that prediction, in units of the skeleton's usual motion per frame.
    posture_scale: spread of the weak pull to the rest posture, in the same units.
    limits: joint limits are hard.
    interpenetration: weight of the prior that keeps limbs out of each other and the trunk (0: none).
    second_order: use rho'' in the Hessian (9), safeguarded.
    iterations, coarse_iterations: of the Newton search per frame.
    inflation: factor on the standard deviations of the reported posterior, because errors of neighbouring nodes are
        correlated (chosen on other scenes).
    frame_rate: Hz.
    """

    edge: EdgeSettings = EdgeSettings()
    flow: FlowSettings = FlowSettings()
    cues: CueSettings = CueSettings()
    search: SearchSettings = SearchSettings()
    edges: bool = True
    velocity: float = 1.0
    motion_scale: float = 3.0
    posture_scale: float = 15.0
    limits: bool = True
    interpenetration: float = 1.0
    second_order: bool = True
    iterations: int = 10
    coarse_iterations: int = 3
    inflation: float = 2.0
    frame_rate: float = 25.0

    def robust(self, form: str) -> MonoSettings:
        """Copy the settings with one cost form for every cue ('gaussian' is the non-robust ablation)."""
        return replace(
            self,
            edge=replace(self.edge, form=form),
            flow=replace(self.flow, form=form),
            cues=replace(self.cues, silhouette_form=form, point_form=form),
        )
