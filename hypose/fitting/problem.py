"""Damped Gauss-Newton on any unknowns: the common least-squares problem above the compiled solve of one frame.

A `Problem` computes the cost of a state, its normal equations, and the step that they propose; `solve` controls the
damping. `SharedProblem`: groups of unknowns (poses of frames, points, boards) that are coupled only through unknowns
shared by all (shape, cameras); the groups are eliminated (Schur complement), so that the cost of a step grows linearly
with their number. `PoseProblem`: the groups are poses of a body, and the cues of a frame give `Rows`, residuals of
points of the body, from which the derivatives by poses and by the shared unknowns follow.
Deviation: a skinned point turns about its blended place, where each of its joints carries an image of its own; over a
body's vertices the derivatives by a pose are off by 0.2 % (rms).
Sources: Levenberg 1944, Marquardt 1963, damping relative to the diagonal; Triggs et al. 2000, section 6.1.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Landmarks, Mesh
from hypose.compute.linear import SharedEquations, weighted_squares
from hypose.errors import SolverError
from hypose.geometry import Array

State = TypeVar("State")
Equations = TypeVar("Equations")
Shared = TypeVar("Shared")
_LARGEST_TURN = 0.3
"""rad; steps of one pose that turn a joint further are shortened."""


@dataclass(frozen=True)
class Rule:
    """Settings of the damping and of the stopping rule of a descent.

    damping: damping at the start.
    harder: factor that multiplies the damping after a rejected step.
    easier: factor that divides the damping after an accepted step.
    least, most: lower and upper bound of the damping.
    tries: largest number of steps tried in one iteration.
    slack: a step is accepted if new cost < slack * old cost; above 1 where the cost jumps, as that of contours does.
    moved: stop when a step is smaller than this, in the units of the problem.
    gain: stop when a step changes the cost by less than this fraction of it.
    """

    damping: float = 1e-2
    harder: float = 6.0
    easier: float = 4.0
    least: float = 1e-4
    most: float = 1e4
    tries: int = 4
    slack: float = 1.0
    moved: float = 0.0
    gain: float = 0.0


@dataclass(frozen=True)
class Descent(Generic[State, Equations]):
    """Result of a descent.

    state: last accepted state.
    cost: its cost.
    equations: its normal equations.
    damping: damping at the end.
    iterations: number of iterations.
    converged: whether it stopped before the largest number of iterations.
    """

    state: State
    cost: float
    equations: Equations
    damping: float
    iterations: int
    converged: bool


class Problem(ABC, Generic[State, Equations]):
    """Sum of robust squares over a state, the unknowns of the problem in any form (an array, a tuple of arrays).

    Subclasses implement `evaluate` and `propose`; `solve` descends.
    """

    @abstractmethod
    def evaluate(self, state: State) -> tuple[float, Callable[[], Equations]]:
        """Compute the cost of a state; return it with a function that makes the normal equations where
        they are needed.
        """

    @abstractmethod
    def propose(self, state: State, equations: Equations, damping: float) -> tuple[State, float] | None:
        """Propose another state, and how far it is in the units of Rule.moved; None: the equations are not positive
        definite.

        equations: equations of the state; damping: relative to the diagonal of the Hessian.
        """

    def solve(self, start: State, iterations: int, rule: Rule) -> Descent[State, Equations]:
        """Descend from a start.

        start: state.
        iterations: largest number of iterations.
        rule: damping and stopping rule.
        Returns: the result of the descent.
        Raises: SolverError where the cost at the start is not finite.
        """
        state, (cost, make) = start, self.evaluate(start)
        if not math.isfinite(cost):
            raise SolverError("The cost at the start is not finite; check the start and the evidence for NaN.")
        equations, damping, converged, n = make(), rule.damping, False, 0
        while n < iterations and not converged:
            n += 1
            moved, gain, accepted = math.inf, math.inf, False
            for _ in range(rule.tries):
                proposed = self.propose(state, equations, damping)
                if proposed is not None:
                    trial, moved = proposed
                    new, make = self.evaluate(trial)
                    if math.isfinite(new) and new < cost * rule.slack:
                        accepted, gain = True, abs(cost - new) / max(cost, 1e-300)
                        state, cost, equations = trial, new, make()
                        damping = max(damping / rule.easier, rule.least)
                        break
                    if moved < rule.moved:
                        break
                damping = min(damping * rule.harder, rule.most)
            converged = not accepted or moved < rule.moved or gain < rule.gain
        return Descent(state, cost, equations, damping, n, converged)


class SharedProblem(Problem[tuple[Shared, Array], SharedEquations], Generic[Shared]):
    """Problem over shared unknowns (any value, S of them) and groups (N, ...) that are coupled only through these.

    free: (S,) shared unknowns that may change.
    limited: the shared unknowns whose change is limited (default: all).
    largest: largest change of a limited unknown per step; longer steps are shortened.
    """

    free: NDArray[np.bool_]
    limited: NDArray[np.bool_] | slice = slice(None)
    largest: float = math.inf

    @abstractmethod
    def moved(self, state: tuple[Shared, Array], step: Array, own: Array) -> tuple[tuple[Shared, Array], float]:
        """Return the state after a step, and how far it moved.

        state: shared unknowns and groups' unknowns.
        step: (S,) step of the shared unknowns.
        own: (N, n) steps of the groups.
        """

    def propose(
        self, state: tuple[Shared, Array], equations: SharedEquations, damping: float
    ) -> tuple[tuple[Shared, Array], float] | None:
        """Eliminate the groups, and compute the step from a state; see `Problem`.

        equations: normal equations at the state; damping: relative to the diagonal.
        """
        reduced = equations.reduced(damping)
        step = reduced.step(self.free)
        if step is None:
            return None
        step *= min(1.0, self.largest / max(float(np.abs(step[self.limited]).max(initial=0.0)), 1e-9))
        return self.moved(state, step, reduced.own_steps(step))


@dataclass(frozen=True)
class Quadratic:
    """Prior on a pose: the cost 1/2 sum_d weight_d (q_d - centre_d)^2.

    centre: (D,) pose.
    weight: (D,) inverse variances, not negative.

    Balls are compared by the components of their rotation vectors; the root's centre is moved to the branch nearest to
    the start.
    """

    centre: Array
    weight: Array


class Rows(NamedTuple):
    """R linearised residuals of points of a body in one frame.

    carrier: (R, 3) the three carriers of each point: index of a vertex of the scoring mesh, or V + index of a joint.
    share: (R, 3) share of each carrier.
    point: (R, 3) m, world.
    slope: (R, 3) derivative of the residual by the point.
    residual: (R,) residuals, in the unit of the cue (px, m).
    weight: (R,) weight of the squared residual, the derivative of the loss included.
    view: (R,) camera of the residual.
    cost: robust cost of all residuals, including those without a row.
    """

    carrier: NDArray[np.int64]
    share: Array
    point: Array
    slope: Array
    residual: Array
    weight: Array
    view: NDArray[np.int64]
    cost: float

    @staticmethod
    def joined(parts: Iterable[Rows]) -> Rows:
        """Join the rows of several cues or views."""
        three, one, none = np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
        every = [Rows(np.zeros((0, 3), np.int64), three, three, three, one, one, none, 0.0), *parts]
        *fields, costs = zip(*every, strict=True)
        return Rows._make([*(np.concatenate(field) for field in fields), sum(costs)])

    def by_pose(self, twists: Array, moves: Array) -> Array:
        """Compute the derivatives (R, D) of the residuals by a pose.

        twists: (D, 6) world twists of the pose.
        moves: (V + J, D) share of a dof's motion at each carrier.
        """
        wrench = np.concatenate([np.cross(self.point, self.slope), self.slope], 1)
        return (wrench @ twists.T) * (self._blend(self.share, 1, len(moves)) @ moves)

    def by_vertices(self, slopes: Array) -> Array:
        """Compute the derivatives (R, K) by K parameters that move the vertices by slopes (V, 3, K); joints do not
        move.
        """
        vertices = len(slopes)
        share = np.where(self.carrier < vertices, self.share, 0.0)
        where = self._replace(carrier=np.minimum(self.carrier, vertices - 1))
        weights = share[:, :, None] * self.slope[:, None]
        return np.asarray(where._blend(weights, 3, 3 * vertices) @ slopes.reshape(3 * vertices, -1))

    def _blend(self, weights: Array, size: int, columns: int) -> Any:
        """Make the sparse matrix (R, columns) with these weights in the `size` columns of each carrier."""
        from scipy.sparse import csr_array  # takes long to import

        index = (size * self.carrier[..., None] + np.arange(size)).reshape(-1, 3 * size)
        first = np.arange(len(index) + 1) * (3 * size)
        return csr_array((weights.ravel(), index.ravel(), first), (len(index), columns))


@dataclass(frozen=True)
class Posed:
    """Body in one frame.

    body: the body.
    pose: (D,) pose vector, rad and m.
    vertices: (V, 3) m of its scoring mesh in the world.
    """

    body: Body
    pose: Array
    vertices: Array

    @property
    def mesh(self) -> Mesh:
        """Coarse mesh of the body, which is compared with masks."""
        return self.body.coarse

    @cached_property
    def normals(self) -> tuple[Array, Array]:
        """Unit outward normals of the faces (F, 3) and of the vertices (V, 3)."""
        faces = np.asarray(self.mesh.faces)
        corner = self.vertices[faces]
        across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        smooth = np.zeros_like(self.vertices)
        for k in range(3):
            np.add.at(smooth, faces[:, k], across)
        flat, round_ = (n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12) for n in (across, smooth))
        return flat, round_


Cue = Callable[[Posed, Shared, float], Iterable[Rows]]
"""Function that computes the rows of a cue of one frame: of a posed body, the shared unknowns, and a factor of its
robust scale.
"""


class PoseProblem(SharedProblem[Shared]):
    """Problem over poses (F, D) of one body and unknowns that its frames share (shape or cameras), defined by
    subclasses.

    body: the template body.
    frames: cues of each frame.
    priors: quadratic costs on every pose, centre (D,) or (F, D).

    The state is (shared unknowns, poses); steps are added to rotation vectors as to plain numbers.
    """

    def __init__(self, body: Body, frames: Sequence[Sequence[Cue[Shared]]], priors: Sequence[Quadratic]) -> None:
        marks = Landmarks((), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        body.coarse.edges  # noqa: B018 - built once, shared by all deformed copies
        self.template = replace(body, fine=body.coarse, landmarks=marks)
        self.frames, self.priors, self.factor = frames, priors, 1.0
        moves = body.skeleton.moves.T.astype(np.float64)
        self.moves = np.concatenate([body.coarse.dense_weights(len(moves)) @ moves, moves])

    def body(self, shared: Shared) -> Body:
        """Return the body for the shared unknowns."""
        return self.template

    @abstractmethod
    def shared_cost(self, shared: Shared, body: Body) -> float:
        """Compute the cost of the prior on the shared unknowns."""

    @abstractmethod
    def shared_rows(
        self, shared: Shared, posed: Sequence[Posed], rows: Sequence[Rows]
    ) -> tuple[Array, Array, Sequence[Array]]:
        """Compute the matrix (S, S) and gradient (S,) of `shared_cost`, and the derivatives (R, S) of each frame's rows
        by the shared unknowns.
        """

    @abstractmethod
    def shared_moved(self, shared: Shared, step: Array) -> Shared:
        """Return the shared unknowns after a step (S,)."""

    def evaluate(self, state: tuple[Shared, Array]) -> tuple[float, Callable[[], SharedEquations]]:
        """Compute the cost of a state from all cues; return it with a function that linearises the cues and makes
        the normal equations.
        """
        shared, q = state
        body = self.body(shared)
        posed = [Posed(body, pose, vertices) for pose, vertices in zip(q, body.skin(q), strict=True)]
        rows = [
            Rows.joined(r for cue in cues for r in cue(at, shared, self.factor))
            for at, cues in zip(posed, self.frames, strict=True)
        ]
        held = [(q - prior.centre, prior.weight) for prior in self.priors]
        cost = self.shared_cost(shared, body) + sum(r.cost for r in rows)
        cost += 0.5 * sum(float((weight * off**2).sum()) for off, weight in held)

        def equations() -> SharedEquations:
            hessian, gradient, by_shared = self.shared_rows(shared, posed, rows)
            (n, dof), twists = q.shape, body.skeleton.world_twists(q)
            own = np.tile(np.diag(sum((weight for _, weight in held), np.zeros(dof))), (n, 1, 1))
            pull = sum((weight * off for off, weight in held), np.zeros((n, dof)))
            cross = np.empty((n, dof, len(gradient)))
            for f, r in enumerate(rows):
                jacobian = np.concatenate([r.by_pose(twists[f], self.moves), by_shared[f]], 1)
                h, g = weighted_squares(jacobian, r.weight, r.residual)
                own[f] += h[:dof, :dof]
                pull[f] += g[:dof]
                cross[f] = h[:dof, dof:]
                hessian += h[dof:, dof:]
                gradient += g[dof:]
            return SharedEquations(hessian, gradient, own, pull, cross)

        return float(cost), equations

    def moved(self, state: tuple[Shared, Array], step: Array, own: Array) -> tuple[tuple[Shared, Array], float]:
        """Return the state after a step, with poses clamped to the joint limits; see `SharedProblem`."""
        shared, q = state
        own *= np.minimum(1, _LARGEST_TURN / np.maximum(np.abs(own[:, 3:]).max(1, keepdims=True), 1e-9))
        far = max(float(np.abs(step).max(initial=0.0)), float(np.abs(own).max()) / 20)
        return (self.shared_moved(shared, step), self.template.skeleton.clamp(q + own)), far

    def stages(
        self, start: tuple[Shared, Array], factors: Sequence[float], iterations: Sequence[int], moved: float
    ) -> Descent[tuple[Shared, Array], SharedEquations]:
        """Solve with one factor of the robust scales after the other, the coarsest first.

        start: (shared unknowns, poses).
        factors: factors of the robust scales.
        iterations: largest number per factor.
        moved: stop when a step is smaller than this.
        """
        found, state = None, start
        for self.factor, n in zip(factors, iterations, strict=True):
            # contour costs jump when the outline changes
            found = self.solve(state, n, Rule(slack=1.002, moved=moved))
            state = found.state
        assert found is not None
        return found
