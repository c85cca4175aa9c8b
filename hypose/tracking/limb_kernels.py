"""Steps of a limb in its own directions: the swing of a ball joint apart from the twist about the bone.

A shoulder's twist is not seen before the forearm is drawn, so a layered filter searches the swing with the upper arm
and the twist with the forearm. Balls are rotation vectors, in which neither is a coordinate; here both are turns in
the bone's own frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hypose.body.skeleton import Skeleton
from hypose.geometry import Array, nearest_branch, so3_exp, so3_log
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.kernels import HeavyTail, reflect
from hypose.tracking.frame_evidence import PreparedFrame


@dataclass(frozen=True)
class BallStep:
    """start: first coordinate of a ball; axis (3,): unit direction of the bone that hangs on it, model frame at rest;
    swing: rad, sd of each turn across the bone; twist: rad, sd of the turn about it."""

    start: int
    axis: Array
    swing: float
    twist: float


def ball_step(skeleton: Skeleton, joint: str, child: str, swing: float, twist: float) -> BallStep:
    """The BallStep of a named joint whose bone ends at the joint `child`."""
    bone = skeleton.rest_offsets[skeleton.joint(child)]
    return BallStep(int(skeleton.dofs_of(joint)[0]), bone / np.linalg.norm(bone), swing, twist)


@dataclass(frozen=True)
class LimbDiffusion:
    """Kernel: Gaussian steps, sigma (D,) per coordinate, and for some balls (whose sigma must be 0) swing and twist.

    R -> R exp(w), w = swing (g - (g.a) a) + twist (t a) with normal g (3,), t. Bounds by `reflect` on what moved.
    tail: longer steps for a share of the set, on the coordinates it names.
    """

    skeleton: Skeleton
    sigma: Array
    balls: tuple[BallStep, ...] = ()
    tail: HeavyTail | None = None

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """The moved set."""
        s = self.skeleton
        gain = np.ones((h.count, s.dof)) if self.tail is None else self.tail.gain(h.count, s.dof)
        step = rng.standard_normal(h.values.shape) * self.sigma * gain
        moved = np.array(self.sigma > 0)
        values = h.values + step
        for ball in self.balls:
            columns = slice(ball.start, ball.start + 3)
            g, t = rng.standard_normal((h.count, 3)), rng.standard_normal(h.count)
            across = g - np.einsum("na,a->n", g, ball.axis)[:, None] * ball.axis
            turn = gain[:, columns] * (ball.swing * across + ball.twist * t[:, None] * ball.axis)
            before = h.values[:, columns]
            after = so3_log(so3_exp(before) @ so3_exp(turn))
            values[:, columns] = nearest_branch(after, before)
            moved[columns] = True
        return replace(h, values=np.where(moved, reflect(values, s.lower, s.upper), h.values))
