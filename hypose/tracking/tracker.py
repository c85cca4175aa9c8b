"""Track a person one frame at a time, from evidence to a pose with its uncertainty; detect a loss and recover.

Tracker and state are values: `step` returns the next state, so a run can be stopped after any frame, saved, and resumed
with the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.body.motion import Modes, Motion, joined_modes, modes_arrays, sd_per_axis
from hypose.errors import InputError
from hypose.evidence.cues import OwnEvidence
from hypose.evidence.frame import Frame
from hypose.geometry import Array
from hypose.inference.hypotheses import BEFORE, FOUND_BY, Hypotheses
from hypose.inference.layer import Memory, Recipe, Recovery, search, stand_still, stream
from hypose.tracking.frame_evidence import KeypointModel, PreparedFrame, agreement, mean_overlap, prepare, view_count
from hypose.tracking.refinement import PoseUncertainty, packed, uncertainty_of_set

RECOVERED = f"{FOUND_BY}recovery"
"""Origin of an estimate that was found after a loss."""
BETWEEN_FRAMES, RECOVERY, START = -1, -2, -3
"""Layer numbers of the random streams used outside a recipe's layers."""
_NO_PERSON = 0.3
"""Share of the usual mean IoU below which the masks show no person at the body's place, or only the rim of another
person."""
_LOOSE, FOUND, _LOOKS = 0.75, 0.1, 4
"""_LOOSE: mean IoU below which a body may be lost whatever is usual, since an error from the start sets the usual
value.
FOUND: gain in IoU that proves it, the same as for turning around. _LOOKS: searches for a rival per such test, which
    takes
longer.
"""
RIVAL_WITH_DEPTH = 2
"""factor on the time between two searches for a rival with depth cameras: a body that stands back to front does not fit
the depth. Chosen on the seeds 0 to 15 (benchmark `depth`)."""
_COLUMN, _MODES, _MEMORY = "column_", "modes_", "memory_"


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of a tracker.

    evidence: 'silhouettes', 'keypoints' or 'both'; with the picture of one camera also 'edges' (nothing else) and
        'auto' (all there is).
    seed: seed of every random draw.
    frame_rate: Hz.
    prediction_weight: pull of a solve to the prediction at 25 fps; it grows with the square of the frame rate, as the
        prediction's error shrinks.
    lost_share, lost_floor: lost when the mean IoU falls below this share of its usual value, or below this value.
    contour_weight: weight of one residual of a contour.
    keypoint_scale_px: noise of key points where it is not measured, px.
    extrapolate: s without evidence after which the person counts as lost.
    rival_every: s between two searches for a rival pose (left and right exchanged).
    """

    evidence: str = "silhouettes"
    seed: int = 0
    frame_rate: float = 25.0
    prediction_weight: float = 0.1
    lost_share: float = 0.6
    lost_floor: float = 0.25
    contour_weight: float = 0.05
    keypoint_scale_px: float = 8.0
    extrapolate: float = 1.0
    rival_every: float = 0.5


@dataclass(frozen=True)
class FrameEstimate:
    """Result of one frame.

    pose: (D,) pose vector, rad and m; uncertainty: uncertainty of the pose and its joints.
    cost: 1 - `agreement` with the masks; NaN without masks.
    lost: the person is lost; extrapolated: there was no evidence; n_views: number of views with evidence.
    overlap: (C,) IoU of the body with each view's mask, NaN where not usable; empty when not computed.
    exchanged: gain in overlap of a rival (the body with its sides exchanged), or of the recovered pose over the lost
        one; NaN when not tested.
    seen: (C, 3) statistics of each view (`hypose.pipeline.frame_anomalies.view_statistics`); (0, 3) when not
        computed.
    audit: (J, A) evidence for and against each joint (hypose.tracking.joint_features); (0, 0) when not computed.
    rivals: (K, D), rival_weights: (K,) other poses that the evidence allows, as in `Motion`.
    origin: role of the best hypothesis, RECOVERED, or empty where the first solve was the best.
    moved: (J,) distance by which the search moved each joint from the first solve, or the recovery moved it from the
        lost pose, m; (0,) unknown.
    """

    pose: Array
    uncertainty: PoseUncertainty
    cost: float
    lost: bool
    extrapolated: bool
    n_views: int
    overlap: Array = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)
    exchanged: float = float("nan")
    seen: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    audit: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    rivals: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    rival_weights: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    origin: str = ""
    moved: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))

    @property
    def joint_sd(self) -> Array:
        """Standard deviations (J,) of the joints, m per axis."""
        return sd_per_axis(self.uncertainty.joint_covariance)


@dataclass(frozen=True)
class TrackerState:
    """State of a tracker between two frames.

    frames: number of frames done.
    hypotheses: the set after the last frame.
    pose, previous: (D,) pose of the last frame and of the frame before it.
    joint_covariance: (J, 3, 3) covariance of each joint centre, m^2.
    usual_iou: running mean of the IoU while not lost; NaN before the first.
    blind: number of frames since the last evidence; lost: the person was lost in the last frame.
    memory: additional state of the recipe.
    """

    frames: int
    hypotheses: Hypotheses
    pose: Array
    previous: Array
    joint_covariance: NDArray[np.float32]
    usual_iou: float
    blind: int
    lost: bool
    memory: Memory = field(default_factory=dict)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Convert the state to plain arrays for a checkpoint."""
        return {
            "frames": np.array(self.frames),
            "values": self.hypotheses.values,
            "log_weights": self.hypotheses.log_weights,
            "origin": self.hypotheses.origin,
            "role": self.hypotheses.role,
            "role_names": np.array(self.hypotheses.role_names, dtype=np.str_),
            "pose": self.pose,
            "previous": self.previous,
            "joint_covariance": self.joint_covariance,
            "usual_iou": np.array(self.usual_iou),
            "blind": np.array(self.blind),
            "lost": np.array(self.lost),
            **{f"{_COLUMN}{name}": column for name, column in self.hypotheses.columns.items()},
            **{f"{_MEMORY}{name}": array for name, array in self.memory.items()},
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray]) -> TrackerState:
        """Restore the state from the arrays of `to_arrays`."""
        names = tuple(arrays["role_names"].tolist())
        columns = {k.removeprefix(_COLUMN): v for k, v in arrays.items() if k.startswith(_COLUMN)}
        h = Hypotheses(
            arrays["values"], arrays["log_weights"], arrays["origin"], arrays["role"], names, columns=columns
        )
        return TrackerState(
            int(arrays["frames"]),
            h,
            arrays["pose"],
            arrays["previous"],
            arrays["joint_covariance"],
            float(arrays["usual_iou"]),
            int(arrays["blind"]),
            bool(arrays["lost"]),
            {k.removeprefix(_MEMORY): v for k, v in arrays.items() if k.startswith(_MEMORY)},
        )


@dataclass(frozen=True)
class Tracker:
    """Tracker of one person.

    body: the person's body; recipe: the method; settings: settings of the tracker.
    keypoints_on_body: where key points sit on the body.
    own: additional evidence that a user defined.
    Raises: InputError where the recipe needs evidence that the settings leave out.
    """

    body: Body
    recipe: Recipe
    settings: TrackerSettings = TrackerSettings()
    keypoints_on_body: KeypointModel | None = None
    own: Sequence[OwnEvidence] = ()

    def __post_init__(self) -> None:
        for kind in ("silhouettes", "keypoints"):
            if kind in self.recipe.needs and self.settings.evidence not in (kind, "both"):
                raise InputError(
                    f"The recipe {self.recipe.name!r} needs {kind}; choose the evidence {kind!r} or 'both', or another "
                    "recipe."
                )
        if "picture" in self.recipe.needs and self.own:
            raise InputError(f"The recipe {self.recipe.name!r} uses one picture only; leave out evidence of your own.")

    def start(self, begin: Array | Hypotheses, memory: Memory | None = None) -> TrackerState:
        """Build the state before the first frame.

        begin: start pose (D,), around which the set is scattered, or alternative starts as hypotheses.
        memory: what the recipe has remembered of the same person.
        Raises: InputError where a pose has the wrong number of values or is not finite.
        """
        s = self.body.skeleton
        given = begin.values if isinstance(begin, Hypotheses) else begin
        if np.shape(given)[-1:] != (s.dof,) or not np.isfinite(given).all():
            raise InputError(f"A start needs {s.dof} finite numbers per pose, got {np.shape(given)}; fit it again.")
        if isinstance(begin, Hypotheses):
            h, pose = begin, begin.best()
        else:
            pose = s.canonical(s.clamp(begin))
            h = self._around(pose, 0.5, stream(self.settings.seed, 0, START))
        unknown = np.full((len(s.joint_names), 3, 3), np.nan, np.float32)
        return TrackerState(0, h, pose, pose, unknown, float("nan"), 0, False, memory or {})

    def follow(self, state: TrackerState, frames: Iterable[Frame]) -> Iterator[tuple[TrackerState, FrameEstimate]]:
        """Track frames in order; yield the state and the estimate after each."""
        for frame in frames:
            state, estimate = self.step(state, frame)
            yield state, estimate

    def step(self, state: TrackerState, frame: Frame) -> tuple[TrackerState, FrameEstimate]:
        """Track one frame: predict, search, judge, and recover when lost.

        state: after the previous frame.
        Returns: the state after this frame; the estimate of this frame.
        """
        recipe = self.recipe
        state, step = self._ahead(state)
        prediction = self._within(state.pose + step)
        prepared = replace(self.prepare_frame(frame, prediction, state), memory=state.memory)
        if not prepared.usable:
            return self._extrapolate(state, prediction, self._expected(state, step))
        if state.frames == 0:
            prepared, state = self._begin(prepared, state)
            step = np.zeros_like(step)
        h = self._expected(state, step)
        if recipe.rivals:  # particles are drawn around the best of them
            best = h.take(np.repeat(h.relative_log_weights.argmax(), recipe.particles)).equal()
            h, prepared = replace(best, columns={}), replace(prepared, rivals=h)
        result = search(h, recipe, prepared, partial(stream, self.settings.seed, frame.index))
        pose, selected = self._within(result.estimate), result.resampled
        searched = pose
        iou = agreement(self.body, pose, prepared)
        lost = self._is_lost(iou, state.usual_iou)
        if recipe.lost is not None:
            lost = recipe.lost(pose, result.weighted, prepared)
        gain = float("nan")
        if recipe.recover is not None and prepared.silhouettes.seen:
            state, pose, selected, iou, lost, gain = self._recover(recipe.recover, state, pose, selected, iou, prepared)
        known = (recipe.uncertainty or uncertainty_of_set)(pose, result.weighted, prepared)
        usual = state.usual_iou
        if not lost and np.isfinite(iou):
            usual = iou if np.isnan(usual) else usual + 0.1 * (iou - usual)
        before = selected.columns.get(BEFORE)
        last = state.pose if before is None else before[selected.relative_log_weights.argmax()]
        memory = state.memory
        if recipe.learn is not None and not lost:
            memory = recipe.learn(memory, pose, selected, prepared)
        following = TrackerState(state.frames + 1, selected, pose, last, known.joint_covariance, usual, 0, lost, memory)
        cost = 1 - iou if np.isfinite(iou) else float("nan")
        overlap = prepared.silhouettes.overlap(self.body, pose)
        recovered, held = bool(np.isfinite(gain)), lost and pose is not searched
        look, seldom = recipe.recover and recipe.recover.rival, RIVAL_WITH_DEPTH if prepared.depth.seen else 1
        if look is not None and not lost and np.isnan(gain) and prepared.silhouettes.seen:
            gain = look(pose, prepared)[0] if self._has_look(state, seldom) else gain
        rivals, weights = self._rivals(None if lost else selected)
        views = view_count(prepared)
        # a person who is not there keeps the last pose, with the hypotheses of before
        by = "" if held else selected.found_by(int(selected.relative_log_weights.argmax()))
        joints = self.body.joints(np.stack([searched if recovered else result.first, pose]))
        moved = np.linalg.norm(joints[1] - joints[0], axis=-1).astype(np.float32)[: None if recipe.rivals else 0]
        known_of = {
            "rivals": rivals,
            "rival_weights": weights,
            "origin": RECOVERED if recovered else by,
            "moved": moved,
        }
        return following, FrameEstimate(pose, known, cost, lost, False, views, overlap, gain, **known_of)

    def predicted(self, state: TrackerState) -> Array:
        """Predict the pose (D,) of the next frame from the state after the last one."""
        state, step = self._ahead(state)
        return self._within(state.pose + step)

    def _ahead(self, state: TrackerState) -> tuple[TrackerState, Array]:
        """Put the state's rotation vectors on the canonical branch of its pose, and predict the next step (D,).

        Recipes that do not predict keep their state, because a velocity belongs to the branch that it was seen on.
        """
        s, predict = self.body.skeleton, self.recipe.predict
        alone = np.zeros(s.dof)
        if predict is None:
            return state, alone
        pose = s.canonical(state.pose)
        previous, h = s.on_branch(state.previous, pose), state.hypotheses
        state = replace(state, pose=pose, previous=previous, hypotheses=h.at(s.on_branch(h.values, pose)))
        # after a loss the last step is not a motion of the person
        return state, predict(alone if state.lost else pose - previous, state.blind)

    def _recover(
        self, how: Recovery, state: TrackerState, pose: Array, selected: Hypotheses, iou: float, prepared: PreparedFrame
    ) -> tuple[TrackerState, Array, Hypotheses, float, bool, float]:
        """Search for a lost person.

        how: search of the recipe; pose: (D,) estimate of the search; selected: its set; iou: its agreement with the
            masks; prepared: the frame.
        Returns: the state before the frame, the pose (D,) in it, the set to go on with, the pose's IoU, whether it is
            lost, and the gain in IoU where a lost person was found (else NaN).
        """
        lost, gain = self._is_lost(iou, state.usual_iou), float("nan")
        known = lost or state.lost or state.blind > 2
        looks = np.isfinite(iou) and self._has_look(state, _LOOKS)
        loose = looks and mean_overlap(self.body, pose, prepared) < _LOOSE
        if known or loose:
            found = how.find(pose, state.pose, prepared)
            found_iou = agreement(self.body, found, prepared)
            # where the masks show no person, accept only a whole person: not the rim of another person's hull
            cut_off = self._no_person(iou, state.usual_iou) and self._is_lost(found_iou, state.usual_iou)
            if found_iou > iou + (0.02 if known else FOUND) and not cut_off:
                pose, iou, gain = found, found_iou, found_iou - iou
                selected = self._around(pose, 1.0, stream(self.settings.seed, prepared.frame.index, RECOVERY))
                lost = self._is_lost(iou, state.usual_iou)
                state = replace(state, pose=pose)  # the jump back is no velocity
        if lost and self._no_person(iou, state.usual_iou):
            # stay where the person was last seen: a solve would drift to whatever else is in the masks
            pose, selected = state.pose, state.hypotheses
        return state, pose, selected, iou, lost, gain

    def rival(self, pose: Array, frame: Frame) -> Array:
        """Find the best pose (D,) from which to continue in a frame: the given pose, the body with left and right
        exchanged, or the pose that the recovery finds.
        """
        how, prepared = self.recipe.recover, self.prepare_frame(frame, pose)
        if how is None or not prepared.silhouettes.seen:
            return pose
        tried = [pose, how.find(pose, pose, prepared)]
        if how.rival is not None:
            tried.append(how.rival(pose, prepared)[1])
        return tried[int(np.argmax([agreement(self.body, q, prepared) for q in tried]))]

    def _has_look(self, state: TrackerState, times: int = 1) -> bool:
        """Decide whether a search for a rival is due; `times` as seldom."""
        return state.frames % max(1, round(times * self.settings.rival_every * self.settings.frame_rate)) == 0

    def _around(self, pose: Array, steps: float, rng: np.random.Generator) -> Hypotheses:
        """Scatter the recipe's number of hypotheses around a pose (D,), by this many usual steps."""
        s = self.body.skeleton
        noise = rng.standard_normal((self.recipe.particles, s.dof)) * steps
        return Hypotheses.uniform(s.clamp(pose + noise * s.step_sigma(self.settings.frame_rate)))

    def _rivals(self, h: Hypotheses | None) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Select the hypotheses other than the best, and their weights, for an estimate."""
        count = max(self.recipe.rivals - 1, 0)
        poses = np.full((count, self.body.skeleton.dof), np.nan, np.float32)
        weights = np.zeros(count, np.float32)
        if h is not None and BEFORE in h.columns:
            order = np.argsort(-h.weights, kind="stable")[1 : 1 + count]
            poses[: len(order)], weights[: len(order)] = h.values[order], h.weights[order]
        return poses, weights

    def _expected(self, state: TrackerState, step: Array) -> Hypotheses:
        """Move the hypotheses by a predicted step (D,), or each by its own."""
        s, h = self.body.skeleton, state.hypotheses
        if not self.recipe.rivals:
            return replace(h, values=self._within(h.values + step))
        before = h.columns.get(BEFORE)
        if before is None:  # the set is scattered around the only pose
            h, before = Hypotheses(state.pose[None], np.zeros(1)), state.previous[None]
        steps = np.zeros_like(before) if state.lost else h.values - s.on_branch(before, h.values)
        ahead = h.values + (self.recipe.predict or stand_still)(steps, state.blind)
        return replace(h, values=self._within(ahead), columns={BEFORE: h.values})

    def _within(self, poses: Array) -> Array:
        """Clamp poses (..., D) to the limits, unless the recipe's layers do that."""
        return poses if self.recipe.predict is None else self.body.skeleton.clamp(poses)

    def prepare_frame(self, frame: Frame, prediction: Array, state: TrackerState | None = None) -> PreparedFrame:
        """Prepare a frame for a search around the predicted pose (D,); state: after the previous frame."""
        wanted = self.settings.evidence
        return prepare(
            frame,
            self.body,
            prediction,
            use_silhouettes=wanted in ("silhouettes", "both", "auto"),
            use_keypoints=wanted in ("keypoints", "both", "auto"),
            contour_weight=self.settings.contour_weight,
            keypoint_scale_px=self.settings.keypoint_scale_px,
            keypoints_on_body=self.keypoints_on_body,
            prediction_weight=self.settings.prediction_weight * (self.settings.frame_rate / 25) ** 2,
            usual_iou=float("nan") if state is None else state.usual_iou,
            own=self.own,
            done=0 if state is None else state.frames,
        )

    def _begin(self, prepared: PreparedFrame, state: TrackerState) -> tuple[PreparedFrame, TrackerState]:
        """Move the set to where the recipe starts, before the first search.

        prepared: the first frame; state: before it.
        Returns: the frame with the start as its prediction; the state at the start.
        """
        start = self.recipe.start(prepared.prediction, prepared)
        shifted = self._within(state.hypotheses.values + (start - prepared.prediction))
        h = replace(state.hypotheses, values=shifted)
        return replace(prepared, prediction=start), replace(state, pose=start, previous=start, hypotheses=h)

    def _is_lost(self, iou: float, usual: float) -> bool:
        """Decide whether an IoU is too low for the person to be there, given the usual IoU (NaN: unknown); false for a
        NaN.
        """
        # key points alone have no IoU: nothing to judge the silhouette by
        return bool(iou < max(self.settings.lost_floor, self.settings.lost_share * np.nan_to_num(usual)))

    def _no_person(self, iou: float, usual: float) -> bool:
        """Decide whether an IoU is so low that the masks show no person at the place, given the usual IoU (NaN:
        unknown).
        """
        return bool(iou < _NO_PERSON * (1.0 if np.isnan(usual) else usual))

    def _extrapolate(
        self, state: TrackerState, prediction: Array, expected: Hypotheses
    ) -> tuple[TrackerState, FrameEstimate]:
        """Return the state and the estimate of a frame without evidence.

        prediction: (D,) pose; expected: hypotheses, moved by the predicted step.
        """
        s = self.body.skeleton
        blind = state.blind + 1
        # without evidence the covariance grows like that of a random walk with the usual steps
        growth = s.joint_covariances(prediction, np.diag(s.step_sigma(self.settings.frame_rate) ** 2))
        covariance = (np.nan_to_num(state.joint_covariance, nan=0.0) + growth).astype(np.float32)
        lost = state.lost or blind > self.settings.extrapolate * self.settings.frame_rate
        following = TrackerState(
            state.frames + 1, expected, prediction, state.pose, covariance, state.usual_iou, blind, lost, state.memory
        )
        rivals, weights = self._rivals(None)
        nothing = PoseUncertainty(covariance, packed(np.zeros((s.dof, s.dof))))
        still = np.zeros(len(s.joint_names) if self.recipe.rivals else 0, np.float32)
        return following, FrameEstimate(
            prediction, nothing, float("nan"), lost, True, 0, rivals=rivals, rival_weights=weights, moved=still
        )


def motion_of(
    body: Body, times: Array, estimates: Sequence[FrameEstimate], provenance: Mapping[str, Any] | None = None
) -> Motion:
    """Build the Motion of tracked frames: one estimate per time (T,).

    times: s; estimates: T; provenance: how the motion was made (default: empty).
    """
    poses, kept = np.stack([e.pose for e in estimates]), estimates[0].rivals.size
    return Motion(
        body.skeleton,
        np.asarray(times, dtype=np.float64),
        body.joints(poses),
        poses,
        np.stack([e.uncertainty.joint_covariance for e in estimates], dtype=np.float32),
        np.array([e.lost for e in estimates], dtype=bool),
        np.array([e.extrapolated for e in estimates], dtype=bool),
        np.array([e.n_views for e in estimates], dtype=np.int64),
        np.array([e.cost for e in estimates], dtype=np.float64),
        provenance or {},
        rivals=np.stack([e.rivals for e in estimates]) if kept else None,
        rival_weights=np.stack([e.rival_weights for e in estimates]) if kept else None,
    )


def modes_of(estimates: Sequence[FrameEstimate]) -> Modes | None:
    """Collect the modes (distinct possible poses) of all frames; None where the tracking method has no modes."""
    stated = [e.uncertainty.modes for e in estimates if e.uncertainty.modes is not None]
    return joined_modes(stated) if stated and len(stated) == len(estimates) else None


def estimates_to_arrays(estimates: Sequence[FrameEstimate]) -> dict[str, NDArray[Any]]:
    """Convert the estimates to plain arrays for a checkpoint."""
    modes = modes_of(estimates)
    return {
        **({} if modes is None else {f"{_MODES}{k}": v for k, v in modes_arrays(modes).items()}),
        "poses": np.stack([e.pose for e in estimates]),
        "joint_covariances": np.stack([e.uncertainty.joint_covariance for e in estimates]),
        "information": np.stack([e.uncertainty.information for e in estimates]),
        "costs": np.array([e.cost for e in estimates]),
        "flags": np.array([[e.lost, e.extrapolated] for e in estimates]),
        "views": np.array([e.n_views for e in estimates]),
        "exchanged": np.array([e.exchanged for e in estimates]),
        "seen": np.stack([e.seen for e in estimates]),
        "audit": np.stack([e.audit for e in estimates]),
        "rivals": np.stack([e.rivals for e in estimates]),
        "rival_weights": np.stack([e.rival_weights for e in estimates]),
        "origin": np.array([e.origin for e in estimates], dtype=np.str_),
        "moved": np.stack([e.moved for e in estimates]),
    }


def estimates_from_arrays(arrays: Mapping[str, np.ndarray]) -> list[FrameEstimate]:
    """Restore the estimates from the arrays of `estimates_to_arrays`."""
    stated = {k.removeprefix(_MODES): v for k, v in arrays.items() if k.startswith(_MODES)}
    modes = Modes(**stated).rows() if stated else [None] * len(arrays["poses"])
    alike = ("seen", "audit", "rivals", "rival_weights", "moved")
    return [
        FrameEstimate(
            pose,
            PoseUncertainty(arrays["joint_covariances"][t], arrays["information"][t], modes[t]),
            float(arrays["costs"][t]),
            bool(arrays["flags"][t][0]),
            bool(arrays["flags"][t][1]),
            int(arrays["views"][t]),
            exchanged=float(arrays["exchanged"][t]),
            origin=str(arrays["origin"][t]),
            **{name: arrays[name][t] for name in alike},
        )
        for t, pose in enumerate(arrays["poses"])
    ]
