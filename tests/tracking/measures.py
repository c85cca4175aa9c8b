"""How far two poses are apart."""

import numpy as np

from hypose.body.body import Body
from hypose.geometry import Array


def joint_error(body: Body, estimated: Array, true: Array) -> float:
    """Mean distance of the joint centres, m."""
    return float(np.linalg.norm(body.joints(estimated) - body.joints(true), axis=-1).mean())
