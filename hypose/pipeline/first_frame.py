"""Find the subject of a recording: the body, and the start pose in the first frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.errors import EvidenceError, InputError
from hypose.evidence.frame import Frame, Keypoints, pieces_of
from hypose.evidence.keypoints import triangulate_keypoints
from hypose.fitting import SolveSettings, fit_pose
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.io.motions.results import body_arrays, body_of_arrays
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.start_choice import best_ways
from hypose.pipeline.subject_from_motion import AnthropometryOptions, estimate_subject, with_outlines
from hypose.tracking.cue_weights import start_with_masks, weigh_against_masks
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.keypoint_clip import LEAST_POINTS
from hypose.tracking.keypoint_evidence import MIN_CONFIDENCE, KeypointModel, keypoint_model, keypoint_term
from hypose.tracking.keypoint_offsets import calibrate_keypoints, view_factors
from hypose.tracking.refinement import anatomical_prior
from hypose.tracking.start_search import Start, start_from_hull
from hypose.tracking.starts import KNOWN_POSES, start_from_keypoints
from hypose.tracking.subject import subject_from_keypoints

_FrameAt = Callable[[int], Frame]
GIVEN = "the subject's body is given"


@dataclass(frozen=True)
class TrackedSubject:
    """Person who is tracked: body and start pose.

    body: the body.
    keypoints: positions of key points on the body; None without key points.
    start: (D,) pose in the first frame.
    notes: sentences on how it was found.
    rivals: other possible start poses, where one camera leaves several.
    unsure: (2, J) probability that a joint is elsewhere at the start, see `Starts`; None: not known.
    """

    body: Body
    keypoints: KeypointModel | None
    start: Array
    notes: tuple[str, ...]
    rivals: Hypotheses | None = None
    unsure: Array | None = None

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Convert the subject to arrays for a checkpoint, which `from_arrays` reads."""
        arrays = {f"body_{name}": v for name, v in body_arrays(self.body).items()}
        arrays |= {"start": self.start, "notes": np.array(self.notes, dtype=np.str_)}
        if self.rivals is not None:
            arrays |= {"rivals": self.rivals.values, "rivals_weights": self.rivals.log_weights}
        if self.unsure is not None:
            arrays["unsure"] = self.unsure
        model = {} if self.keypoints is None else vars(self.keypoints)
        return arrays | {f"keypoints_{name}": np.asarray(v) for name, v in model.items() if v is not None}

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray]) -> TrackedSubject:
        """Restore a subject from the arrays of `to_arrays`."""
        body = body_of_arrays({n.removeprefix("body_"): v for n, v in arrays.items() if n.startswith("body_")})
        model = {n.removeprefix("keypoints_"): v for n, v in arrays.items() if n.startswith("keypoints_")}
        points = KeypointModel(**{**model, "names": tuple(model["names"].tolist())}) if model else None
        rivals = Hypotheses(arrays["rivals"], arrays["rivals_weights"]) if "rivals" in arrays else None
        notes = tuple(arrays["notes"].tolist())
        return TrackedSubject(body, points, arrays["start"], notes, rivals, arrays.get("unsure"))


@dataclass(frozen=True)
class SubjectOptions:
    """Options of finding the subject.

    start: 'auto', 'keypoints', 'hull' or the name of a known pose.
    height: height of the person, m; None: estimated from key points or the visual hull.
    girths: fit girths to the silhouettes where the body comes from key points.
    body: the template; with `known` the subject's own body.
    frame_rate: Hz.
    seed: seed of random numbers.
    known: the body is kept, and only the start pose is searched.
    shared: the masks also show other people; then starts of several frames are compared by tracking them through all
        frames.
    tried: further starts that may be right, each with its frame number.
    """

    start: str = "auto"
    height: float | None = None
    girths: bool = True
    body: Body | None = None
    frame_rate: float = 25.0
    seed: int = 0
    known: bool = False
    shared: bool = False
    tried: tuple[tuple[int, Start], ...] = ()

    def __post_init__(self) -> None:
        allowed = ("auto", "keypoints", "hull", *KNOWN_POSES)
        if self.start not in allowed:
            raise InputError(f"There is no start {self.start!r}; the starts are {', '.join(allowed)}.")


def find_subject(frame_at: _FrameAt, n_frames: int, options: SubjectOptions) -> TrackedSubject:
    """Find body and start pose of the subject from the frames of a recording.

    With key points: lengths and start from their robust triangulation, girths from the silhouettes.
    Without key points: start in a known pose at the visual hull; then lengths, girths and clothes from the
        silhouettes of the first seconds.
    frame_at: function that reads a frame by its number.
    n_frames: number of frames.
    Raises: InputError where the start 'keypoints' has no key points; EvidenceError where no start is found.
    """
    template = options.body or human()
    sampled = np.unique(np.linspace(0, n_frames - 1, min(n_frames, 40)).astype(int))
    first = frame_at(0)
    points = first.of(Keypoints)
    if options.start == "keypoints" and not points:
        raise InputError("The start 'keypoints' needs key points, and this recording has none; use the start 'hull'.")
    if points and options.start in ("keypoints", "auto"):
        return _by_points(template, frame_at, sampled, n_frames, options)
    poses = KNOWN_POSES if options.start in ("auto", "hull") else (options.start,)
    if options.known:
        if options.tried:
            frames = [frame_at(k) for k in range(min(n_frames, SETTINGS.first_tracked))]
            known = {"height": template.stature, "seed": options.seed, "tried": options.tried}
            way = best_ways(template, frames, options.frame_rate, shared=options.shared, **known).ways[0]
            return TrackedSubject(template, None, way.poses[0], (GIVEN,))
        prepared = prepare(first, template, np.zeros(template.skeleton.dof))
        return TrackedSubject(template, None, start_from_hull(template, prepared, poses).pose, (GIVEN,))
    how = AnthropometryOptions(
        height=options.height,
        poses=poses,
        seed=options.seed,
        frames=8,
        tracked=SETTINGS.first_tracked,
        passes=1,
        shared=options.shared,
        tried=options.tried,
    )
    estimate = estimate_subject(frame_at, n_frames, options.frame_rate, template, how)
    notes = [f"height {estimate.body.stature:.3f} m from the silhouettes"] if options.height is None else []
    return TrackedSubject(estimate.body, None, estimate.start, (*notes, *estimate.notes), unsure=estimate.unsure)


def _by_points(
    template: Body, frame_at: _FrameAt, sampled: np.ndarray, n_frames: int, options: SubjectOptions
) -> TrackedSubject:
    """Find the subject by key points, which also give the start pose; a known body is not changed."""
    seen = [f for f in map(frame_at, sampled.tolist()) for _ in f.of(Keypoints)]
    if not seen:
        raise EvidenceError("No frame has key points to start from; use the start 'hull'.")
    keypoints = pieces_of(seen, Keypoints)
    body, poses, notes = template, None, [GIVEN]
    if not options.known:
        points, _, _ = triangulate_keypoints(keypoints, worse=view_factors(keypoints))
        fitted = subject_from_keypoints(template, points, keypoints[0].names)
        body, poses, notes = fitted.body, fitted.poses, [f"segment lengths from the key points of {len(points)} frames"]
        if options.height is not None:
            notes.append("the given height is not used: lengths come from the key points")
        if options.girths:
            shaped = with_outlines(fitted, seen)
            body, note = shaped or (body, "girths of the template: no frame has a usable silhouette of the person")
            notes.append(note)
    # positions on the final body, since landmarks on the skin move with its girths
    model = calibrate_keypoints(body, keypoint_model(body, keypoints[0].names), keypoints, poses)
    model = weigh_against_masks(body, model, seen)
    assert model.sd is not None
    scatter = 1e3 * float(np.median(model.sd[model.known]))
    notes.append(f"key points weigh as if they scattered by {scatter:.0f} mm per axis")
    start, at = first_start(body, model, frame_at, min(n_frames, 1 + int(options.frame_rate)))
    start = start_with_masks(body, model, frame_at(at), start)
    if at:
        notes.append(f"the start is the pose of frame {at}, the first with enough key points")
    return TrackedSubject(body, model, start, tuple(notes))


def first_start(body: Body, model: KeypointModel, frame_at: _FrameAt, last: int) -> tuple[Array, int]:
    """Find the start pose by key points: solve the frame before `last` whose views agree best, and track back from
    there.

    Returns: pose (D,) in the first frame that can be solved, and the number of that frame.
    Raises: EvidenceError where no frame can be solved.

    Why not the first frame: a single frame does not show that a detector exchanged left and right in half of the views.
    """
    frames = [(i, k) for i in range(last) for k in frame_at(i).of(Keypoints)]
    error: EvidenceError | None = None
    for n in _agreeing([k for _, k in frames], model):
        keypoints = frames[n][1]
        points = triangulate_keypoints([keypoints], worse=model.worse(len(keypoints.rig)))[0][0][model.known]
        try:
            pose = start_from_keypoints(body, points, model.joint[model.known], model.offset[model.known]).pose
        except EvidenceError as e:
            error = error or e
            continue
        return _followed_back(body, model, frames[: n + 1], pose)
    raise error or EvidenceError("No frame of the first second has key points; start from the hull.")


def _agreeing(frames: Sequence[Keypoints], model: KeypointModel) -> list[int]:
    """Sort frame numbers, best first: by the share of detections that agree between views, among the frames with nearly
    as many points as the best; then the others.
    """
    if not frames:
        return []
    points, _, used = triangulate_keypoints(frames, worse=model.worse(len(frames[0].rig)))
    count = (np.isfinite(points).all(-1) & model.known).sum(1)
    seen = np.stack([((k.points[..., 2] > MIN_CONFIDENCE) & model.known).sum() for k in frames])
    agree = (used * model.known).sum(1) / np.maximum(seen, 1)
    many = count >= SETTINGS.first_as_many * count.max()
    # an early frame is kept unless another is clearly better: fewer frames are tracked backwards
    steps = np.ceil((agree[many].max(initial=0.0) - agree) / SETTINGS.first_as_well)
    return np.lexsort((np.arange(len(frames)), steps, ~many)).tolist()


def _followed_back(
    body: Body, model: KeypointModel, frames: Sequence[tuple[int, Keypoints]], pose: Array
) -> tuple[Array, int]:
    """Track backwards from the last frame with `pose`; return the pose in the first frame that has enough points, and
    its number.
    """
    prior, at = (anatomical_prior(body.skeleton, keypoints=True),), frames[-1][0]
    options = SolveSettings(iterations=12, coarse_iterations=0)
    for i, keypoints in reversed(frames[:-1]):
        term = keypoint_term(keypoints, body, model, pose)
        if term is not None and (term.points[..., 2] > 0).any(0).sum() >= LEAST_POINTS:
            pose, at = fit_pose(body, pose, [term], priors=prior, options=options).pose, i
    return pose, at
