"""Prepare a frame's evidence once for all layers of a recipe, and compute the costs of poses on it.

The costs are the silhouette XOR (Alcoverro 2014, eq. 2.8), the energies of all other cues, and the overlap with the
masks.

Key points are corrected for a detector's usual errors first (left and right exchanged, another person); a
`KeypointModel` says where they sit on the body.
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
    own_evidence,
    silhouette_evidence,
)
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, Keypoints, Silhouettes
from hypose.evidence.keypoints import landmark_of, triangulate_keypoints
from hypose.evidence.terms import Evidence, KeypointTerm, Limb, Term
from hypose.fitting.articulated import PoseFit
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses

# ---- key points -----------------------------------------------------------------------------------------------------


MIN_CONFIDENCE = 0.3
"""Points of less confidence are left out, as in the solver."""
STRANGER_M = 0.35
"""A view shows another person when its points lie further than this from the expected ones (median)."""
SWAPPED_M = 0.15
"""Left and right are exchanged when the points lie further than this from those expected by their names, and at most
half as far from those of the other side."""
_FAR_M = 0.5
# what a detector exchanges together, the whole limb first, then its outer parts and single joints; the face is another
# matter
_CHAINS = (
    ("shoulder", "elbow", "wrist"),
    ("hip", "knee", "ankle", "big_toe", "small_toe", "heel"),
    ("elbow", "wrist"),
    ("knee", "ankle", "big_toe", "small_toe", "heel"),
    ("ankle", "big_toe", "small_toe", "heel"),
    ("elbow",),
    ("wrist",),
    ("knee",),
    ("ankle",),
)


@dataclass(frozen=True)
class KeypointModel:
    """Places of named key points on a body, and their noise and weights.

    names: (K) names of the points.
    joint: (K,) joint of each point; offset: (K, 3) position in the joint's frame, m; known: (K,) true for points that
        the body has.
    sd: (K,) noise of a detection at the body's distance, per axis, at confidence 1, m; None: not measured.
    view: (C,) factor on the noise of each view (`hypose.tracking.keypoint_offsets`); None: all are alike.
    cue_weight: (C, K) share of each point's weight that is kept in solves with masks (`weigh_against_masks`);
        None: all of it.
    """

    names: tuple[str, ...]
    joint: NDArray[np.int64]
    offset: Array
    known: NDArray[np.bool_]
    sd: Array | None = None
    view: Array | None = None
    cue_weight: Array | None = None

    def positions(self, body: Body, poses: Array) -> Array:
        """Compute the world positions (..., K, 3) of the points, m, at poses (..., D)."""
        return body.skeleton.points(self.joint, self.offset, poses)

    def worse(self, views: int) -> Array:
        """Return the factors (C,) >= 1 by which the noise of each view is larger than usual; 1 where they are
        unknown, or were measured for another number of views.
        """
        return self.view if self.view is not None and len(self.view) == views else np.ones(views)


def keypoint_model(body: Body, names: tuple[str, ...]) -> KeypointModel:
    """Place key points on a body by the names of its joints and landmarks."""
    joint, offset, known = landmark_of(names, body)
    return KeypointModel(tuple(names), joint, offset, known)


def keypoint_term(
    keypoints: Keypoints,
    body: Body,
    model: KeypointModel | None = None,
    prediction: Array | None = None,
    scale_px: float = 8.0,
) -> KeypointTerm | None:
    """Build the solver's term of the key points of one frame; None when none of them is known and confident.

    keypoints: key points of one frame, in undistorted px.
    model: where the points sit (default: at the body's landmarks).
    prediction: (D,) expected pose. With it, views that show another person are left out, exchanged sides are corrected
        (`check_sides_and_views`), and the model's noise in metres becomes pixels; without it the points are used
        unchanged.
    scale_px: noise in pixels where the model's noise is not measured.
    """
    model = model or keypoint_model(body, keypoints.names)
    known = model.known
    points = np.nan_to_num(keypoints.points)
    points[~(points[..., 2] > MIN_CONFIDENCE)] = 0.0
    if prediction is not None:
        expected = model.positions(body, prediction)
        size = pixels_per_metre(keypoints, prediction[:3])
        uv = np.stack([camera.project_pinhole(expected) for camera in keypoints.rig])
        points = check_sides_and_views(points, uv, model.names, size, known)
        points[..., 2] /= model.worse(len(size))[:, None] ** 2
        if model.sd is not None:
            sd_px = model.sd * size[:, None]
            scale_px = float(np.median(sd_px[:, known]))
            points[..., 2] *= (scale_px / sd_px) ** 2
    points = points[:, known]
    if not (points[..., 2] > 0).any():
        return None
    return KeypointTerm(
        np.ascontiguousarray(points),
        keypoints.rig.projections,
        model.joint[known],
        model.offset[known],
        scale_px,
        min_confidence=0.0,
    )


def with_masks(term: KeypointTerm, model: KeypointModel) -> KeypointTerm:
    """Reweight the solver term of a frame's key points, for solves that use masks as well, by the cue_weight of the
    model.
    """
    if model.cue_weight is None or len(model.cue_weight) != len(term.points):
        return term
    points = term.points.copy()
    points[..., 2] *= model.cue_weight[:, model.known]
    return term._replace(points=points)


def shows_another_person(keypoints: Keypoints, body: Body, model: KeypointModel, expected: Array, reach: float) -> bool:
    """Decide whether the detected person is another one: further from the expected pose than a person can move.

    keypoints: key points of one frame; model: where they sit on the body.
    expected: (D,) expected pose; reach: largest distance that the person can have moved, m. It is decided by the
        median distance of the triangulated points or, with fewer than four, by the view with the largest median.
        False where nothing is seen, and where two views agree with the expectation (`check_sides_and_views` then
        handles the others).
    """
    points, expected_points = np.nan_to_num(keypoints.points), model.positions(body, expected)
    uv = np.stack([camera.project_pinhole(expected_points) for camera in keypoints.rig])
    seen = (points[..., 2] > MIN_CONFIDENCE) & model.known & np.isfinite(uv).all(-1)
    size = pixels_per_metre(keypoints, expected[:3])
    distance = np.linalg.norm(points[..., :2] - uv, axis=-1) / size[:, None]
    middle = [float(np.median(d[s])) for d, s in zip(distance, seen, strict=True) if s.sum() >= 4]
    if sum(m <= STRANGER_M for m in middle) >= 2:
        return False
    away = np.linalg.norm(triangulate_keypoints([keypoints])[0][0] - expected_points, axis=-1)[model.known]
    if np.isfinite(away).sum() >= 4:
        return float(np.nanmedian(away)) > reach
    return max(middle, default=0.0) > reach


def pixels_per_metre(keypoints: Keypoints, position_world: Array) -> Array:
    """Compute the size of a metre, px, in every view (C,) at a world position (3,); at least 1.

    keypoints: key points, of which the cameras are used; position_world: (3,) m.
    """
    sizes = []
    for camera in keypoints.rig:
        depth = camera.camera_from_world[2, :3] @ position_world + camera.camera_from_world[2, 3]
        sizes.append(float(camera.K[0, 0]) / max(float(depth), 0.1))
    return np.maximum(np.array(sizes), 1.0)


def check_sides_and_views(
    points: Array,
    expected: Array,
    names: tuple[str, ...],
    size: Array,
    known: NDArray[np.bool_] | None = None,
) -> Array:
    """Correct key points of a frame: leave out views of another person (confidence 0), and exchange confused sides
    back.

    names: names of the K points.
    points: (C, K, 3).
    expected: (C, K, 2) expected places, px.
    size: (C,) pixels per metre.
    known: (K,) true for points that the body has.
    Returns: (C, K, 3) corrected points.
    A view is left out only where two others agree with the expectation; without them the expectation may be wrong.
    """
    out = points.copy()
    seen = (out[..., 2] > 0) & np.isfinite(expected).all(-1)
    if known is not None:
        seen &= known
    distance = np.where(seen, np.linalg.norm(out[..., :2] - expected, axis=-1) / size[:, None], np.nan)
    middle = np.array([np.median(d[s]) if s.sum() >= 4 else np.nan for d, s in zip(distance, seen, strict=True)])
    strangers = middle > STRANGER_M
    if (middle <= STRANGER_M).sum() >= 2:
        out[strangers, :, 2] = 0.0
    far = np.nan_to_num(distance) > SWAPPED_M
    far[strangers] = False
    for chain in _CHAINS:
        pairs = sides_of(names, chain)
        own, other = pairs.ravel(), pairs[:, ::-1].ravel()
        if far[:, own].any():  # the mean is only large where one of them is
            as_named, turned = side_distances(out, expected, size, pairs)
            exchanged = far[:, own].any(1) & (as_named > SWAPPED_M) & (turned < 0.5 * as_named)
            out[np.ix_(exchanged, own)] = out[np.ix_(exchanged, other)]
    return out


def side_distances(points: Array, expected: Array, size: Array, pairs: NDArray[np.int64]) -> tuple[Array, Array]:
    """Compute the mean distances (C,), m, of the points of some pairs from where they are expected by their names, and
    from where the points of the other side are expected.

    points: (C, K, 3), those of confidence 0 do not count; expected: (C, K, 2) px; size: (C,) pixels per metre.
    pairs: (N, 2) columns of left and right points.
    Returns: distances, at most _FAR_M for each point; NaN where there are no points.
    """
    own, found = pairs.ravel(), []
    for there in (own, pairs[:, ::-1].ravel()):
        away = np.linalg.norm(points[:, own, :2] - expected[:, there], axis=-1) / size[:, None]
        known = (points[:, own, 2] > 0) & np.isfinite(away)
        with np.errstate(invalid="ignore"):
            found.append(np.where(known, np.minimum(away, _FAR_M), 0.0).sum(1) / known.sum(1))
    return found[0], found[1]


def sides_of(names: Sequence[str], parts: Sequence[str], known: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """List the columns (N, 2) of the left and right point of each part that the names have on both sides.

    names: names of the points; parts: names without the side; known: (K,) False for points that do not count.
    """
    column = {n: k for k, n in enumerate(names) if known is None or known[k]}
    both = [(column.get(f"left_{p}", -1), column.get(f"right_{p}", -1)) for p in parts]
    return np.array([b for b in both if min(b) >= 0], dtype=np.int64).reshape(-1, 2)


# ---- prepared frames ------------------------------------------------------------------------------------------------


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
            weaker = with_masks(term, model) if masks else term
            found.append(KeypointEvidence(np.any(term.points[..., 2] > 0, axis=1), (weaker,), term))
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


def mean_overlap(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Compute the mean IoU of a pose with the masks over the views where it is known; 0 where it is known in no
    view.
    """
    return float(np.nan_to_num(_mean_of_known(frame.silhouettes.overlap(body, pose))))


def _mean_of_known(overlap: Array) -> float:
    """Compute the mean of the numbers (C,) that are known; NaN where none is. It is np.nanmean, but faster."""
    count = int(np.isfinite(overlap).sum())
    return float(np.nan_to_num(overlap).sum()) / count if count else float("nan")


def agreement(body: Body, pose: Array, frame: PreparedFrame) -> float:
    """Compute how well a pose (D,) agrees with masks and depth.

    Returns: mean IoU over the views minus half of the mean depth energy; NaN where no view is usable.
    Why: a person who stands back to front has nearly the same outline, but other depths.
    """
    mean, depth = _mean_of_known(frame.silhouettes.overlap(body, pose)), frame.depth
    return mean - 0.5 * float(depth.energy(body, pose[None])[0]) / max(int(depth.views.sum()), 1)
