"""Fit the person's body to key points: segment lengths, and where the key points sit on the body.

A tracker is as good as its body. Lengths come from medians over the clip, so they are constant; girths, and sizes that
no key point shows, come from outlines (`hypose.pipeline.subject.with_outlines`).
Source: Alcoverro 2014, section 2.3 (entities, grouped symmetrically); the fitting from key points is an addition.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.anthropometry import SHAPE_FACTORS, entity, shape_of
from hypose.body.body import Body, Shape, deform
from hypose.errors import EvidenceError
from hypose.evidence.keypoints import BLAZEPOSE_33, landmark_of
from hypose.evidence.terms import PointTerm
from hypose.fitting.articulated import SolveSettings, fit_pose
from hypose.geometry import Array
from hypose.tracking.frame_evidence import KeypointModel, keypoint_model
from hypose.tracking.keypoint_offsets import leg_weights, offset_limits
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.start_search import start_from_keypoints

PAIRED = {
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
}

ACROSS, _SD_OF_MAD, _SHORTEST = 2, 1.4826, 0.7
"""Directions across a bone; ratio of sd to the median distance from the median; least share of a measured length that
is left after the scatter is subtracted."""


@dataclass(frozen=True)
class KeypointSubject:
    """A body fitted to key points.

    body: the fitted body.
    keypoints: where the key points sit on it.
    poses: (T, D) pose vectors, rad and m; NaN where not solved.
    residual: (T, K) distances between the triangulated points and the fitted body, m.
    """

    body: Body
    keypoints: KeypointModel
    poses: Array
    residual: Array


def subject_from_keypoints(
    body: Body, points_world: Array, names: tuple[str, ...], *, rounds: int = 3, max_frames: int = 40
) -> KeypointSubject:
    """Estimate segment lengths, shoulder width and the key points' offsets from triangulated points.

    points_world: (T, K, 3) m; NaN where missing.
    rounds: alternations of poses and offsets; max_frames: frames that are solved.
    Raises: EvidenceError where hardly any segment, or no frame with 6 points, is seen.
    Lengths are medians over the frames, minus what scatter adds to them; left and right are averaged. Segments that are
    never seen are in proportion to the others. Offsets are limited to 5 cm for joints, 12 cm for the face and 8 cm for
    the feet, since a detector's hip is not the joint's centre.
    """
    deformed = deform(body, shape_from_keypoints(body, points_world, names))
    model = keypoint_model(deformed, names)
    usable = np.flatnonzero(np.isfinite(points_world[:, model.known]).all(-1).sum(1) >= 6)
    if len(usable) == 0:
        raise EvidenceError("No frame has 6 triangulated key points; check the key points' folder and the calibration.")
    chosen = usable[np.unique(np.linspace(0, len(usable) - 1, min(max_frames, len(usable))).astype(int))]
    base, limit = model.offset.copy(), offset_limits(names)
    poses = np.full((len(points_world), body.skeleton.dof), np.nan)
    for _ in range(rounds):
        _solve_frames(deformed, points_world, model, chosen, poses)
        local = _in_joint_frames(deformed, points_world, model, poses)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a key point never seen: no median, no shift
            shift = np.nan_to_num(np.nanmedian(local[chosen], axis=0) - base)
        length = np.linalg.norm(shift, axis=1, keepdims=True)
        offset = base + shift * np.minimum(1, limit[:, None] / np.maximum(length, 1e-9))
        model = replace(model, offset=np.where(model.known[:, None], offset, base))
    _solve_frames(deformed, points_world, model, chosen, poses)
    residual = np.linalg.norm(_in_joint_frames(deformed, points_world, model, poses) - model.offset, axis=-1)
    return KeypointSubject(deformed, model, poses, residual)


def shape_from_keypoints(body: Body, points_world: Array, names: tuple[str, ...]) -> Shape:
    """Estimate the length factors of a body from triangulated points (T, K, 3), m.

    names: names of the K points; NaN marks missing points.
    Raises: EvidenceError where fewer than two of the segments are seen.
    """
    skeleton = body.skeleton
    carrier, from_joint, _ = landmark_of(names, body)
    rest = skeleton.rest_joints[carrier] + from_joint  # of the key points
    column = {name: k for k, name in enumerate(names) if name in skeleton.joint_names}  # limbs: key point = joint name

    def factor(a: str, b: str) -> tuple[float, float]:
        """Compute the factor of a bone's length, and by what share of it the length changes from frame to frame."""
        if a not in column or b not in column:
            return float("nan"), float("nan")
        d = np.linalg.norm(points_world[:, column[a]] - points_world[:, column[b]], axis=-1)
        if not np.isfinite(d).any():
            return float("nan"), float("nan")
        middle = float(np.nanmedian(d))
        scatter = _SD_OF_MAD * float(np.nanmedian(np.abs(d - middle)))
        changes = scatter / max(middle, 1e-9)
        # scatter across a bone, as large as that along it, makes the measured length longer
        middle = np.sqrt(max(middle**2 - ACROSS * scatter**2, (_SHORTEST * middle) ** 2))
        return middle / float(np.linalg.norm(rest[column[a]] - rest[column[b]])), changes

    limbs = {
        segment: _of_sides(factor(f"left_{a}", f"left_{b}"), factor(f"right_{a}", f"right_{b}"))
        for segment, (a, b) in PAIRED.items()
    }
    trunk = _of_sides(*(factor(f"{side}_shoulder", f"{side}_hip") for side in ("left", "right")))
    unseen = [segment for segment, value in limbs.items() if np.isnan(value)]
    if unseen:  # legs below a desk: in proportion to the visible part
        seen = [v for v in (*limbs.values(), trunk) if v > 0]
        if len(seen) < 2:
            raise EvidenceError(
                f"The key points never show the {unseen[0]} in two views; check their folder and calibration."
            )
        limbs |= dict.fromkeys(unseen, float(np.mean(seen)))
    scale = float(np.nanmean([limbs["thigh"], limbs["shank"], trunk]))
    if tuple(names) == BLAZEPOSE_33:
        limbs = {segment: scale * (value / scale) ** PROPORTION for segment, value in limbs.items()}
        trunk = scale * (trunk / scale) ** PROPORTION
    shoulders, _ = factor("left_shoulder", "right_shoulder")
    shoulders = scale if np.isnan(shoulders) else float(np.clip(shoulders, 0.8 * scale, 1.2 * scale))
    trunk = scale if np.isnan(trunk) else float(trunk)
    found = {"scale": scale, "torso length": trunk / scale, "shoulder width": shoulders / scale}
    found |= {f"{segment.replace('_', ' ')} length": value / scale for segment, value in limbs.items()}
    factors = np.zeros(len(SHAPE_FACTORS))
    factors[[entity(name) for name in found]] = np.log(list(found.values()))
    return shape_of(factors)


PROPORTION = 0.4
"""Share of a bone's deviation from usual proportions that is kept with BlazePose points: on rendered people (seeds 6100
to 6104) these were wrong by 8 to 20 %, while people differ by 4 to 5 %."""
_UNLIKE = 1.25
"""Largest ratio of a left bone and the right one; more is a key point that is not where its name says."""


def _of_sides(left: tuple[float, float], right: tuple[float, float]) -> float:
    """Average the factors of the left and right bone, where seen; where they differ much, take the one that varies
    less.
    """
    seen = [side for side in (left, right) if np.isfinite(side[0])]
    if len(seen) == 2 and max(seen)[0] > _UNLIKE * min(seen)[0]:
        return min(seen, key=lambda side: side[1])[0]
    return float(np.mean([factor for factor, _ in seen])) if seen else float("nan")


def _solve_frames(body: Body, points: Array, model: KeypointModel, frames: np.ndarray, poses: Array) -> None:
    """Solve the chosen frames in order, each from the previous one; fill poses (T, D) in place.

    points: (T, K, 3) m; model: where they sit on the body; frames: indices of those chosen.
    """
    last: Array | None = None
    joint, offset = model.joint[model.known], model.offset[model.known]
    weights = leg_weights(model.names)[model.known]
    for t in frames:
        seen = points[t][model.known]
        if last is None:
            poses[t] = start_from_keypoints(body, seen, joint, offset).pose
        else:
            start = poses[t] if np.isfinite(poses[t]).all() else last
            term = PointTerm(seen, weights, joint, offset, 0.03)
            options = SolveSettings(iterations=20, coarse_iterations=8)
            priors = (anatomical_prior(body.skeleton, keypoints=True),)
            poses[t] = fit_pose(body, start, [term], priors=priors, options=options).pose
        last = poses[t]


def _in_joint_frames(body: Body, points: Array, model: KeypointModel, poses: Array) -> Array:
    """Compute the points (T, K, 3) in the frames of their joints; NaN where not solved or not seen.

    model: where the points sit on the body; poses: (T, D), NaN where not solved.
    """
    out = np.full((len(points), len(model.names), 3), np.nan)
    done = np.flatnonzero(np.isfinite(poses).all(1))
    rotations, centres = body.skeleton.forward(poses[done])
    r, p = rotations[:, model.joint], centres[:, model.joint]
    out[done] = np.einsum("tkba,tkb->tka", r, points[done] - p)
    return out
