"""The flat arrays that hot functions work on: a joint tree and a skinned mesh, as NamedTuples that numba takes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FIXED, BALL, HINGES = 0, 1, 2


class TreeArrays(NamedTuple):
    """Joint tree. J joints in parent-before-child order, D degrees of freedom; q[0:3] is the root's position, the
    root's rotation vector is its ball joint (dof_start 3)."""

    parents: NDArray[np.int64]
    """(J,) parent index, -1 for the root."""
    kind: NDArray[np.int64]
    """(J,) FIXED, BALL (three dof, rotation vector in the parent's frame) or HINGES (product of exponentials)."""
    dof_start: NDArray[np.int64]
    """(J,) first dof of the joint (undefined for FIXED)."""
    dof_count: NDArray[np.int64]
    """(J,) number of rotational dof."""
    axes: NDArray[np.float64]
    """(D, 3) unit rotation axis of a dof in the model frame at rest (translation direction for the first three)."""
    joints: NDArray[np.float64]
    """(J, 3) rest joint centres in the model frame, m; the root at the origin."""
    joint_of_dof: NDArray[np.int64]
    """(D,) joint that a dof moves (the root for the first six)."""


class MeshArrays(NamedTuple):
    """Closed skinned triangle mesh in the model frame at rest."""

    vertices: NDArray[np.float32]
    """(V, 3) m."""
    faces: NDArray[np.int32]
    """(F, 3) counter-clockwise seen from outside."""
    edges: NDArray[np.int32]
    """(E, 4): vertices a, b and the faces left (holds a->b) and right (holds b->a)."""
    skin_index: NDArray[np.int32]
    """(V, 4) joints that carry the vertex."""
    skin_weight: NDArray[np.float32]
    """(V, 4) weights, descending, sum 1."""
    skin_count: NDArray[np.int32]
    """(V,) number of non-zero weights, 1-4."""
