"""Fit all frames of a clip together, coupled by penalties on acceleration and speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.body.body import Body
from hypose.compute.linear import solve_coupled
from hypose.errors import SolverError
from hypose.evidence.terms import Term
from hypose.fitting.articulated import LARGEST_TURN, PoseCost, SolveSettings, turned
from hypose.fitting.problem import Problem, Quadratic, Rule
from hypose.geometry import Array, nearest_branch, so3_exp, so3_left_jacobian, so3_log, so3_turns


@dataclass(frozen=True)
class Gaussian:
    """Evidence of one frame, summarised as a Gaussian distribution of the pose: cost 1/2 off' information off.

    centre: (D,) most probable pose.
    information: (D, D) inverse covariance, with the root's rotation as a small turn in the world
        (`PoseFit.information`).

    `off` is the difference (D,) of a pose from the centre: for the root the turn in the world log(R R0'), for other
    balls the turn from there log(R0' R), in the coordinates at the centre.
    Why: the rotation of a stretched arm about its own axis is undetermined. With turns it stays undetermined for any
    angle; along a straight line of rotation vectors it would move the elbow.
    """

    centre: Array
    information: Array


def default_acceleration(dof: int, strength: float = 1.0) -> Array:
    """Return weights (D,) on squared second differences per frame, by which 1 rad and 1/300 m per frame^2 cost the
    same.

    dof: number D of degrees of freedom.
    strength: factor of all weights.
    """
    return strength * np.r_[np.full(3, 300.0), np.ones(dof - 3)] ** 2


def fit_clip(
    body: Body,
    starts: ArrayLike,
    evidence: Sequence[Sequence[Term | Gaussian]],
    *,
    acceleration: float | ArrayLike = 1.0,
    velocity: ArrayLike = 0.0,
    priors: Sequence[Quadratic] = (),
    options: SolveSettings | None = None,
) -> Array:
    """Fit the poses of all frames of a clip to their evidence, with penalties on acceleration and speed.

    body: the body.
    starts: (T, D) poses.
    evidence: terms of each frame; masks and depth are faster as a `Gaussian`.
    acceleration: strength a (times `default_acceleration`), or weights (D,) or (T - 2, D).
    velocity: weights v: one for all, (D,) or (T - 1, D). Without it an extrapolated motion never slows down.
    priors: quadratic costs on every pose.
    options: settings of the solve.
    Returns: (T, D) poses, the root's rotation vector on the branch nearest to its start.
    Raises: SolverError where the number of frames of the evidence is wrong or the cost at the start is not finite.

    The penalties are 1/2 sum_d a_d (q_{t-1} - 2 q_t + q_{t+1})_d^2 + 1/2 sum_d v_d (q_{t+1} - q_t)_d^2. Differences of
    the root's rotation are the turns from one frame to the next, log(R_{t+1} R_t'), because differences of rotation
    vectors have no meaning near a full turn. The solve is a damped Gauss-Newton over all frames. Its matrix couples
    each frame to the next two, so that the time is linear in T. Joint limits are kept by clipping steps.
    """
    given = np.array(starts, dtype=np.float64)
    q = given.copy()
    q[:, 3:6] = nearest_branch(q[:, 3:6], np.zeros(3))
    n_frames, dof = q.shape
    o = options or SolveSettings(iterations=15, coarse_iterations=0)
    weights = np.asarray(acceleration, dtype=np.float64)
    if weights.ndim == 0:
        weights = default_acceleration(dof, float(weights))
    q = np.clip(q, body.skeleton.lower, body.skeleton.upper)
    coupling = Coupling(n_frames, weights, np.broadcast_to(velocity, (n_frames - 1, dof)), _cuts(body, q))
    problem = _Clip(body, coupling, evidence, priors)
    rule = Rule(o.damping, least=1e-6, most=1e6, tries=5, slack=1.0, moved=o.tolerance)
    q = problem.solve(q, o.iterations, rule).state
    q[:, 3:6] = nearest_branch(q[:, 3:6], given[:, 3:6])
    return q


def _moved(q: Array, step: Array) -> Array:
    """Return poses (T, D) after a step (T, D) in which the root turns in the world."""
    out = q + step
    out[:, 3:6] = so3_log(so3_exp(step[:, 3:6]) @ so3_exp(q[:, 3:6]))
    return out


def pose_steps(q: Array) -> Array:
    """Compute the differences (T - 1, D) of poses (T, D) from frame to frame; for the root's rotation the turn in the
    world.
    """
    v, rotations = np.diff(q, axis=0), so3_exp(q[:, 3:6])
    v[:, 3:6] = so3_log(rotations[1:] @ np.swapaxes(rotations[:-1], -1, -2))
    return v


class Coupling:
    """Penalties on squared first and second differences between T frames.

    acceleration, velocity: weights (D,), or one row per difference.
    cut: (T - 1, D) True where the difference between two frames does not count; None: nowhere.
    bands: (3, T, D) their matrix: the weights between a frame and the frame s = 0, 1, 2 later, per degree of freedom.
    """

    def __init__(
        self, n_frames: int, acceleration: Array, velocity: Array, cut: NDArray[np.bool_] | None = None
    ) -> None:
        self.n_frames = n_frames
        dof = acceleration.shape[-1]
        goes_on = np.ones((max(n_frames - 1, 0), dof)) if cut is None else 1.0 - cut
        self.acceleration = np.asarray(acceleration) * goes_on[1:] * goes_on[:-1]
        self.velocity = np.asarray(velocity) * goes_on
        self.bands = np.zeros((3, n_frames, dof))
        for weight, stencil in ((self.acceleration, (1.0, -2.0, 1.0)), (self.velocity, (-1.0, 1.0))):
            for first in range(len(stencil)):
                for second in range(first, len(stencil)):
                    self.bands[second - first, first : first + len(weight)] += stencil[first] * stencil[second] * weight

    def cost(self, q: Array) -> tuple[float, Array]:
        """Compute the cost of poses (T, D) and its gradient (T, D); the derivatives by the root's rotation are by small
        turns in the world.
        """
        v = pose_steps(q)
        a = np.diff(v, axis=0)
        cost = 0.5 * float((self.acceleration * a**2).sum() + (self.velocity * v**2).sum())
        by_v = self.velocity * v
        by_v[1:] += self.acceleration * a
        by_v[:-1] -= self.acceleration * a
        pull = np.zeros_like(q)
        pull[1:] += _by_turn(by_v, v)
        pull[:-1] -= _by_turn(by_v, -v)
        return cost, pull


def _cuts(body: Body, q: Array) -> NDArray[np.bool_]:
    """Find where (T - 1, D) a ball's rotation vector changes its branch between two frames of poses (T, D).

    There the difference does not describe the rotation. The root is excluded, because its differences are turns.
    """
    out = np.zeros((len(q) - 1, q.shape[1]), dtype=np.bool_)
    for s in body.skeleton.ball_starts[1:]:
        r = q[:, s : s + 3]
        other = nearest_branch(r[1:], r[:-1])
        out[:, s : s + 3] = (np.abs(other - r[1:]).max(1) > 1e-6)[:, None]
    return out


def _by_turn(by_v: Array, v: Array) -> Array:
    """Convert derivatives by rows v (T, D), whose columns 3:6 are rotation vectors, to those by small turns in the
    world.
    """
    out = by_v.copy()
    out[:, 3:6] = np.einsum("tab,ta->tb", so3_turns(v[:, 3:6]), by_v[:, 3:6])
    return out


class _Around:
    """Cost of the difference between poses (T, D) and the centres of the frames' Gaussians."""

    def __init__(self, body: Body, gaussians: Sequence[Gaussian | None]) -> None:
        self.balls, dof = body.skeleton.ball_starts[1:, None] + np.arange(3), body.skeleton.dof
        self.known = np.array([g is not None for g in gaussians])
        self.centres = np.array([g.centre for g in gaussians if g is not None]).reshape(-1, dof)
        self.information = np.array([g.information for g in gaussians if g is not None]).reshape(-1, dof, dof)
        own = self.centres[:, self.balls]
        self.back, self.flat, self.root = so3_exp(-own), so3_turns(-own), so3_exp(-self.centres[:, 3:6])

    def __call__(self, q: Array) -> tuple[float, Array, Array]:
        """Compute the cost of poses, its gradient (T, D) and Gauss-Newton Hessian (T, D, D), by turns of the root."""
        gradient, hessian = np.zeros_like(q), np.zeros((*q.shape, q.shape[1]))
        now, b = q[self.known], self.balls
        off, slope = now - self.centres, np.tile(np.eye(q.shape[1]), (len(now), 1, 1))
        off[:, 3:6] = so3_log(so3_exp(now[:, 3:6]) @ self.root)
        slope[:, 3:6, 3:6] = so3_turns(off[:, 3:6])
        turned = so3_log(self.back @ so3_exp(now[:, b]))
        off[:, b] = (self.flat @ turned[..., None])[..., 0]
        slope[:, b[:, :, None], b[:, None, :]] = self.flat @ so3_turns(-turned) @ so3_left_jacobian(-now[:, b])
        pull = (self.information @ off[..., None])[..., 0]
        gradient[self.known] = (pull[:, None] @ slope)[:, 0]
        hessian[self.known] = np.swapaxes(slope, 1, 2) @ self.information @ slope
        return 0.5 * float((off * pull).sum()), gradient, hessian


class _Clip(Problem[Array, tuple[Array, Array]]):
    """Evidence of all frames as flat arrays; computes cost, gradient (T, D) and diagonal blocks (T, D, D) of the whole
    clip.
    """

    def __init__(
        self,
        body: Body,
        coupling: Coupling,
        evidence: Sequence[Sequence[Term | Gaussian]],
        priors: Sequence[Quadratic],
    ) -> None:
        n_frames = coupling.n_frames
        if len(evidence) != n_frames:
            raise SolverError(f"fit_clip needs the evidence of every frame: {n_frames}, got {len(evidence)}.")
        gaussians = [[one for one in of if isinstance(one, Gaussian)] for of in evidence]
        self.costs = [PoseCost(body, [one for one in of if not isinstance(one, Gaussian)], priors) for of in evidence]
        self.lower, self.upper = body.skeleton.lower, body.skeleton.upper
        self.coupling, self.around = coupling, _Around(body, [of[0] if of else None for of in gaussians])

    def evaluate(self, state: Array) -> tuple[float, Callable[[], tuple[Array, Array]]]:
        q = state
        (cost, by_known, curved), (t, d) = self.around(q), q.shape
        gradient, hessian = np.empty((t, d)), np.empty((t, d, d))
        for k, of_frame in enumerate(self.costs):
            e = of_frame.evaluate(q[k], of_frame.priors(q[k]))
            cost += e.cost
            gradient[k], hessian[k] = e.gradient, turned(e.hessian, so3_turns(q[k, 3:6]).T)
        gradient = _by_turn(gradient, q) + by_known
        coupled, pull = self.coupling.cost(q)
        return cost + coupled, lambda: (gradient + pull, hessian + curved)

    def propose(self, state: Array, equations: tuple[Array, Array], damping: float) -> tuple[Array, float] | None:
        step = self.step(*equations, state, damping)
        if step is None:
            return None
        step *= min(1.0, LARGEST_TURN / max(float(np.abs(step[:, 3:]).max()), 1e-9))
        moved = max(2 * float(np.abs(step[:, :3]).max()), float(np.abs(step[:, 3:]).max()))
        return np.clip(_moved(state, step), self.lower, self.upper), moved

    def step(self, gradient: Array, hessian: Array, q: Array, damping: float) -> Array | None:
        """Compute the damped Newton step (T, D) with the dof that push against a limit held; None where not positive
        definite.

        gradient: (T, D); hessian: (T, D, D) hessian of each frame alone; q: (T, D) poses; damping: relative to the
            diagonal.
        """
        held = ((q <= self.lower + 1e-9) & (gradient > 0)) | ((q >= self.upper - 1e-9) & (gradient < 0))
        keep = ~held
        own = hessian * (keep[:, :, None] & keep[:, None, :])
        bands = self.coupling.bands * keep
        for s in (1, 2):
            bands[s, : len(q) - s] *= keep[s:]
        diagonal = np.einsum("tdd->td", own) + bands[0]
        bands[0] += damping * np.maximum(diagonal, 1.0) + held  # a held coordinate stands alone
        step = solve_coupled(own, bands, gradient * keep)
        return None if step is None else -step
