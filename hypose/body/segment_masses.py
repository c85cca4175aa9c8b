"""Masses of a body's segments: its fine mesh filled with cubes of one density, each cube belonging to the nearest skin.

What musculoskeletal programs need of a person is on the body already: no table of average people is scaled. A body is
within 2 % of the density of water with air in its lungs, so one density serves; clothes count as body.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.body.body import Body, Mesh
from hypose.geometry import Array

DENSITY = 1000.0
"""kg/m^3."""
_CUBE = 0.01  # m


@dataclass(frozen=True)
class SegmentMass:
    """mass kg; centre (3,) m in the model frame at rest; inertia (3, 3) kg m^2 about the centre, along its axes."""

    mass: float
    centre: Array
    inertia: Array


def segment_masses(
    body: Body, segments: Mapping[str, Sequence[str]], mass: float | None = None
) -> dict[str, SegmentMass]:
    """Mass, centre and inertia of segments, each given by the names of the joints that carry its skin.

    mass: kg of the whole body, where it is known; else that of its volume. A segment without volume (a body of one's
    own may have no hands) is one cube at its first joint, for a body without mass stops simulations.
    """
    from scipy.spatial import KDTree  # takes long to import

    points = _inside(body.fine)
    carrier = body.fine.main_joint[KDTree(body.fine.vertices).query(points)[1]]
    density = DENSITY if mass is None else mass / (len(points) * _CUBE**3)
    out = {}
    for name, joints in segments.items():
        own = points[np.isin(carrier, [body.skeleton.joint(j) for j in joints])]
        if not len(own):
            own = body.skeleton.rest_joints[[body.skeleton.joint(joints[0])]]
        each = density * _CUBE**3
        centre = own.mean(0)
        d = own - centre
        squares = (d * d).sum()
        # a cube's own inertia is 1/6 of its mass times its edge squared, about any axis
        inertia = each * (squares * np.eye(3) - d.T @ d + len(own) * _CUBE**2 / 6 * np.eye(3))
        out[name] = SegmentMass(each * len(own), centre, inertia)
    return out


def _inside(mesh: Mesh) -> Array:
    """(N, 3) m: centres of the cubes inside a closed mesh: an odd number of faces lies above them."""
    corners = mesh.vertices[mesh.faces]
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    # a hair off the regular grid: no ray runs along an edge of a symmetric mesh
    axes = [
        np.arange(a + 0.5 * _CUBE + 1.2e-5 * k, b, _CUBE) for k, (a, b) in enumerate(zip(low, high, strict=True), 1)
    ]
    x, y, z = axes
    above = np.zeros((len(x), len(y), len(z)), dtype=np.int64)
    for a, b, c in corners:
        i = slice(*np.searchsorted(x, (min(a[0], b[0], c[0]), max(a[0], b[0], c[0]))))
        j = slice(*np.searchsorted(y, (min(a[1], b[1], c[1]), max(a[1], b[1], c[1]))))
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0 or i.start == i.stop or j.start == j.stop:
            continue
        px, py = x[i, None], y[None, j]
        v = ((b[0] - px) * (c[1] - py) - (c[0] - px) * (b[1] - py)) / area
        w = ((c[0] - px) * (a[1] - py) - (a[0] - px) * (c[1] - py)) / area
        hit = (v >= 0) & (w >= 0) & (v + w <= 1)
        height = v * a[2] + w * b[2] + (1 - v - w) * c[2]
        above[i, j] += (hit[..., None] & (z < height[..., None])).astype(np.int64)
    chosen = np.argwhere(above % 2 == 1)
    return np.stack([axis[chosen[:, k]] for k, axis in enumerate(axes)], axis=1)
