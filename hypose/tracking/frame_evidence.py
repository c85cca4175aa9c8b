"""Prepare a frame's evidence once for all layers of a recipe, together with the prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.errors import EvidenceError
from hypose.evidence.cues import (
    NO_DEPTH,
    NO_KEYPOINTS,
    NO_SILHOUETTES,
    DepthEvidence,
    KeypointEvidence,
    OwnEvidence,
    PoseMemory,
    SilhouetteEvidence,
    depth_evidence,
    keypoint_evidence,
    own_evidence,
    silhouette_evidence,
)
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.terms import Evidence, Term
from hypose.fitting.articulated import PoseFit
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.keypoint_evidence import KeypointModel, keypoint_model, keypoint_term, with_masks

_Cue = TypeVar("_Cue", bound=Evidence)


@dataclass(frozen=True)
class PreparedFrame:
    """One frame, prepared for the search of a body.

    evidence: its cues, each prepared once.
    prediction: (D,) pose predicted without the frame's evidence; prediction_weight: pull of solves to it, 1 / rad^2 in
        units of the robust rows' cost.
    usual_iou: usual overlap of the body with the masks so far; NaN: unknown.
    done: number of frames tracked before.
    rivals: hypotheses of the last frame, each predicted into this one; None: the set moves as one.
    memory: what the recipe has remembered so far.
    fits: solves of single poses; shared: other results that a layer leaves for the next ones.
    """

    frame: Frame
    body: Body
    prediction: Array
    evidence: tuple[Evidence, ...] = ()
    prediction_weight: float = 0.1
    usual_iou: float = float("nan")
    done: int = 0
    rivals: Hypotheses | None = None
    memory: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    fits: PoseMemory[PoseFit] = field(default_factory=PoseMemory, compare=False, repr=False)
    shared: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)

    @property
    def usable(self) -> bool:
        """Whether some evidence is left."""
        return bool(self.terms) or self.frame.picture is not None

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Terms of all cues for solves."""
        return tuple(term for one in self.evidence for term in one.terms)

    @cached_property
    def silhouettes(self) -> SilhouetteEvidence:
        """Evidence of the masks; empty where no view has a usable one."""
        return self._of(NO_SILHOUETTES)

    @cached_property
    def keypoints(self) -> KeypointEvidence:
        """Evidence of the key points; empty where there are none."""
        return self._of(NO_KEYPOINTS)

    @cached_property
    def depth(self) -> DepthEvidence:
        """Evidence of depth cameras; empty where none shows the person."""
        return self._of(NO_DEPTH)

    def _of(self, nothing: _Cue) -> _Cue:
        return next((one for one in self.evidence if isinstance(one, type(nothing))), nothing)

    @property
    def kind(self) -> str:
        """Kind of evidence: silhouettes, keypoints, both, or depth."""
        masks, points = self.silhouettes.seen, self.keypoints.seen
        return "depth" if self.depth.seen else "both" if masks and points else "silhouettes" if masks else "keypoints"

    def without(self, kind: type[Evidence]) -> PreparedFrame:
        """Copy the frame without one kind of evidence, and without the solves on it."""
        left = tuple(one for one in self.evidence if not isinstance(one, kind))
        return replace(self, evidence=left, fits=PoseMemory())


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
    """Prepare a frame's evidence for the search of `body`.

    prediction: (D,) predicted pose.
    use_silhouettes, use_keypoints: cues that are wanted; depth and further cues are used where they exist.
    contour_weight: of a contour row; keypoint_scale_px: noise of key points where it is not measured.
    keypoints_on_body: where key points sit on the body (default: at its landmarks).
    own: evidence of the user's own.
    prediction_weight, usual_iou, done: see PreparedFrame.
    Raises: EvidenceError where the frame has none of the wanted cues, or its key points are not those of the subject.
    A frame with the picture of one camera is not prepared; only unwanted cues are left out.
    """
    if frame.picture is not None:
        picture = frame.picture if use_silhouettes else replace(frame.picture, mask=None)
        seen = replace(frame, picture=picture, keypoints=frame.keypoints if use_keypoints else None)
        return PreparedFrame(seen, body, prediction, (), prediction_weight, usual_iou, done)
    silhouettes = frame.of(Silhouettes) if use_silhouettes else []
    keypoints = frame.of(Keypoints) if use_keypoints else []
    if not (silhouettes or keypoints):
        raise EvidenceError(
            f"Frame {frame.index} carries no {'silhouettes' if use_silhouettes else 'key points'}; "
            "choose an evidence that the recording has."
        )
    found = [one for seen in silhouettes for one in silhouette_evidence(seen, contour_weight)]
    masks = bool(found)
    for points in keypoints:
        model = keypoints_on_body or keypoint_model(body, points.names)
        if model.names != points.names:
            raise EvidenceError(
                f"Frame {frame.index} has other key points ({len(points.names)}) than the subject was fitted "
                f"with ({len(model.names)}); fit the subject again from this recording."
            )
        term = keypoint_term(points, body, model, prediction, keypoint_scale_px)
        if term is not None:
            found.append(keypoint_evidence(term, with_masks(term, model) if masks else term))
    found += [one for depth in (frame.of(Depth) if masks else ()) for one in depth_evidence(depth)]
    found += [piece.prepared(body) for piece in frame.more]
    found += own_evidence(own, body, frame)
    return PreparedFrame(frame, body, prediction, tuple(found), prediction_weight, usual_iou, done)


def view_count(prepared: PreparedFrame) -> int:
    """Count the views of a prepared frame that carry evidence."""
    if prepared.frame.picture is not None:
        return 1
    pictures = [one.views for one in (prepared.silhouettes, prepared.keypoints) if one.seen]
    return int(np.any(pictures, axis=0).sum()) if pictures else 0
