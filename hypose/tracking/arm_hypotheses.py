"""Keep alternative poses of the arms (rivals) from frame to frame, in addition to the estimate.

A lost arm is visible in the masks, but its true pose overlaps them better only after the rest of the body, which has
adapted to the wrong arm, is solved again. So the arms that a table of reach finds in the masks are solved before they
are compared, and a few that are nearly as good are kept, each with its own history, until later frames decide.
Source: pruned multiple hypotheses as in Sminchisescu & Triggs 2001; the scores and the table are hypose's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hypose.compute import reach
from hypose.compute.threads import in_background, in_threads
from hypose.evidence.cues import PoseMemory
from hypose.evidence.terms import Evidence, PointTerm
from hypose.fitting.articulated import PoseFit, SolveSettings
from hypose.geometry import Array
from hypose.inference.hypotheses import BEFORE, FOUND_BY, Hypotheses
from hypose.inference.resampling import distinct
from hypose.tracking.arm_workspace import ArmReach, arm_ends, ends
from hypose.tracking.frame_evidence import PreparedFrame, frame_energy, limb_energy
from hypose.tracking.part_colours import ColourSettings, colour_scores, known_colours, pictured_arms
from hypose.tracking.refinement import COMPOSITE, RIVAL, SOLVED, keep_fits, member, mismatch, refine, solve_poses

_SOLVE, _LOOK = "rivals solved", "arms looked up"
"""Keys in a frame's `shared` of what was started in the background while other layers run."""

SEARCH_ROLES = tuple(FOUND_BY + name for name in ("limb search", "arm table", "old rival"))
"""Roles that name the origin of a hypothesis."""

DEPTH_KEEPS = 2
"""largest number of hypotheses kept with depth cameras, which leave less undecided; a third one is no gain there.
Chosen on the seeds 0 to 29 (benchmark `depth`)."""


@dataclass(frozen=True)
class LookedUp:
    """Settings that choose which arm poses of a table (`ArmReach`) become rivals, alternative poses of an arm.
    Lengths are displacements of elbow, wrist or hand, m.

    cutoff: amount by which the score of an arm may be worse than that of the current arm, m^2.
    pool: largest number of arm poses of the table that are compared in full.
    far: least distance from the current arm and from each other.
    ratio: largest energy relative to the current one, before solving.
    most: largest number of rivals per arm.
    Chosen on scenes (walk, box, run, combo) of the seeds 500 to 507; 520 to 525 gave the same.
    """

    cutoff: float = 0.1
    pool: int = 192
    far: float = 0.1
    ratio: float = 1.04
    most: int = 2


@dataclass(frozen=True)
class Contest:
    """Settings for comparing hypotheses over time; chosen on the same scenes as LookedUp.

    memory: share of the score of the last frame that is added to the score of this frame.
    doubt: penalty of a new rival, as a multiple of the estimate's mismatch.
    apart: arms nearer than this are one hypothesis, m.
    behind: largest amount by which the mismatch of a kept hypothesis may exceed that of the best one, as a share of
        it.
    softness: score difference that corresponds to a log-weight of 1.
    """

    memory: float = 0.8
    doubt: float = 0.02
    apart: float = 0.08
    behind: float = 0.15
    softness: float = 0.005


@dataclass(frozen=True)
class RefineRivals:
    """Kernel that solves alternative arms and keeps the best hypotheses: the estimate (role SOLVED) and its RIVALs.

    It solves the result of the limb search, arms found in a table, and the rivals of the last frame from their own
    predictions; then it compares their scores. In the result the log-weights are the scores, the origins are the
    parents, and the column `before` is each hypothesis' pose in the last frame (of its parent, without motion for an
    arm found elsewhere).
    arms: tables of reach, each with a function that decides when it is searched.
    keep: largest number of hypotheses.
    options: settings of solves from a prediction.
    near: settings of solves whose start is near the solution.
    with_depth: settings of all solves where there are depth cameras.
    margin: share of the energy that the limb search must gain before its result is solved.
    look: choice of arms from the table; contest: comparison of hypotheses; colours: comparison by pictures.
    """

    arms: tuple[tuple[ArmReach, Callable[[Hypotheses, PreparedFrame], bool]], ...]
    keep: int = 3
    options: SolveSettings = SolveSettings()
    near: SolveSettings = SolveSettings(iterations=5, coarse_iterations=0)
    with_depth: SolveSettings = SolveSettings(iterations=4, coarse_iterations=0)
    margin: float = 0.02
    look: LookedUp = LookedUp()
    contest: Contest = Contest()
    colours: ColourSettings = ColourSettings()

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Compute the hypotheses that are kept, best first."""
        s, c = frame.body.skeleton, self.contest
        winner, alive = member(h, SOLVED), _best_first(frame)
        last = alive.columns[BEFORE]
        if not frame.silhouettes.seen:  # without masks hypotheses cannot be compared
            return _roles(Hypotheses(s.clamp(winner[None]), np.zeros(1), columns={BEFORE: last[:1]}))
        old = s.on_branch(alive.values[1:], frame.prediction)
        composite = self._composite(h, winner, frame)
        looked_up = frame.shared.pop(_LOOK, partial(self._looked_up, h, winner, old, frame))()
        starts = [*composite, *looked_up]
        poses = np.stack([winner, *self._solved(starts, old, frame)])
        parents = np.array([0] * (1 + len(starts)) + [1 + k for k in range(len(old))])
        fresh = np.zeros(len(poses), np.bool_)
        fresh[1 + len(composite) : 1 + len(starts)] = True
        expected = np.stack([*[frame.prediction] * (1 + len(starts)), *old])
        poses, costs, colours = self._by_pictures(poses, expected, frame, rng)
        scores = (
            costs + colours + c.doubt * costs[0] * fresh - c.memory * c.softness * alive.relative_log_weights[parents]
        )
        at = arm_ends([arm for arm, _ in self.arms], poses)
        before = last[parents]
        for k, (arm, _) in enumerate(self.arms):
            jumped = fresh & (_farthest(at[:, k], at[0, k]) > self.look.far)
            before[np.ix_(jumped, arm.own)] = poses[np.ix_(jumped, arm.own)]
        found = Hypotheses(s.clamp(poses), -scores / c.softness, parents, columns={BEFORE: before})
        row = 1
        for role, of in zip(SEARCH_ROLES, (composite, looked_up, old), strict=True):
            found = found.marked(role, np.arange(row, row + len(of)))
            row += len(of)
        living = self._living(scores, costs, at.reshape(len(poses), -1, 3), frame)
        return _roles(found.take(living))

    def before_solve(self, frame: PreparedFrame, /) -> None:
        """Start solving the rivals of the last frame in the background.

        frame: prepared frame; its `shared` gets the running solves, one per rival.
        """
        if frame.silhouettes.seen and frame.rivals is not None:
            for q in frame.body.skeleton.on_branch(_best_first(frame).values[1:], frame.prediction):
                frame.shared[_SOLVE, q.tobytes()] = in_background(partial(self._solved_rival, q, frame))

    def before_search(self, h: Hypotheses, frame: PreparedFrame, /) -> None:
        """Start the search of the arm tables in the background.

        h: hypotheses after the first solve, of which one has the role SOLVED; frame: prepared frame; its `shared`
            gets the running search.
        """
        if frame.silhouettes.seen and frame.rivals is not None:
            old = frame.body.skeleton.on_branch(_best_first(frame).values[1:], frame.prediction)
            frame.shared[_LOOK] = in_background(partial(self._looked_up, h, member(h, SOLVED), old, frame))

    def _by_pictures(
        self, poses: Array, expected: Array, frame: PreparedFrame, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Score poses (N, D) by masks and pictures, and move the arms of the best ones to where the pictures show them.

        expected: (N, D) pose expected of each.
        Returns: poses (N, D); mismatches (N,); scores of the pictures (N,), low is good.
        """
        costs = mismatch(poses, frame, expected=expected)
        said = self.colours.weight * colour_scores(poses, frame, self.colours)
        # key points are more accurate on hands
        given = frame.keypoints.seen or any(isinstance(term, PointTerm) for term in frame.terms)
        if given or known_colours(frame, self.colours) is None:
            return poses, costs, said
        arms = [arm for arm, _ in self.arms]
        poses, costs, said = poses.copy(), costs.copy(), said.copy()
        for n in np.argsort(costs + said, kind="stable")[: self.colours.tried].tolist():
            found = pictured_arms(arms, poses[n], frame, self.colours, rng)
            if found is None:
                continue
            seen = *frame.evidence, Evidence(np.zeros(0, np.bool_), (found[1],))
            own = replace(frame, evidence=seen, prediction=expected[n], fits=PoseMemory())
            pose = refine(frame.body, found[0][None], own, self.near)[0].pose
            cost = mismatch(pose[None], frame, expected=expected[n][None])[0]
            say = self.colours.weight * colour_scores(pose[None], frame, self.colours)[0]
            if cost + say < costs[n] + said[n]:
                poses[n], costs[n], said[n] = pose, cost, say
        return poses, costs, said

    def _composite(self, h: Hypotheses, winner: Array, frame: PreparedFrame) -> list[Array]:
        """Return the pose (D,) that the limb search put together, in a list; an empty list where it gained too little.

        h: hypotheses after the limb search; winner: (D,) pose of the first solve.
        """
        composite = member(h, COMPOSITE) if h.has(COMPOSITE).any() else winner
        if np.array_equal(winner, composite):
            return []
        energy = frame_energy(np.stack([winner, composite]), frame)
        return [composite] if energy[1] < (1 - self.margin) * energy[0] else []

    def _looked_up(self, h: Hypotheses, winner: Array, old: Array, frame: PreparedFrame) -> list[Array]:
        """Find poses (D,) with one arm elsewhere than in the winner, from the tables.

        h: hypotheses after the limb search; winner: (D,).
        old: (K, D) predicted rivals, which are solved anyway; arms near theirs are left out.
        """
        found: list[Array] = []
        for arm, turn in self.arms:
            if turn(h, frame):
                found += rival_arms(arm, winner, frame, self.look, old)
        return found

    def _solved(self, starts: list[Array], old: Array, frame: PreparedFrame) -> list[Array]:
        """Solve from the starts and from the predictions (K, D) of the rivals, in several threads; return the poses
        (D,).

        starts: poses (D,), solved from near their end; old: (K, D) predicted rivals, solved from their own predictions.
        """
        near = self.with_depth if frame.depth.seen else self.near
        tasks = [partial(solve_poses, frame.body, q[None], frame, near) for q in starts]
        tasks += [frame.shared.pop((_SOLVE, q.tobytes()), partial(self._solved_rival, q, frame)) for q in old]
        fits = in_threads(lambda task: task()[0], tasks)
        keep_fits(frame, fits)
        return [fit.pose for fit in fits]

    def _solved_rival(self, q: Array, frame: PreparedFrame) -> list[PoseFit]:
        """Solve a rival from its predicted pose (D,).

        Returns: one fit.
        """
        options = self.with_depth if frame.depth.seen else self.options
        return solve_poses(frame.body, q[None], replace(frame, prediction=q), options)

    def _living(self, scores: Array, costs: Array, at: Array, frame: PreparedFrame) -> list[int]:
        """Choose the hypotheses that are kept, best first: arms (E, 3) elsewhere, scores not far behind the best.

        scores: (N,) low is good; costs: (N,) mismatches; at: (N, E, 3) ends of the arms, m. Returns: indices.
        """
        order = np.argsort(scores, kind="stable")
        near = order[scores[order] - scores[order[0]] <= self.contest.behind * costs[order]]
        count = min(self.keep, DEPTH_KEEPS) if frame.depth.seen else self.keep
        return near[distinct(at[near], count, self.contest.apart)].tolist()


@dataclass(frozen=True)
class SolvePrediction:
    """Search kernel that solves a pose from the prediction and sets all hypotheses to the solution, as the start of
    a search of single limbs.

    One hypothesis gets the role SOLVED, another COMPOSITE, to which the search adds limb by limb.
    rivals: kernel of a later layer, of which parts run in parallel with this one and the next ones.
    """

    options: SolveSettings
    rivals: RefineRivals

    def __call__(self, h: Hypotheses, frame: PreparedFrame, rng: np.random.Generator, /) -> Hypotheses:
        """Return the set with all hypotheses at the solved pose."""
        self.rivals.before_solve(frame)
        pose = refine(frame.body, frame.prediction[None], frame, self.options)[0].pose
        moved = h.at(np.repeat(pose[None], h.count, 0)).marked(SOLVED, [0]).marked(COMPOSITE, [min(1, h.count - 1)])
        self.rivals.before_search(moved, frame)
        return moved


def rival_arms(
    arm: ArmReach, pose: Array, frame: PreparedFrame, look: LookedUp, known: Array | None = None
) -> list[Array]:
    """Find poses that differ from a pose in one arm only; the new arm covers parts of the masks that the body does
    not cover yet.

    arm: table of the arm; frame: prepared; look: limits of the choice.
    pose: (D,) current pose.
    known: (K, D) poses whose arm is not to be found again (default: `pose`).
    Returns: poses (D,), at most look.most; none where depth cameras show the arm as it is in the pose.
    """
    body, standing = frame.body, None
    if frame.depth.seen:
        standing = frame.depth.standing(body, pose, arm.moving)
        if frame.depth.shows_arm(body, standing, arm.chain[0]):
            return []
    there = arm.here(pose[None] if known is None else np.concatenate([pose[None], known]))
    here = there[:1]
    rest = reach.standing(pose, body.skeleton.tree, body.coarse.arrays, frame.silhouettes.masks, arm.moving)
    limit = arm.score(here, pose, frame, rest, np.inf)[0] + look.cutoff
    score = arm.score(arm.points, pose, frame, rest, limit)
    good = np.flatnonzero(score <= limit)
    good = _apart(arm.ends, good[np.argsort(score[good], kind="stable")], ends(there), look)
    if not len(good):
        return []
    poses = np.repeat(pose[None], len(good) + 1, 0)
    poses[1:, arm.own] = arm.poses[good]  # the first one stays unchanged
    energy = limb_energy(poses, frame, arm.moving, rest, look.ratio, standing)
    order = np.argsort(energy[1:], kind="stable")
    order = order[energy[1 + order] <= look.ratio * energy[0]]
    return [poses[1 + n] for n in order[distinct(arm.ends[good][order], look.most, look.far)]]


def _apart(at: Array, order: NDArray[np.intp], known: Array, look: LookedUp) -> NDArray[np.intp]:
    """Select the first `pool` arms in an order whose ends (N, E, 3) are all far from the known ones (K, E, 3).

    at: ends of all arms of the table; order: their indices, best first; known: (K, E, 3).
    Only as many are examined as necessary.
    """
    found = [order[:0]]
    while len(order) and sum(map(len, found)) < look.pool:
        some, order = order[: 2 * look.pool], order[2 * look.pool :]
        for other in known:
            some = some[_farthest(at[some], other) > look.far]
        found.append(some)
    return np.concatenate(found)[: look.pool]


def _farthest(ends: Array, other: Array) -> Array:
    """Compute the largest distance (N,), m, between corresponding ends (N, E, 3) and (E, 3)."""
    d = ends - other
    d *= d  # numpy's reductions of three numbers take five times as long
    return np.sqrt((d[..., 0] + d[..., 1] + d[..., 2]).max(-1))


def _best_first(frame: PreparedFrame) -> Hypotheses:
    """Return the hypotheses of the last frame, best first and predicted into this frame.

    frame: prepared, with `rivals`, whose column `before` has their last poses.
    """
    assert frame.rivals is not None, "the recipe does not say how many rivals"
    return frame.rivals.take(np.argsort(-frame.rivals.relative_log_weights, kind="stable"))


def _roles(h: Hypotheses) -> Hypotheses:
    """Mark the first hypothesis as the estimate and the others as its rivals."""
    return h.marked(SOLVED, [0]).marked(RIVAL, np.arange(1, h.count))
