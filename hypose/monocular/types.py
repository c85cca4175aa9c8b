"""What goes into a monocular tracker and what comes out: values, and their conversion to plain arrays.

One camera sees no depth but through perspective and the known body, so the result is a weighted set of hypotheses with
covariances, not a pose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.errors import EvidenceError, InputError
from hypose.evidence.keypoints import landmark_of
from hypose.geometry import Array

OPTIMISED, SAMPLED, FLIPPED, START = 0, 1, 2, 3
"""Where a hypothesis came from: it was optimised, drawn along an uncertain direction, a mirrored limb, or given."""


@dataclass(frozen=True)
class MonoPoints:
    """Points of the body seen in the image: key points of a detector and clicked joints.

    pixels (P, 2) of the undistorted image; confidence (P,) the weight, 0 = not seen; joint (P,), offset (P, 3) m in
    the joint's frame: where the point sits on the body; scale_px (P,): 1 sd."""

    pixels: Array
    confidence: Array
    joint: NDArray[np.int64]
    offset: Array
    scale_px: Array

    def __post_init__(self) -> None:
        p = len(self.pixels)
        shapes = [np.shape(a) for a in (self.pixels, self.confidence, self.joint, self.offset, self.scale_px)]
        if shapes != [(p, 2), (p,), (p,), (p, 3), (p,)]:
            raise InputError(
                "Points need pixels (P, 2), confidence (P,), joint (P,), offset (P, 3) and scale_px (P,), got "
                f"{', '.join(map(str, shapes))}."
            )
        bad = (self.confidence > 0) & ~np.isfinite(self.pixels).all(1)
        if bad.any():
            raise EvidenceError(
                f"Point {int(bad.argmax())} of {p} has a confidence but no finite position; give missing points "
                "confidence 0."
            )
        if not (np.asarray(self.scale_px) > 0).all():
            raise InputError("Every point needs a scale_px above 0: its standard deviation in pixels.")


def points_from_keypoints(
    body: Body,
    names: Sequence[str],
    keypoints: ArrayLike,
    *,
    scale_px: float = 4.0,
    min_confidence: float = 0.3,
    joint: NDArray[np.int64] | None = None,
    offset: Array | None = None,
) -> MonoPoints:
    """Key points (K, 3) = (u px, v px, confidence) of one view. Those that the body does not know, that are weaker than
    min_confidence or not finite get confidence 0. joint (K,), offset (K, 3): learnt places instead of the usual ones.
    """
    k = np.array(keypoints, dtype=np.float64)
    if k.shape != (len(names), 3):
        raise InputError(f"{len(names)} key points need the shape {(len(names), 3)} (u, v, confidence), got {k.shape}.")
    on_joint, at, known = landmark_of(names, body)
    if joint is not None and offset is not None:
        on_joint, at = np.asarray(joint), np.asarray(offset)
    seen = known & np.isfinite(k).all(1) & (np.nan_to_num(k[:, 2]) >= min_confidence)
    pixels = np.where(seen[:, None], k[:, :2], 0.0)
    return MonoPoints(pixels, np.where(seen, k[:, 2], 0.0), on_joint, at, np.full(len(k), scale_px))


def clicked_joints(body: Body, clicks: Mapping[str, tuple[float, float]], scale_px: float = 4.0) -> MonoPoints:
    """Joints clicked in an image: name -> (u, v) px; an InputError lists the joints."""
    joint = np.array([body.skeleton.joint(name) for name in clicks], dtype=np.int64)
    pixels = np.array(list(clicks.values()), dtype=np.float64).reshape(-1, 2)
    n = len(joint)
    return MonoPoints(pixels, np.ones(n), joint, np.zeros((n, 3)), np.full(n, scale_px))


@dataclass(frozen=True)
class MonoFrame:
    """One picture of one camera. index; time s; image (h, w, 3) uint8 BGR, undistorted, as large as the tracker's
    camera; mask (h, w), non-zero = person, and points where there are any. The tracker keeps the previous picture
    itself."""

    index: int
    time: float
    image: NDArray[np.uint8]
    mask: NDArray[np.uint8] | None = None
    points: MonoPoints | None = None


@dataclass(frozen=True)
class MonoHypotheses:
    """A weighted set of poses: the posterior of one frame, best first.

    poses (K, D); velocities (K, D) per frame; covariances (K, D, D) of the poses, already inflated, 0 for dof that are
    not estimated; weights (K,), sum 1; costs (K,) negative log posterior of this frame's evidence; evidence (K,) the
    cost accumulated over the frames, by which hypotheses are ranked; labels (K,) OPTIMISED, SAMPLED, FLIPPED or START.
    """

    poses: Array
    velocities: Array
    covariances: Array
    weights: Array
    costs: Array
    evidence: Array
    labels: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.poses)

    @staticmethod
    def at(poses: ArrayLike, costs: ArrayLike | None = None, covariances: ArrayLike | None = None) -> MonoHypotheses:
        """A first set from rival start poses (K, D) or one (D,), at rest; costs (K,) rank them (default: equal);
        covariances (K, D, D) (default: none)."""
        q = np.atleast_2d(np.array(poses, dtype=np.float64))
        k, d = q.shape
        c = np.zeros(k) if costs is None else np.array(costs, dtype=np.float64)
        order = np.argsort(c, kind="stable")
        q, c = q[order], c[order]
        spread = np.zeros((k, d, d)) if covariances is None else np.array(covariances, dtype=np.float64)[order]
        w = np.exp(c[0] - c)
        return MonoHypotheses(q, np.zeros((k, d)), spread, w / w.sum(), c, c - c[0], np.full(k, START, dtype=np.int8))


@dataclass(frozen=True)
class MonoState:
    """What the next frame needs: the hypotheses to start from, the previous picture (h, w) uint8 grey (None before the
    first), and how many frames are done."""

    frames: int
    hypotheses: MonoHypotheses
    grey: NDArray[np.uint8] | None


class Nodes(NamedTuple):
    """The best hypothesis' nodes in the image: contour nodes that are seen, of these how many found an edge, how many
    edges they found, contour nodes behind another part, mesh nodes that face away, inner nodes with usable flow."""

    contour: int
    assigned: int
    assignments: int
    occluded: int
    back_facing: int
    flow: int


class StageTimes(NamedTuple):
    """Seconds of one frame's stages."""

    edges: float
    flow: float
    optimise: float
    sample: float
    posterior: float

    @property
    def total(self) -> float:
        """Seconds of the whole step."""
        return float(sum(self))


@dataclass(frozen=True)
class MonoEstimate:
    """What one frame says. pose (D,) of the best hypothesis; joint_covariance (J, 3, 3) m^2 of its joint centres in the
    world, inflated; joint_sd (J,) m per axis and depth_sd (J,) m along the line of sight, both from it; cost of the
    best hypothesis; posterior: all optimised hypotheses that are distinct; alive: how many there are (one may be left
    of many that were asked for); lost: hardly any contour finds an edge, or the body is out of the picture."""

    pose: Array
    joint_covariance: Array
    joint_sd: Array
    depth_sd: Array
    cost: float
    posterior: MonoHypotheses
    alive: int
    lost: bool
    nodes: Nodes
    seconds: StageTimes


def posterior_arrays(body: Body, estimates: Sequence[MonoEstimate]) -> dict[str, np.ndarray]:
    """The whole posterior of T frames as plain arrays for an .npz file, padded with NaN to the largest number K of
    hypotheses: mode_poses (T, K, D), mode_joints (T, K, J, 3) m, mode_weights (T, K), mode_costs (T, K),
    mode_covariances (T, K, D, D); of the best hypothesis joint_covariance (T, J, 3, 3) m^2 and depth_sd (T, J) m; alive
    (T,)."""
    t, k = len(estimates), max((len(e.posterior) for e in estimates), default=0)
    d, j = body.skeleton.dof, len(body.skeleton.joint_names)
    out = {
        "mode_poses": np.full((t, k, d), np.nan),
        "mode_joints": np.full((t, k, j, 3), np.nan),
        "mode_weights": np.full((t, k), np.nan),
        "mode_costs": np.full((t, k), np.nan),
        "mode_covariances": np.full((t, k, d, d), np.nan),
        "joint_covariance": np.stack([e.joint_covariance for e in estimates]),
        "depth_sd": np.stack([e.depth_sd for e in estimates]),
        "alive": np.array([e.alive for e in estimates], dtype=np.int64),
    }
    for i, e in enumerate(estimates):
        n = len(e.posterior)
        out["mode_poses"][i, :n] = e.posterior.poses
        out["mode_joints"][i, :n] = body.joints(e.posterior.poses)
        out["mode_weights"][i, :n] = e.posterior.weights
        out["mode_costs"][i, :n] = e.posterior.costs
        out["mode_covariances"][i, :n] = e.posterior.covariances
    return out
