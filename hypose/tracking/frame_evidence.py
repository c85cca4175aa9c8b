"""Prepare a frame's evidence once for all layers of a recipe, and compute the costs of poses on it.

The costs are the silhouette XOR (Alcoverro 2014, eq. 2.8), the energies of all other cues, and the overlap with the
masks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute.arrays import Standing
from hypose.compute.depth_costs import StandingDepth
from hypose.compute.scorer import limb_energies
from hypose.errors import EvidenceError
from hypose.evidence.cues import (
    MEASURED,
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
from hypose.evidence.terms import Evidence, Limb, Term
from hypose.fitting.articulated import PoseFit
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.tracking.keypoint_evidence import KeypointModel, keypoint_model, keypoint_term, with_masks

_Cue = TypeVar("_Cue", bound=Evidence)


@dataclass(frozen=True)
class PreparedFrame:
    """One frame, prepared for the search of a body.

    frame: the frame as it was read.
    body: body that is searched.
    evidence: cues of the frame, each prepared once.
    prediction: (D,) pose predicted without the frame's evidence; prediction_weight: pull of solves to it, 1 / rad^2 in
        units of the robust rows' cost.
    usual_iou: usual overlap of the body with the masks so far; NaN: unknown.
    done: number of frames tracked before.
    rivals: hypotheses of the last frame, each predicted into this frame by its own motion; None: all hypotheses move
        by the same prediction.
    memory: what the recipe has remembered so far.
    fits: results of solves, by pose; shared: other results that one layer stores for later layers.
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
    contour_weight: weight of one residual of a contour.
    keypoint_scale_px: noise of key points where it is not measured, px.
    keypoints_on_body: where key points sit on the body (default: at its landmarks).
    own: additional evidence that a user defined.
    prediction_weight, usual_iou, done: pull to the prediction, usual overlap with the masks, number of frames
        tracked before, as in PreparedFrame.
    Raises: EvidenceError where the frame has none of the wanted cues, or its key points are not those of the
        subject.
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


@dataclass(frozen=True)
class SilhouetteXor:
    """Energy of hypotheses on silhouettes: E = sum over usable views of XOR(M_v, S_v) / C(S_v), so that the weight is
    exp(-E).

    M_v: silhouette of the posed coarse mesh in view v; S_v: the mask; C: its number of foreground pixels (those
        expected of the whole person where others hide a part; ignored pixels count nowhere).
    All hypotheses have the energy 0 where no view is usable. The energies of depth and of evidence that a user added
    are added to E.
    Source: Alcoverro 2014, eq. 2.8.
    """

    def __call__(self, h: Hypotheses, frame: PreparedFrame, /) -> Array:
        """Compute the energies (N,) of h.values (N, D)."""
        return frame_energy(h.values, frame)


def frame_energy(
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_] | None = None,
    rest: Standing | None = None,
) -> Array:
    """Compute the energies (N,) of poses (N, D) of the frame's body on all its evidence.

    The evidence is silhouettes (eq. 2.8), depth, and evidence that a user added.
    moving: (J,) true for the joints that differ between the poses; all others are as in the last pose and drawn
        once.
    rest: the parts that do not move, where they are drawn already.
    """
    limb = None if moving is None else Limb(moving, rest)
    return evidence_energy(frame.body, poses, frame.evidence, limb)


def evidence_energy(body: Body, poses: Array, evidence: Iterable[Evidence], limb: Limb | None = None) -> Array:
    """Compute the sum (N,) of the energies of poses (N, D) of a body over all evidence given.

    limb: all that differs between the poses; None: anything may.
    """
    total = np.zeros(len(poses))
    for one in evidence:
        total += one.energy(body, poses, limb)
    return total


def limb_energy(
    poses: Array,
    frame: PreparedFrame,
    moving: NDArray[np.bool_],
    rest: Standing | None = None,
    slack: float = 1.0,
    rest_depth: StandingDepth | None = None,
) -> Array:
    """Compute the energies (N,) of poses that differ in one limb, on all evidence of a frame; exact only for poses
    whose energy is near that of the first one.

    frame: prepared frame.
    poses: (N, D) pose vectors, rad and m; moving: (J,) true for the joints that differ; rest: drawing of the parts that
        do not move; None:
        it is made.
    slack: poses that cost more than this many times the first pose may get an infinite energy.
    rest_depth: the parts that do not move, as depth cameras see them.
    """
    body, silhouettes, depth = frame.body, frame.silhouettes, frame.depth
    if not silhouettes.seen or (depth.seen and len(poses) <= MEASURED):
        return frame_energy(poses, frame, moving, rest)
    others = [one for one in frame.evidence if one is not silhouettes and one is not depth]
    other = evidence_energy(body, poses, others, Limb(moving, rest))
    given = poses, body.skeleton.tree, body.coarse.arrays, silhouettes.masks, moving, rest

    def outlines(slack: float, more: float = 0.0) -> Array:
        return limb_energies(*given, slack, more + slack * float(other[0]) - float(other.min())) + other

    return depth.limb_energy(body, poses, moving, outlines, rest_depth) if depth.seen else outlines(slack)


_IN_LANES = 8
"""numpy adds this many numbers, or more, in another order."""


def mean_overlap(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Compute the mean IoU of a pose with the masks over the views where it is known; 0 where it is known in no
    view.
    """
    return _mean_of_known(frame.silhouettes.overlap(body, pose), 0.0)


def _mean_of_known(overlap: Array, otherwise: float) -> float:
    """Compute np.nanmean with the same bits, but faster for a few numbers.

    overlap: (C,) NaN where unknown; otherwise: the result where none is known.
    """
    if len(overlap) >= _IN_LANES:
        return float(np.nanmean(overlap)) if np.isfinite(overlap).any() else otherwise
    total, count = 0.0, 0
    for one in overlap.tolist():
        if one == one:  # a number
            total, count = total + one, count + 1
    return total / count if count else otherwise


def agreement(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Compute how well a pose (D,) agrees with masks and depth.

    Returns: mean IoU over the views minus half of the mean depth energy; NaN where no view is usable.
    Why: a person who stands back to front has nearly the same outline, but other depths.
    """
    mean, depth = _mean_of_known(frame.silhouettes.overlap(body, pose), float("nan")), frame.depth
    return mean - 0.5 * float(depth.energy(body, pose[None])[0]) / max(int(depth.views.sum()), 1)
