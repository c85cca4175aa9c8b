"""What a recipe sees of one frame: masks and key points prepared for the hot functions, evidence of the user's own, and
the prediction.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.body.body import Body
from hypose.errors import EvidenceError, InputError
from hypose.evidence.ahead import prepared_masks
from hypose.evidence.depth_surface import DepthTerm, depth_term
from hypose.evidence.frame import Frame
from hypose.evidence.outlines import WORKING_HEIGHT
from hypose.evidence.terms import ContourTerm, Evidence, KeypointTerm, PointTerm, RowTerm, contour_term
from hypose.fitting.articulated import PoseFit
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.keypoint_evidence import KeypointModel, beside_masks, keypoint_model, keypoint_term

_Found = TypeVar("_Found")


class OwnEvidence(Protocol):
    """Evidence that the product does not know: what a sensor, a marker or a rule of yours says of the body.

    Both see the frame, whose index and time tell which measurement belongs to it. All point terms of a frame share one
    scale.
    """

    def rows(self, body: Body, frame: Frame, /) -> PointTerm | RowTerm | None:
        """For the solver: where points of the body are, or any residuals of them; None when the frame says nothing."""
        ...

    def energy(self, body: Body, poses: Array, frame: Frame, /) -> Array:
        """For the search: (N,) cost of poses (N, D), low is good; the silhouettes of one view cost between 0 and 2."""
        ...


class PoseMemory(Generic[_Found]):
    """What somebody has found out about single poses of a body, so that nobody does it again."""

    def __init__(self) -> None:
        # with the bodies, so that no other one gets the identity of a body that is gone
        self._found: dict[tuple[int, bytes], tuple[Body, _Found]] = {}

    def get(self, body: Body, pose: Array) -> _Found | None:
        """What was kept of a pose (D,), or None."""
        known = self._found.get((id(body), pose.tobytes()))
        return None if known is None else known[1]

    def keep(self, body: Body, pose: Array, found: _Found) -> _Found:
        """Keeps what was found, and returns it."""
        self._found[id(body), pose.tobytes()] = body, found
        return found

    def same(self, body: Body, pose: Array, other: Array) -> None:
        """What is kept of a pose (D,) is kept of another, too."""
        known = self.get(body, pose)
        if known is not None:
            self.keep(body, other, known)

    def all(self, body: Body, poses: Array, find: Callable[[Array], NDArray[Any]]) -> NDArray[Any]:
        """What is kept of all the poses (N, D), row by row; `find` finds it for those of which nothing is."""
        found = [self.get(body, pose) for pose in poses]
        new = [n for n, one in enumerate(found) if one is None]
        if len(new) == len(poses):
            rows = find(poses)
            for pose, one in zip(poses, rows, strict=True):
                self.keep(body, pose, one)
            return rows
        if new:
            for n, one in zip(new, find(poses[new]), strict=True):
                found[n] = self.keep(body, poses[n], one)
        return np.array(found)


@dataclass(frozen=True)
class PreparedFrame:
    """One frame ready to be searched for a body. masks and contours are None when no view has a usable silhouette,
    keypoints is None when there are no key points; points, rows: what `own`, the user's evidence, says. prediction
    (D,): the pose expected before looking at the evidence, and prediction_weight: how strongly solves are pulled to
    it (1 / rad^2 in units of the robust rows' cost). usual_iou: how well the body has overlapped the masks so far
    (NaN: not known). depth: what depth cameras
    see. rivals: the hypotheses that the last frame left, each where it is expected now (None: the set
    moves as one). done: frames tracked before this one. memory: what the recipe has remembered so far. counts: of the
    silhouettes of single poses, (C, 3); fits: their solves; shared: whatever else one layer of a
    recipe has found out for the next ones. beside_masks: the key points as solves weigh them beside the contours (None:
    as they are); what chooses between solutions takes them as they are."""

    frame: Frame
    body: Body
    prediction: Array
    masks: compute.PreparedMasks | None
    contours: ContourTerm | None
    keypoints: KeypointTerm | None
    prediction_weight: float = 0.1
    usual_iou: float = float("nan")
    points: PointTerm | None = None
    rows: tuple[RowTerm, ...] = ()
    own: tuple[OwnEvidence, ...] = ()
    done: int = 0
    rivals: Hypotheses | None = None
    memory: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    counts: PoseMemory[NDArray[np.int64]] = field(default_factory=PoseMemory, compare=False, repr=False)
    fits: PoseMemory[PoseFit] = field(default_factory=PoseMemory, compare=False, repr=False)
    shared: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)
    depth: DepthTerm | None = None
    beside_masks: KeypointTerm | None = None

    @property
    def usable(self) -> bool:
        """True when some evidence is left."""
        pieces = (self.masks, self.keypoints, self.points, self.frame.picture, self.depth)
        return any(piece is not None for piece in pieces) or bool(self.rows)

    @property
    def terms(self) -> list[Evidence]:
        """What solves take."""
        keypoints = self.keypoints if self.beside_masks is None else self.beside_masks
        given = (self.contours, keypoints, self.points, self.depth, *self.rows)
        return [one for one in given if one is not None]

    def own_energy(self, poses: Array) -> Array:
        """(N,) what poses (N, D) cost by the user's evidence."""
        total = np.zeros(len(poses))
        for one in self.own:
            total += one.energy(self.body, poses, self.frame)
        return total


def prepare(
    frame: Frame,
    body: Body,
    prediction: Array,
    *,
    use_silhouettes: bool = True,
    use_keypoints: bool = False,
    contour_weight: float = 0.05,
    keypoint_scale_px: float = 8.0,
    keypoints_on_body: KeypointModel | None = None,
    prediction_weight: float = 0.1,
    usual_iou: float = float("nan"),
    own: Sequence[OwnEvidence] = (),
    done: int = 0,
) -> PreparedFrame:
    """Prepares a frame for `body`; see PreparedFrame. Of a frame with the picture of one camera nothing is prepared,
    but what is not wanted is left out. An EvidenceError when the frame has none of the wanted pieces."""
    if frame.picture is not None:
        picture = frame.picture if use_silhouettes else replace(frame.picture, mask=None)
        seen = replace(frame, picture=picture, keypoints=frame.keypoints if use_keypoints else None)
        return PreparedFrame(seen, body, prediction, None, None, None, prediction_weight, usual_iou, done=done)
    silhouettes = frame.silhouettes if use_silhouettes else None
    if silhouettes is None and not (use_keypoints and frame.keypoints is not None):
        raise EvidenceError(
            f"Frame {frame.index} carries no {'silhouettes' if use_silhouettes else 'key points'}; "
            "choose an evidence that the recording has."
        )
    points_seen = frame.keypoints if use_keypoints else None
    model = None
    if points_seen is not None:
        model = keypoints_on_body or keypoint_model(body, points_seen.names)
        if model.names != points_seen.names:
            raise EvidenceError(
                f"Frame {frame.index} has other key points ({len(points_seen.names)}) than the subject was fitted "
                f"with ({len(model.names)}); fit the subject again from this recording."
            )
    masks = contours = None
    if silhouettes is not None:
        masks = prepared_masks(silhouettes)
        # masks that are foreground from border to border have no outline: no evidence either
        with contextlib.suppress(EvidenceError):
            contours = contour_term(silhouettes, weight=contour_weight, working_height=WORKING_HEIGHT)
        if contours is None:
            masks = None
    term = None
    if points_seen is not None:
        term = keypoint_term(points_seen, body, model, prediction, keypoint_scale_px)
    said = [found for one in own if (found := one.rows(body, frame)) is not None]
    points = _joined([one for one in said if isinstance(one, PointTerm)], frame)
    rows = tuple(one for one in said if isinstance(one, RowTerm))
    pieces = (masks, contours, term, prediction_weight, usual_iou, points, rows, tuple(own), done)
    depth = None if frame.depth is None or masks is None else depth_term(frame.depth)
    weaker = None if term is None or model is None or contours is None else beside_masks(term, model)
    return PreparedFrame(frame, body, prediction, *pieces, depth=depth, beside_masks=weaker)


def _joined(terms: Sequence[PointTerm], frame: Frame) -> PointTerm | None:
    """The rows of several pieces of evidence as one term."""
    if len(terms) < 2:
        return terms[0] if terms else None
    scales = {term.scale_m for term in terms}
    if len(scales) > 1:
        raise InputError(
            f"Evidence of your own has rows of {len(scales)} scales in frame {frame.index}; give all the same scale_m, "
            "and weights that say which is surer."
        )
    return PointTerm(
        np.concatenate([term.points_world for term in terms]),
        np.concatenate([term.weight for term in terms]),
        np.concatenate([term.joint for term in terms]),
        np.concatenate([term.offset for term in terms]),
        scales.pop(),
    )


def view_count(prepared: PreparedFrame) -> int:
    """Number of views that carry evidence."""
    seen: NDArray[np.bool_] | None = None
    if prepared.frame.picture is not None:
        return 1
    if prepared.masks is not None:
        seen = prepared.masks.usable
    if prepared.keypoints is not None:
        by_points = np.asarray((prepared.keypoints.points[..., 2] > 0).any(1))
        seen = by_points if seen is None else np.logical_or(seen, by_points)
    return 0 if seen is None else int(seen.sum())
