"""Which degrees of freedom a single view can estimate: the body's 30, and an arm's 7."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hypose.body.skeleton import Skeleton


def body_dofs(skeleton: Skeleton) -> NDArray[np.int64]:
    """The 30 dof of a whole body: all but clavicles and the inversion of the ankles (and forearm twists and wrists),
    which one view does not show."""
    hidden = ("clavicle", "inversion", "twist", "wrist")
    return np.flatnonzero([not any(h in name for h in hidden) for name in skeleton.dof_names])
