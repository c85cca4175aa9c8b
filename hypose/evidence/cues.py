"""Cues of a frame for a search: silhouettes, depth, key points, and evidence of the user's own.

Each cue is prepared once and caches its results for single poses. A frame has a tuple of them; NO_SILHOUETTES, NO_DEPTH
and NO_KEYPOINTS stand for missing ones and have energy 0.
Source: silhouettes as in Alcoverro 2014, eq. 2.8; the depth cost is hypose's own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute import arrays
from hypose.compute.arrays import MeshArrays, PreparedMasks, TreeArrays
from hypose.compute.depth_costs import (
    SeenDepth,
    StandingDepth,
    depth_energy,
    limb_depth_energy,
    limb_shown,
    standing_depth,
)
from hypose.compute.scorer import silhouette_xor
from hypose.errors import EvidenceError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.frame import Frame, Silhouettes
from hypose.evidence.outlines import WORKING_HEIGHT
from hypose.evidence.terms import (
    Evidence,
    KeypointTerm,
    Limb,
    PointTerm,
    RowTerm,
    Term,
    contour_term,
    depth_term,
    shrunk,
)
from hypose.geometry import Array

_Found = TypeVar("_Found")
VISIBLE = 0.2
"""Least share of a body that must be visible in a view for its overlap to be computed."""
SHARE = 1.0
"""Cost of a pixel at the wrong depth relative to one outside the mask. Chosen on the seeds 0 to 9 (benchmark
`depth`)."""
MOST_M = 0.15
"""m: depth differences are cut off here"""
TALL = 60
"""px: least height of a person in the depth maps that are compared"""
MEASURED, HOPEFUL = 16, 1.1
"""largest number of a limb's poses that are compared in full, and largest cost relative to the current limb in a rough
comparison. Chosen on the seeds 0 to 15, and 0 to 29 (benchmark `depth`)."""
ARM_M2, ARM_REACH_M, EXPLAINED_M = 0.055, 0.75, 0.08
"""m^2 of an arm seen from its side; m of its reach from the shoulder; m between drawn and seen surface"""
LEAST_SHOWN, AGREED, NEARBY = 0.7, 0.8, 0.4
"""Shares of an arm: visible; of the visible part, at the right depth; seen in its reach without belonging to the body.
An arm that is visible to this degree is not searched elsewhere. Chosen on the seeds 0 to 15 (benchmark `depth`)."""
_REMEMBERED_POSES, _DIGITS = 12, 12
"""results are cached for sets of at most this many poses, because the same pose is judged several times in a frame"""


class PoseMemory(Generic[_Found]):
    """Cache of results that were computed for single poses of a body."""

    def __init__(self) -> None:
        self._found: dict[tuple[Body, bytes], _Found] = {}

    @staticmethod
    def _key(body: Body, pose: Array) -> tuple[Body, bytes]:
        """Build the key of a pose (D,); poses that differ by rounding errors, as after clamping, have one key."""
        return body, (pose.round(_DIGITS) + 0.0).tobytes()  # + 0.0: no negative zeros

    def get(self, body: Body, pose: Array) -> _Found | None:
        """Look up the result of a pose (D,); None where there is none."""
        return self._found.get(self._key(body, pose))

    def keep(self, body: Body, pose: Array, found: _Found) -> _Found:
        """Store the result of a pose and return it.

        pose: (D,) pose vector, rad and m.
        found: its result.
        """
        self._found[self._key(body, pose)] = found
        return found

    def all(self, body: Body, poses: Array, find: Callable[[Array], NDArray[Any]]) -> NDArray[Any]:
        """Look up or compute the results of the poses (N, D), row by row.

        find: function that computes the missing ones; for many poses it computes all, without the cache.
        """
        if not 0 < len(poses) <= _REMEMBERED_POSES:
            return find(poses)
        found = [self.get(body, pose) for pose in poses]
        new = [n for n, one in enumerate(found) if one is None]
        if new:
            for n, one in zip(new, find(poses[new]), strict=True):
                found[n] = self.keep(body, poses[n], one)
        return np.array(found)


@dataclass(frozen=True)
class SilhouetteEvidence(Evidence):
    """Silhouettes of a frame for searches and solves.

    masks: masks of the frame, prepared for the search.
    """

    masks: PreparedMasks
    _counts: PoseMemory[NDArray[np.int64]] = field(default_factory=PoseMemory, compare=False, repr=False)
    _overlaps: PoseMemory[Array] = field(default_factory=PoseMemory, compare=False, repr=False)

    def energy(self, body: Body, poses: Array, limb: Limb | None = None) -> Array:
        """Compute the silhouette energies (N,) of poses (N, D), eq. 2.8; limb: the only part of the body that
        differs between the poses; None: any part may differ.
        """
        use = self.masks.usable
        return (self.counts(body, poses, limb)[:, use, 0] / self.masks.norm[use]).sum(1)

    def counts(self, body: Body, poses: Array, limb: Limb | None = None) -> NDArray[np.int64]:
        """Count the pixels of poses (N, D) against the masks of the views.

        limb: the only part of the body that differs between the poses; None: any part may differ.
        Returns: (N, C, 3) pixels of XOR, of the drawn body, and of the intersection.
        """
        if not len(self.masks.usable):
            return np.zeros((len(poses), 0, 3), np.int64)
        given = body.skeleton.tree, body.coarse.arrays, self.masks

        def count(of: Array) -> NDArray[np.int64]:
            flat = np.ascontiguousarray(of, dtype=np.float64)
            moving, rest = (None, None) if limb is None else limb[:2]
            return silhouette_xor(flat, *given, moving=moving, rest=rest)

        return count(poses) if limb is not None else self._counts.all(body, poses, count)

    def overlap(self, body: Body, pose: Array) -> Array:
        """Compute the intersection over union (C,) of the body at a pose (D,) and each view's mask; ignored pixels do
        not count.

        Returns: (C,) overlap; NaN for views without a usable mask, or in which others hide nearly all of the body.
        """
        known = self._overlaps.get(body, pose)
        if known is not None:
            return known
        counts, use = self.counts(body, pose[None])[0], self.masks.usable
        union = counts[:, 0] + counts[:, 2]  # XOR and intersection are disjoint
        with np.errstate(invalid="ignore", divide="ignore"):
            if self.masks.hidden.size:
                use = use & (counts[:, 1] > VISIBLE * self.masks.norm)
            return self._overlaps.keep(body, pose, np.where(use, counts[:, 2] / union, np.nan))


@dataclass(frozen=True)
class KeypointEvidence(Evidence):
    """Key points of a frame, prepared for solves; a search does not use them.

    term: the key points with their full weight, for comparing solutions; solves may use smaller weights.
    """

    term: KeypointTerm

    def cost(self, body: Body, poses: Array) -> Array:
        """Compute the robust cost (N,) of the key points at poses (N, D), as the solver does; a cost difference of 1
        is a difference of 1 in log-likelihood.
        """
        term = self.term
        x = body.skeleton.points(term.joint, term.offset, poses)
        h = np.einsum("cij,nkj->ncki", term.projections[:, :, :3], x) + term.projections[:, None, :, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            away = np.linalg.norm(h[..., :2] / h[..., 2:] - term.points[..., :2], axis=-1)
        away = np.where(h[..., 2] > 0, np.nan_to_num(away, nan=np.inf), np.inf)
        ratio = np.minimum(away / (2 * term.scale_px), 1e3)  # a point behind a camera has the largest distance
        used = np.where(term.points[..., 2] > term.min_confidence, term.points[..., 2], 0.0)
        return 2 * (used * np.log1p(ratio**2)).sum((1, 2))


@dataclass(frozen=True)
class DepthEvidence(Evidence):
    """Depth of a frame for searches and solves.

    maps: depth maps of the sensors that see the person, prepared for the search.
    """

    maps: SeenDepth
    _costs: PoseMemory[float] = field(default_factory=PoseMemory, compare=False, repr=False)

    def _about(self, body: Body) -> tuple[TreeArrays, MeshArrays, SeenDepth, float]:
        return body.skeleton.tree, body.coarse.arrays, self.maps, MOST_M

    def energy(self, body: Body, poses: Array, limb: Limb | None = None) -> Array:
        """Compute the depth energies (N,) of poses (N, D): mean depth difference over the person's pixels that the body
        covers.

        limb: not used; the whole body is compared.
        It is the sum over the sensors. Pixels that the body does not cover are counted by the silhouettes.
        """
        if not self.seen:
            return np.zeros(len(poses))

        def measured(of: Array) -> Array:
            return np.asarray(SHARE * depth_energy(of, *self._about(body)).sum(1))

        return self._costs.all(body, poses, measured)

    def limb_energy(
        self,
        body: Body,
        poses: Array,
        moving: NDArray[np.bool_],
        outlines: Callable[[float, float], Array],
        standing: StandingDepth | None = None,
    ) -> Array:
        """Compute the energies (N,) of poses (N, D) that differ in one limb, in full only for the most promising
        ones.

        moving: (J,) the joints that differ; all else is as in the last pose. The first pose is the current limb.
        outlines: function (slack, more) that gives the energies (N,) without depth; they may be infinite where they are
            certainly above `slack` times that of the first pose plus `more`.
        standing: the parts that do not move, where they are drawn already.
        Returns: (N,) energies; infinite for poses that were not compared in full, because only the best ones of a
            rough comparison are.
        """
        seen = self.maps
        standing = standing or self.standing(body, poses[-1], moving)

        def limb(chosen: NDArray[np.intp], rough: bool = False) -> Array:
            return SHARE * limb_depth_energy(poses[chosen], *self._about(body), standing, rough).sum(1)

        out = np.full(len(poses), np.inf)
        here = limb(np.zeros(1, np.intp))
        alone = SHARE * float((standing.cost / np.maximum(seen.counts, 1)).sum())
        before = outlines(HOPEFUL, HOPEFUL * float(here[0]) - alone)
        out[:1] = before[:1] + here
        most = HOPEFUL * out[0]
        chosen = 1 + np.flatnonzero(before[1:] + alone <= most)
        rough = before[chosen] + limb(chosen, rough=True)
        chosen = chosen[np.argsort(rough, kind="stable")[: min(MEASURED - 1, int((rough <= most).sum()))]]
        out[chosen] = before[chosen] + limb(chosen)
        return out

    def standing(self, body: Body, pose: Array, moving: NDArray[np.bool_]) -> StandingDepth:
        """Draw a body at a pose (D,) into depth maps, without the parts that the joints `moving` (J,) move."""
        return standing_depth(pose, *self._about(body), moving)

    def shows_arm(self, body: Body, standing: StandingDepth, shoulder: int) -> bool:
        """Decide whether depth cameras show an arm at its place in a pose, and nothing unexplained in its reach.

        standing: the rest of the body, drawn.
        shoulder: joint of the arm.
        """
        at = standing.pose[:3] + standing.centres[shoulder]
        in_sight, agreed, nearby = limb_shown(*self._about(body)[:3], standing, at, ARM_REACH_M, EXPLAINED_M).T
        shown = (in_sight >= LEAST_SHOWN * ARM_M2) & (agreed >= AGREED * in_sight)
        return bool(shown.any() and (nearby <= NEARBY * ARM_M2).all())


def seen_depth(depth: Depth, tall: int = TALL) -> tuple[NDArray[np.bool_], SeenDepth]:
    """Reduce depth maps to the pixels of the person, cut to the person's box, and shrink them so far that the person
    is still `tall` px tall.

    Returns: (C,) sensors that see the person; the reduced maps.
    """
    views = np.array([bool(u) and box[2] > 0 for u, box in zip(depth.usable, depth.boxes, strict=True)])
    used = np.flatnonzero(views)
    boxes = np.array(depth.boxes, dtype=np.int64)[used]
    step = max(1, min((boxes[:, 3] - boxes[:, 1]).tolist(), default=0) // tall)
    every = [(slice(y0, y1, step), slice(x0, x1, step)) for x0, y0, x1, y1 in boxes.tolist()]
    maps = [np.where(depth.person[c][at] > 0, depth.maps[c][at], 0.0) for c, at in zip(used, every, strict=True)]
    projections = depth.rig.projections[used]
    projections[:, :2] -= boxes[:, :2, None] * projections[:, 2:]
    h, w = (max((m.shape[k] for m in maps), default=1) for k in (0, 1))
    out = np.zeros((len(maps), h, w), np.float32)
    for k, m in enumerate(maps):
        out[k, : m.shape[0], : m.shape[1]] = m
    sizes = np.array([m.shape[::-1] for m in maps], dtype=np.int64).reshape(len(maps), 2)
    counts = np.count_nonzero(out > 0, axis=(1, 2)).astype(np.int64)
    return views, SeenDepth(out, sizes, shrunk(projections, step), counts)


def silhouette_evidence(silhouettes: Silhouettes, weight: float) -> list[Evidence]:
    """Prepare the masks of a frame for tracking.

    Returns: list of one Evidence; an empty list where no view has an outline.
     weight: weight of a contour row.
    """
    masks = silhouettes.prepared
    try:
        contours = contour_term(silhouettes, weight=weight, working_height=WORKING_HEIGHT)
    except EvidenceError:  # masks that are foreground from border to border have no outline: no evidence either
        return []
    return [SilhouetteEvidence(masks.usable, (contours,), masks)]


def depth_evidence(depth: Depth) -> list[Evidence]:
    """Prepare depth maps for tracking.

    Returns: list of one Evidence; an empty list where no map shows the person.
    """
    term = depth_term(depth)
    if term is None:
        return []
    views, maps = seen_depth(depth)
    return [DepthEvidence(views, (term,), maps)]


def surface_evidence(frame: Frame) -> list[Term]:
    """Build the solver terms of a frame that concern the body's surface, for fits of its shape: outlines, and depth
    where there is any.
    """
    outlines: list[Term] = [contour_term(masks) for masks in frame.of(Silhouettes)]
    return outlines + [term for depth in frame.of(Depth) for one in depth_evidence(depth) for term in one.terms]


class OwnEvidence(Protocol):
    """Interface of evidence that a user adds to the product, for example a sensor, a marker or a rule.

    Both methods get the frame, whose index and time identify the measurement. Threads may call them at the same
    time.
    """

    def rows(self, body: Body, frame: Frame, /) -> PointTerm | RowTerm | None:
        """Return the measurement of a frame for the solver: positions of body points (PointTerm), or residuals of
        body points (RowTerm); None where the frame has no measurement.
        """
        ...

    def energy(self, body: Body, poses: Array, frame: Frame, /) -> Array:
        """Compute the costs (N,) of poses (N, D) for the search, low is good; the silhouettes of one view cost
        between 0 and 2.
        """
        ...


@dataclass(frozen=True)
class OwnCue(Evidence):
    """The user's own evidence in one frame."""

    source: OwnEvidence
    frame: Frame

    def energy(self, body: Body, poses: Array, limb: Limb | None = None) -> Array:
        """Compute the energies (N,) of poses (N, D) by the user's function."""
        return np.asarray(self.source.energy(body, poses, self.frame))


def own_evidence(sources: Sequence[OwnEvidence], body: Body, frame: Frame) -> list[Evidence]:
    """Prepare the user's own sources of evidence in a frame, for a body.

    sources: user's objects; `rows` of each is called once.
    Returns: one Evidence per source, which has no terms where the source has no rows in this frame.
    """
    rows = [one.rows(body, frame) for one in sources]
    terms = [() if term is None else (term,) for term in rows]
    return [OwnCue(_NO_VIEWS, own, one, frame) for one, own in zip(sources, terms, strict=True)]


_NO_VIEWS, _NO_MASK, _NO_COUNT = np.zeros(0, np.bool_), np.zeros((0, 1, 1), np.uint8), np.zeros(0, np.int64)
_NO_SIZES, _NO_CAMERAS = np.zeros((0, 2), np.int64), np.zeros((0, 3, 4))
_NO_MASKS = (_NO_MASK, _NO_COUNT, _NO_VIEWS, _NO_SIZES, _NO_CAMERAS, _NO_MASK, np.zeros(0), _NO_MASK[:, :0])
_NO_MAPS = SeenDepth(np.zeros((0, 1, 1), np.float32), _NO_SIZES, _NO_CAMERAS, _NO_COUNT)
NO_SILHOUETTES = SilhouetteEvidence(_NO_VIEWS, (), PreparedMasks(*_NO_MASKS))
NO_KEYPOINTS = KeypointEvidence(_NO_VIEWS, (), arrays.NO_KEYPOINTS)
NO_DEPTH = DepthEvidence(_NO_VIEWS, (), _NO_MAPS)
