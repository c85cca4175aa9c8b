"""Settings of a monocular tracker, and the degrees of freedom that a single view can estimate.

Every ablation of the method is one of these settings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.skeleton import Skeleton
from hypose.compute.mono import EdgeSettings, FlowSettings


def body_dofs(skeleton: Skeleton) -> NDArray[np.int64]:
    """List the 30 dof of a whole body that one view shows: all but clavicles, ankle inversion, forearm twists and
    wrists.
    """
    hidden = ("clavicle", "inversion", "twist", "wrist")
    return np.flatnonzero([not any(h in name for h in hidden) for name in skeleton.dof_names])


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

    def robust(self, form: int) -> MonoSettings:
        """Copy the settings with one form of loss for edges and flow (GAUSSIAN is the ablation without robust
        losses).
        """
        return replace(self, edge=self.edge._replace(form=form), flow=self.flow._replace(form=form))
