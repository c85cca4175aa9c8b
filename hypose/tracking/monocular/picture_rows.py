"""Rows of one picture: contours of the body against image edges, points of its surface against optical flow.

A row is a residual of a point of the surface with its derivatives (`fitting.problem.Rows`); its weight is the second
derivative of the cost along it, and its residual the first derivative divided by the second.
Source: Sminchisescu & Triggs 2001, sections 3.1 and 3.2.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera
from hypose.compute.losses import along
from hypose.compute.parts import projected
from hypose.compute.zbuffer import draw_faces, inverse_depth
from hypose.evidence.edges_flow import Flow
from hypose.fitting.problem import Posed, Rows
from hypose.fitting.rows import contour_points
from hypose.geometry import Array
from hypose.tracking.monocular.settings import EdgeSettings, FlowSettings, Loss

_CLOSEST_M = 0.1
"""m; faces with a corner nearer than this are not seen."""
_HIDDEN, BEYOND, ROUND = 0.03, 0.03, 0.12
"""m of depth at a contour node. _HIDDEN: the node is occluded where its outer side lies so far behind another surface;
ROUND: or its inner side so far (a trunk's own surface rises by 6 cm within the two pixels). BEYOND: it is a contour
where the surface on its outer side lies so far behind it.
"""
INNER, OUTER, _BORDER = 1.5, 1.7, 2
"""px from the contour at which the depths of its inner and outer side are read, and px along the image border where
there are no nodes.
"""
_MOST_PARTS = 4
_AWAY, _JUMP, _FLOW_BORDER = 4, 0.12, 5
"""Inner nodes: px at which the depths around a node are read, m that these may differ, px along the image border."""
_MARGIN = 6
"""px around the body in which it is drawn."""
_SHARE = 0.1
"""Least second derivative along a residual, as a share of that without rho''."""
_BEHIND_M = 0.05


class View(NamedTuple):
    """Posed body as a camera sees it.

    posed: the body.
    projection: (3, 4) pinhole projection of the camera.
    size: (2,) width, height of the picture, px.
    uv, depth: (V, 2) px, NaN behind the camera, and (V,) m of its vertices.
    front: (F,) faces that are seen from outside.
    corner: (2,) x, y of the pixel at which the drawn part of the picture begins.
    nearest, face: (h, w) inverse depth, 1/m, 0 where nothing is, and number of the visible face, -1 for none.
    """

    posed: Posed
    projection: Array
    size: NDArray[np.int64]
    uv: Array
    depth: Array
    front: NDArray[np.bool_]
    corner: NDArray[np.int64]
    nearest: NDArray[np.float32]
    face: NDArray[np.int32]

    def depths(self, pixels: NDArray[np.int64]) -> Array:
        """Read the depths (N,) of the body at pixels (N, 2), m; infinite where it is not."""
        (h, w), (x, y) = self.nearest.shape, (pixels - self.corner).T
        seen = (x >= 0) & (y >= 0) & (x < w) & (y < h)
        near = np.where(seen, self.nearest[np.where(seen, y, 0), np.where(seen, x, 0)], 0) if h and w else 0.0 * x
        with np.errstate(divide="ignore"):
            return 1 / near


def view_of(posed: Posed, camera: Camera) -> View:
    """Project and draw a posed body."""
    uv, depth, reach = projected(posed.vertices, camera.projection)
    faces, size = np.asarray(posed.mesh.faces), np.array(camera.size)
    one, two = uv[faces[:, 1]] - uv[faces[:, 0]], uv[faces[:, 2]] - uv[faces[:, 0]]
    # pixels run downwards: counter-clockwise from outside has a negative area
    front = (one[:, 0] * two[:, 1] - two[:, 0] * one[:, 1] < -1e-9) & (depth[faces] > _CLOSEST_M).all(1)
    low, high = (np.clip(reach[:, k] + d, 0, size).astype(np.int64) for k, d in ((0, -_MARGIN), (1, 1 + _MARGIN)))
    w, h = np.maximum(high - low, 0).tolist()
    nearest, face = np.zeros((h, w), np.float32), np.full((h, w), -1, np.int32)
    draw_faces(uv - low, inverse_depth(depth), faces, nearest, face, cull=True)
    return View(posed, camera.projection, size, uv, depth, front, low, nearest, face)


def robust(loss: Loss, s: Any, sigma: float) -> tuple[Any, Any, Any]:
    """Compute rho(s) and its first and second derivative: equations (2) and (3) of Sminchisescu & Triggs 2001 with
    nu = 1, and s / sigma^2 for the quadratic loss.

    loss: function of `compute.losses`.
    s: squared length of the residual, px^2.
    sigma: scale, px.
    """
    value, first, second = loss(s / sigma**2, 1 / sigma**2)
    return value, first, second / sigma**2


def curvature(first: Any, second: Any, s: Any) -> Any:
    """Compute the second derivative of rho(s) / 2 along the residual, rho' + 2 rho'' s of equation (9) of
    Sminchisescu & Triggs 2001, kept positive.

    first, second: rho' and rho'' at s.
    s: squared length of the residual.
    Why: far from the peak it is negative, and a Newton step would climb.
    """
    return np.maximum(along(first, second, s), _SHARE * first)


def image_direction(p: Array, uv: Array, depth: Array, direction: Array) -> Array:
    """Compute the derivative (N, 3) of pixels along directions in the image by the point in the world, px / m.

    p: (3, 4) projection.
    uv, depth, direction: (N, 2) px, (N,) m and (N, 2).
    """
    return (direction @ p[:2, :3] - (direction * uv).sum(1, keepdims=True) * p[2, :3]) / depth[:, None]


class Nodes(NamedTuple):
    """N nodes on the contour of a body.

    ends, place: (N, 2) vertices of the mesh edge of each node, and (N,) place on it, 0..1.
    uv, depth: (N, 2) px and (N,) m.
    normal: (N, 2) unit outward normal in the image.
    length: (N,) px of contour for which a node stands.
    seen: (N,) False: the node is occluded.
    """

    ends: NDArray[np.int64]
    place: Array
    uv: Array
    depth: Array
    normal: Array
    length: Array
    seen: NDArray[np.bool_]

    def among(self, chosen: NDArray[np.bool_]) -> Nodes:
        """Select nodes by a mask (N,)."""
        return Nodes._make(column[chosen] for column in self)


def contour_nodes(view: View, moving: NDArray[np.bool_], spacing: float) -> Nodes:
    """Place nodes on the occluding contour of the moving parts of a body.

    moving: (V,) vertices of these parts.
    spacing: distance of the nodes, px.

    A node lies on a mesh edge between a face seen from outside and one that is not. It is seen where nothing lies in
    front of it and its outer side shows a surface well behind it (the background: infinitely far). Else it is occluded
    (kept), or not a contour (omitted).
    """
    edges, uv = np.asarray(view.posed.mesh.edges), view.uv
    edges = edges[(moving & (view.depth > _CLOSEST_M))[edges[:, :2]].all(1)]
    parts = lambda length: np.clip((length / spacing + 0.5).astype(np.int64), 1, _MOST_PARTS)  # noqa: E731
    # the place in space, so that the node is a fixed point of the body
    ends, place, length, across = contour_points(edges, view.front, uv, 0.3, parts)
    share = np.stack([1 - place, place], 1) * view.depth[ends]
    depth = share.sum(1)
    at = (share[..., None] * uv[ends]).sum(1) / depth[:, None]
    inner, outer = (np.floor(at + d * across + 0.5).astype(np.int64) for d in (-INNER, OUTER))
    within = (np.minimum(inner, outer) >= _BORDER) & (np.maximum(inner, outer) < view.size - _BORDER)
    behind = view.depths(outer)
    hidden = (behind < depth - _HIDDEN) | (view.depths(inner) < depth - ROUND)
    kept = within.all(1) & (hidden | (behind > depth + BEYOND))
    return Nodes(ends, place, at, depth, across, length, ~hidden).among(kept)


def line_search(
    field: NDArray[np.float32], uv: Array, normal: Array, window: int, threshold: float
) -> tuple[Array, Array]:
    """Find all edges in the windows along normals: local maxima of the gradient's component along them.

    field: (h, w, 2) image gradient in units of a full edge.
    uv, normal: (N, 2) nodes and unit normals, px.
    window: px that are searched on either side.
    threshold: weakest edge that counts.
    Returns: sub-pixel offsets (N, K) px, and strengths (N, K), at most 1; 0 where there is no edge.
    """
    h, w = field.shape[:2]
    steps = np.arange(-window, window + 1)
    at = np.clip(uv[:, None] + steps[:, None] * normal[:, None], 0, (w - 1.001, h - 1.001))
    (column, row), share = np.moveaxis(at.astype(np.int64), 2, 0), at % 1
    a, b = share[..., :1], share[..., 1:]
    top = (1 - a) * field[row, column] + a * field[row, column + 1]
    bottom = (1 - a) * field[row + 1, column] + a * field[row + 1, column + 1]
    energy = np.abs((((1 - b) * top + b * bottom) * normal[:, None]).sum(2))
    before, here, after = energy[:, :-2], energy[:, 1:-1], energy[:, 2:]
    peak, bend = (here > threshold) & (here >= before) & (here > after), before - 2 * here + after
    offset = steps[1:-1] + 0.5 * (before - after) / np.where(np.abs(bend) > 1e-9, bend, np.inf)
    return offset, np.where(peak, np.minimum(here, 1.0), 0.0)


def edge_rows(
    view: View, moving: NDArray[np.bool_], field: NDArray[np.float32], settings: EdgeSettings, sigma: float
) -> tuple[Rows, tuple[int, int]]:
    """Compute the rows of the contour against the edges of a picture, over all edges of each node's window: equation
    (7) of Sminchisescu & Triggs 2001, first sum.

    moving: (V,) vertices of the moving parts.
    field: (h, w, 2) edges of the picture.
    settings: settings of the term.
    sigma: scale of the loss, px.
    Returns: the rows; numbers of nodes that are seen, and of those with an edge.
    Deviations: a node's edges share the weight 1, less where they are weak in sum; the rest counts as unassigned, at
    the cost of the window's end. An occluded node costs k nu / 2, so that k is its share of the cost of a node without
    an edge. A node stands for its length of contour, and the sum is not divided by N nu of equation (6), so that it is
    a log-likelihood to which priors can be added. Back-facing nodes cost nothing, because their share of a closed
    surface hardly changes. The expected cost of a place without a body is subtracted for every node, because otherwise
    limbs would hide.
    """
    e, nodes = settings, contour_nodes(view, moving, settings.spacing_px)
    unassigned = robust(e.loss, float(e.window_px**2), sigma)[0]
    samples, seen = e.height * nodes.length / e.sample_px, nodes.seen
    cost = 0.5 * float(samples[~seen].sum()) * (e.occluded - e.background) * unassigned
    nodes, samples = nodes.among(seen), samples[seen]
    offset, strength = line_search(field, nodes.uv, nodes.normal, e.window_px, e.threshold)
    total = strength.sum(1)
    scale = 1 / np.maximum(total, 1.0)
    share, s = strength * scale[:, None], offset**2
    rho, first, second = robust(e.loss, s, sigma)
    value = (1 - total * scale) * unassigned + (share * rho).sum(1)
    cost += 0.5 * float(samples @ (value - e.background * unassigned))
    found = total > 0
    pull, bend = (samples * (share * x).sum(1) for x in (-first * offset, curvature(first, second, s)))
    slope = image_direction(view.projection, nodes.uv, nodes.depth, nodes.normal)[found]
    place, carrier = nodes.place[found], nodes.ends[found][:, [0, 1, 1]]
    shares = np.stack([1 - place, place, np.zeros(len(place))], 1)
    counts = len(found), int(found.sum())
    return _curved(view.posed, carrier, shares, slope, pull[found], bend[found], cost), counts


class FlowTargets(NamedTuple):
    """Points of the surface in the previous picture, and where the optical flow has carried them.

    carrier, share: (N, 3) vertices of which a point is a blend, and their shares.
    target: (N, 2) px.
    """

    carrier: NDArray[np.int64]
    share: Array
    target: Array


def flow_targets(view: View, moving: NDArray[np.bool_], flow: Flow, settings: FlowSettings) -> FlowTargets:
    """Place nodes on the surface of the body in the previous picture, and find where the flow has carried them.

    view: the body in the previous picture.
    moving: (V,) vertices of the moving parts.
    flow: optical flow from the previous picture.
    settings: settings of the term.

    The nodes lie on a grid. Those near a jump in depth or on still parts, and outliers of the flow are omitted.
    """
    faces = np.asarray(view.posed.mesh.faces)
    low, high = np.maximum(view.corner, _FLOW_BORDER), view.corner + view.nearest.shape[::-1]
    high = np.minimum(np.minimum(high, view.size - _FLOW_BORDER), np.array(flow.corner) + flow.error.shape[::-1] - 1)
    low, step = np.maximum(low, flow.corner), settings.spacing_px
    columns, rows = (np.arange(np.ceil(a / step), np.ceil(b / step)) * step for a, b in zip(low, high, strict=True))
    pixel = np.rint(np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)).astype(np.int64)
    (x, y), (u, v) = (pixel - view.corner).T, (pixel - flow.corner).T
    depth, face = view.depths(pixel), view.face[y, x]
    use = (face >= 0) & moving[faces[face]].all(1) & (flow.error[v, u] < settings.consistency_px)
    for away in ((_AWAY, 0), (-_AWAY, 0), (0, _AWAY), (0, -_AWAY)):
        use[use] = np.abs(view.depths(pixel[use] + away) - depth[use]) <= _JUMP
    carrier, at = faces[face[use]].astype(np.int64), pixel[use]
    corner = view.uv[carrier]
    a, b, c = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], at - corner[:, 0]
    area = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
    one = (c[:, 0] * b[:, 1] - b[:, 0] * c[:, 1]) / area
    two = (a[:, 0] * c[:, 1] - c[:, 0] * a[:, 1]) / area
    share = np.stack([1 - one - two, one, two], 1) / view.depth[carrier]  # weights in space from those in the image
    return FlowTargets(
        carrier, share / share.sum(1, keepdims=True), (at + flow.flow[v[use], u[use]]).astype(np.float64)
    )


def flow_rows(posed: Posed, projection: Array, targets: FlowTargets, settings: FlowSettings) -> Rows:
    """Compute the rows of the distances of inner nodes from where the flow has carried them: equation (7) of
    Sminchisescu & Triggs 2001, second sum.

    projection: (3, 4) pinhole projection of the camera.
    targets: nodes of the previous picture (outliers of the flow have none).
    settings: settings of the term.
    """
    carrier, share, target = targets
    weight = settings.height * (settings.spacing_px / settings.area_px) ** 2
    seen = np.einsum("rc,rcd->rd", share, posed.vertices[carrier]) @ projection[:, :3].T + projection[:, 3]
    front = seen[:, 2] >= _BEHIND_M
    cost = 0.5 * weight * robust(settings.loss, 1e6, settings.sigma_px)[0] * int((~front).sum())
    carrier, share, target, seen = carrier[front], share[front], target[front], seen[front]
    uv, depth = seen[:, :2] / seen[:, 2:], seen[:, 2]
    s = ((uv - target) ** 2).sum(1)
    rho, first, second = robust(settings.loss, s, settings.sigma_px)
    length, bend = np.sqrt(s), weight * curvature(first, second, s)
    # along the residual and across it: the eigenvectors of (9)'s bracket
    ahead = np.where(length[:, None] > 1e-9, (uv - target) / np.maximum(length, 1e-9)[:, None], (1.0, 0.0))
    slopes = [image_direction(projection, uv, depth, d) for d in (ahead, np.stack([-ahead[:, 1], ahead[:, 0]], 1))]
    pull = np.r_[weight * first * length, 0 * s]
    twice, cost = np.r_[0 : len(s), 0 : len(s)], cost + 0.5 * weight * float(rho.sum())
    bends = np.r_[bend, weight * first]
    return _curved(posed, carrier[twice], share[twice], np.concatenate(slopes), pull, bends, cost)


def _curved(
    posed: Posed, carrier: NDArray[np.int64], share: Array, slope: Array, first: Array, second: Array, cost: float
) -> Rows:
    """Make rows from the first and second derivatives (R,) of a cost along directions in the world.

    carrier, share, slope: as in `Rows`.
    cost: cost of all residuals.
    """
    point = np.einsum("rc,rcd->rd", share, posed.vertices[carrier])
    residual = first / np.maximum(second, 1e-300)
    return Rows(carrier, share, point, slope, residual, second, np.zeros(len(carrier), np.int64), cost)
