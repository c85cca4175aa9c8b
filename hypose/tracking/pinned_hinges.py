"""Limbs that have run into the limit of their elbow or knee, turned about themselves.

An arm that is solved for while it is straight may end up turned the wrong way round: then the elbow would have to bend
backwards, is held at its limit, and the shoulder twists ever further to make up for it. No small step leads out, since
the way back leads through worse poses. So where a hinge is at its limit the limb is tried turned about itself and bent,
and what its key points like as well is solved for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hypose.body.body import Body
from hypose.body.skeleton import Skeleton
from hypose.fitting import KeypointTerm, SolveSettings, fit_pose
from hypose.fitting.articulated import Quadratic
from hypose.geometry import Array, so3_exp, so3_log
from hypose.tracking.costs import keypoint_cost

LIMBS = tuple(
    (f"{side}_{root}", f"{side}_{hinge}")
    for side in ("left", "right")
    for root, hinge in (("shoulder", "elbow"), ("hip", "knee"))
)
AT_LIMIT = np.radians(6.0)
"""rad: a hinge that is not further from its limit is held by it."""
TURNS = np.radians([60.0, 120.0, 180.0, 240.0, 300.0])
BENDS = np.radians([25.0, 50.0, 80.0])
"""How the limb is tried: turned about itself, and bent from the limit."""
WORTH, BETTER = 3.0, 1.0
"""In log-likelihood: by how much a pose may be worse before it is solved, and must be better then to be kept."""


def unpinned(body: Body, pose: Array, term: KeypointTerm, priors: Sequence[Quadratic], options: SolveSettings) -> Array:
    """The pose (D,), solved on the key points of a frame, or a better one in which no limb is turned the wrong way."""
    best = pose
    for root, hinge in LIMBS:
        s = body.skeleton
        (bend,) = s.dofs_of(hinge)
        if best[bend] - s.lower[bend] > AT_LIMIT:
            continue
        tried = _turned(s, best, root, hinge)
        cost = keypoint_cost(body, np.concatenate([best[None], tried]), term)
        n = int(np.argmin(cost[1:]))
        if cost[1 + n] > cost[0] + WORTH:
            continue
        still = SolveSettings(iterations=0, coarse_iterations=0)
        now = fit_pose(body, best, keypoints=term, priors=priors, options=still).cost
        found = fit_pose(body, tried[n], keypoints=term, priors=priors, options=options)
        if found.cost < now - BETTER:
            best = found.pose
    return best


def _turned(skeleton: Skeleton, pose: Array, root: str, hinge: str) -> Array:
    """(N, D): a pose with one limb turned about itself at its root and bent, in all ways."""
    own, (bend,) = skeleton.dofs_of(root), skeleton.dofs_of(hinge)
    along = skeleton.rest_offsets[skeleton.joint(hinge)]
    turns = so3_log(so3_exp(pose[own]) @ so3_exp(TURNS[:, None] * along / np.linalg.norm(along)))
    out = np.repeat(pose[None], len(TURNS) * len(BENDS), 0)
    out[:, own] = np.repeat(turns, len(BENDS), 0)
    out[:, bend] = skeleton.lower[bend] + np.tile(BENDS, len(TURNS))
    return skeleton.clamp(out)
