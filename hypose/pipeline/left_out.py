"""How far the joints go without each camera, by its evidence: frames of a tracked motion solved anew from all cameras,
and from all but one. What `camera_worth` says by geometry, this says by key points and outlines, with what covers what
and how each camera errs; frames are solved alone, so that neighbours do not stand in for the camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame
from hypose.fitting import SolveSettings, contour_term, fit_pose
from hypose.fitting.articulated import ContourTerm, KeypointTerm
from hypose.geometry import Array
from hypose.pipeline.one_camera import FrameSource
from hypose.tracking.keypoint_evidence import KeypointModel, keypoint_model, keypoint_term
from hypose.tracking.keypoint_offsets import calibrate_keypoints
from hypose.tracking.refinement import anatomical_prior

FRAMES = 12
"""that are looked at, spread over the motion"""
_SETTINGS = SolveSettings(iterations=12, coarse_iterations=0)


@dataclass(frozen=True)
class LeftOut:
    """name of the camera; moved m: median distance that a joint goes without it, far: 95 %; n: frames in which it and
    two others (with outlines, one other) had evidence."""

    name: str
    moved: float
    far: float
    n: int


class KeptFrames:
    """A source of frames that keeps those which will be solved anew, as they go by."""

    def __init__(self, source: FrameSource, motion: Motion) -> None:
        self._source, self.frames = source, dict[int, Frame]()
        known = np.flatnonzero(~(motion.lost | motion.extrapolated).astype(bool))
        chosen = known[np.linspace(0, len(known) - 1, min(FRAMES, len(known))).astype(int)] if len(known) else known
        self.rows: list[int] = chosen.tolist()

    def __len__(self) -> int:
        return len(self._source)

    def frame(self, index: int, /) -> Frame:
        """That of the source."""
        found = self._source.frame(index)
        if index in self.rows:
            self.frames[index] = found
        return found

    def every(self) -> Mapping[int, Frame]:
        """All of them by row, those that did not go by looked up."""
        for row in self.rows:
            if row not in self.frames:
                self.frame(row)
        return self.frames


def evidence_said(motion: Motion) -> str:
    """What a motion was tracked from: keypoints, silhouettes or both."""
    settings = motion.provenance.get("settings", {})
    said = settings.get("evidence") if isinstance(settings, Mapping) else None
    return said if said in ("keypoints", "silhouettes") else "both"


def left_out(motion: Motion, body: Body, frames: Mapping[int, Frame], evidence: str) -> list[LeftOut]:
    """Every camera, from frames by row of the motion; evidence: keypoints, silhouettes or both. Nothing of a motion
    without poses, or frames without evidence."""
    if motion.poses is None:
        return []
    poses = motion.poses
    rows = [t for t in sorted(frames) if np.isfinite(poses[t]).all()]
    model = _model(body, [frames[t] for t in rows], poses[rows]) if evidence != "silhouettes" else None
    moved: dict[str, list[Array]] = {}
    for t in rows:
        contours, points = _terms(frames[t], body, model, poses[t], evidence)
        seen = _seen(contours, points)
        if seen.sum() < (3 if contours is None else 2):
            continue  # what is left would say nothing of depth
        whole = _joints(body, poses[t], contours, points)
        for c in np.flatnonzero(seen).tolist():
            alone = _joints(body, poses[t], *_without(c, contours, points))
            moved.setdefault(_names(frames[t])[c], []).append(np.linalg.norm(alone - whole, axis=-1))
    order = list(dict.fromkeys(n for t in rows for n in _names(frames[t])))
    return [
        LeftOut(n, float(np.median(moved[n])), float(np.quantile(moved[n], 0.95)), len(moved[n]))
        for n in order
        if n in moved
    ]


def _names(frame: Frame) -> tuple[str, ...]:
    given = frame.silhouettes or frame.keypoints
    return given.rig.names if given is not None else ()


def _model(body: Body, frames: Sequence[Frame], poses: Array) -> KeypointModel | None:
    """Where the key points sit on this body, measured on these frames."""
    given = [(f.keypoints, q) for f, q in zip(frames, poses, strict=True) if f.keypoints is not None]
    if not given:
        return None
    keypoints = [k for k, _ in given]
    return calibrate_keypoints(
        body, keypoint_model(body, keypoints[0].names), keypoints, np.stack([q for _, q in given])
    )


def _terms(
    frame: Frame, body: Body, model: KeypointModel | None, pose: Array, evidence: str
) -> tuple[ContourTerm | None, KeypointTerm | None]:
    contours = None
    if evidence != "keypoints" and frame.silhouettes is not None:
        with suppress(EvidenceError):  # no usable mask
            contours = contour_term(frame.silhouettes)
    points = None if model is None or frame.keypoints is None else keypoint_term(frame.keypoints, body, model, pose)
    return contours, points


def _seen(contours: ContourTerm | None, points: KeypointTerm | None) -> NDArray[np.bool_]:
    """(C,) cameras with evidence."""
    seen = [] if contours is None else [contours.usable]
    seen += [] if points is None else [np.asarray((points.points[..., 2] > 0).any(1))]
    return np.asarray(np.any(seen, axis=0), dtype=np.bool_) if seen else np.zeros(0, np.bool_)


def _without(
    view: int, contours: ContourTerm | None, points: KeypointTerm | None
) -> tuple[ContourTerm | None, KeypointTerm | None]:
    if contours is not None:
        usable = contours.usable.copy()
        usable[view] = False
        contours = replace(contours, usable=usable) if usable.any() else None
    if points is not None:
        rest = points.points.copy()
        rest[view] = 0.0
        points = replace(points, points=rest) if (rest[..., 2] > 0).any() else None
    return contours, points


def _joints(body: Body, pose: Array, contours: ContourTerm | None, points: KeypointTerm | None) -> Array:
    """(J, 3) m of a frame by itself, from its tracked pose (D,)."""
    prior = anatomical_prior(body.skeleton, keypoints=points is not None)
    fit = fit_pose(body, pose, contours=contours, keypoints=points, priors=(prior,), options=_SETTINGS)
    return body.joints(fit.pose)
