"""Convert a picture into the flat arrays of the search's cost terms: edges, flow, silhouette and 2D points."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.compute.mask_distance import signed_distance
from hypose.compute.mono_terms import GAUSSIAN, LECLERC, LORENTZIAN, EdgeArrays, FlowArrays, MarkArrays, MaskArrays
from hypose.compute.rows import outline_points
from hypose.errors import EvidenceError, InputError
from hypose.evidence.edges_flow import Flow
from hypose.evidence.frame import Frame, Picture
from hypose.tracking.monocular.points import MonoPoints
from hypose.tracking.monocular.settings import CueSettings, EdgeSettings, FlowSettings

FORMS = {"gaussian": GAUSSIAN, "lorentzian": LORENTZIAN, "leclerc": LECLERC}
SMALLEST_MASK = 50
"""px: a silhouette of fewer pixels shows no person"""
OUTLINE = 130
"""number of points sampled on a silhouette's outline"""


def checked_picture(frame: Frame) -> Picture:
    """Check and return the picture of a frame.

    Raises: InputError where the frame has no picture, or where picture or mask do not have the camera's size;
        EvidenceError where the mask is empty. Both name the frame.
    """
    picture = frame.picture
    if picture is None:
        raise InputError(f"Frame {frame.index} has no picture, which tracking with one camera needs; give its video.")
    (w, h), image, mask = picture.camera.size, picture.image, picture.mask
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            f"Frame {frame.index}: a picture must be (h, w, 3) uint8, got {image.shape} {image.dtype}; convert it to "
            "8-bit BGR."
        )
    if image.shape[:2] != (h, w):
        raise InputError(
            f"Frame {frame.index} is {image.shape[1]} x {image.shape[0]} px, camera {picture.camera.name} {w} x {h}; "
            "resize the picture or use camera.scaled((width, height))."
        )
    if mask is not None:
        if mask.shape != (h, w):
            raise InputError(
                f"Frame {frame.index}: the mask is {mask.shape[1]} x {mask.shape[0]} px, the picture {w} x {h}; resize "
                "the mask."
            )
        if np.count_nonzero(mask) < SMALLEST_MASK:
            raise EvidenceError(
                f"Frame {frame.index}: the mask is empty; leave the mask out of this frame (mask=None)."
            )
    return picture


def grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert a BGR image (h, w, 3) to grey values (h, w)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def edge_arrays(field: NDArray[np.float32], flow: Flow | None, settings: EdgeSettings, *, use: bool) -> EdgeArrays:
    """Build the arrays of the edge term.

    field: (h, w, 2) edges of a picture, from `edge_field`.
    flow: optical flow, whose motion boundaries weight the edges; None: no weighting.
    use: False gives the term weight 0.
    """
    if settings.motion_boundaries and flow is not None:
        share = np.full(field.shape[:2], settings.boundary_floor, np.float32)
        (x, y), (h, w) = flow.corner, flow.boundaries.shape
        share[y : y + h, x : x + w] += np.float32(1 - settings.boundary_floor) * flow.boundaries
        field = share[..., None] * field
    return EdgeArrays(
        field,
        1.0 if use else 0.0,
        FORMS[settings.form],
        float(settings.sigma_px),
        float(settings.sigma_px * settings.coarse_factor),
        float(settings.height),
        float(settings.sample_px),
        int(settings.window_px),
        float(settings.spacing_px),
        float(settings.threshold),
        float(settings.background),
        float(settings.occluded),
    )


def flow_arrays(flow: Flow | None, settings: FlowSettings) -> FlowArrays:
    """Build the arrays of the flow term; without flow the term has no nodes."""
    if flow is None or not settings.use:
        none = np.zeros((0, 0), np.float32)
        flow = Flow(np.zeros((0, 0, 2), np.float32), none, none, (0, 0))
    return FlowArrays(
        flow.flow,
        flow.error,
        np.array(flow.corner, dtype=np.int64),
        FORMS[settings.form],
        float(settings.sigma_px),
        float(settings.height),
        float(settings.area_px),
        float(settings.spacing_px),
        float(settings.consistency_px),
    )


def mask_arrays(mask: NDArray[np.uint8] | None, settings: CueSettings, sample_px: float) -> MaskArrays:
    """Build the arrays of the silhouette term; without a mask, or with height 0, the term is left out.

    mask: (h, w), not 0 on the person.
    sample_px: px of contour per independent sample.
    """
    form, sigma = FORMS[settings.silhouette_form], float(settings.silhouette_sigma_px)
    if mask is None or settings.silhouette_height <= 0:
        empty = np.zeros((0, 0), np.float32)
        return MaskArrays(empty, np.zeros((0, 2), np.float32), 0.0, 0.0, form, sigma, sample_px)
    h, w = mask.shape
    binary = (mask != 0).astype(np.uint8)
    distance = signed_distance(binary[None], np.array([[w, h]]))[0]
    outline, found = outline_points(distance, (w, h), OUTLINE)
    return MaskArrays(
        np.ascontiguousarray(distance),
        outline if found else outline[:0],
        found / OUTLINE,
        float(settings.silhouette_height),
        form,
        sigma,
        sample_px,
    )


def mark_arrays(points: MonoPoints | None, settings: CueSettings) -> MarkArrays:
    """Build the arrays of the term of 2D points; without points, or with weight 0, the term is left out."""
    form = FORMS[settings.point_form]
    if points is None or settings.point_weight <= 0:
        none = np.zeros(0)
        return MarkArrays(np.zeros((0, 2)), none, np.zeros(0, np.int64), np.zeros((0, 3)), none, form)
    seen = np.asarray(points.confidence) > 0
    return MarkArrays(
        np.ascontiguousarray(points.pixels[seen], dtype=np.float64),
        np.ascontiguousarray(points.confidence[seen], dtype=np.float64) * settings.point_weight,
        np.ascontiguousarray(points.joint[seen], dtype=np.int64),
        np.ascontiguousarray(points.offset[seen], dtype=np.float64),
        np.ascontiguousarray(points.scale_px[seen], dtype=np.float64),
        form,
    )
