"""Find the subject of a recording: the body, and the start pose in the first frame (`find_subject`).

From silhouettes of the moving person: track briefly, choose different poses, fit shape and poses together. With key
points, which give poses and bones, the outlines give the rest.

Source: Alcoverro 2014, section 2.3.3 (placing at the hull, then pose, then shape and pose together). Deviation: several
    frames of ordinary motion instead of one known pose, and a joint gradient solution
    (hypose.tracking.shape_refinement).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hypose.body.anthropometry import CLOTHING_UNIT, SHAPE_FACTOR_NAMES, Sizes, body_of, entity, prior_mean, sizes_of
from hypose.body.body import Body
from hypose.body.default_body import human
from hypose.errors import EvidenceError, InputError
from hypose.evidence.cues import surface_evidence
from hypose.evidence.frame import Frame, Keypoints, Silhouettes, pieces_of
from hypose.evidence.keypoints import lasting_m, triangulate_keypoints
from hypose.fitting import fit_pose
from hypose.fitting.articulated import SolveSettings
from hypose.geometry import Array, far_apart
from hypose.inference.hypotheses import Hypotheses
from hypose.io.files import toml_lines, write_text
from hypose.io.motions.results import body_arrays, body_of_arrays, load_body, save_body
from hypose.pipeline.retracking import correct_left_right
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.start_choice import best_ways, both_ways, check_borders, check_person_size, no_two_views
from hypose.tracking.frame_evidence import (
    MIN_CONFIDENCE,
    KeypointModel,
    keypoint_model,
    keypoint_term,
    mean_overlap,
    prepare,
)
from hypose.tracking.keypoint_clip import LEAST_POINTS
from hypose.tracking.keypoint_offsets import calibrate_keypoints, start_with_masks, view_factors, weigh_against_masks
from hypose.tracking.recipes import default
from hypose.tracking.refinement import anatomical_prior, refine
from hypose.tracking.shape_refinement import Known, ShapeFit, ShapeSettings, refine_shape
from hypose.tracking.start_search import KNOWN_POSES, Start, start_from_keypoints, starts_in_frame
from hypose.tracking.subject import KeypointSubject, subject_from_keypoints
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerSettings

_FrameAt = Callable[[int], Frame]
_Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class SubjectOptions:
    """Options of finding the subject.

    start: 'auto', 'keypoints', 'hull' or the name of a known pose.
    height, mass: m and kg; None: estimated from key points or masks.
    girths: fit girths to the silhouettes where the body comes from key points.
    body: the subject's own body, of which only the start pose is searched; None: the human template is fitted.
    frame_rate: Hz.
    seed: seed of random numbers.
    shared: the masks also show other people; then starts of several frames are compared by tracking them through all
        frames.
    tried: further starts that may be right, each with its frame number.
    frames: number of different poses to which outlines are fitted.
    tracked: number of frames that are tracked to find them.
    rate: rate of these frames, Hz.
    passes: with 2, the frames are tracked again with the fitted body.
    """

    start: str = "auto"
    height: float | None = None
    mass: float | None = None
    girths: bool = True
    body: Body | None = None
    frame_rate: float = 25.0
    seed: int = 0
    shared: bool = False
    tried: tuple[tuple[int, Start], ...] = ()
    frames: int = SETTINGS.subject_poses
    tracked: int = SETTINGS.subject_looked_at
    rate: float = SETTINGS.people_fit_hz
    passes: int = 1

    def __post_init__(self) -> None:
        allowed = ("auto", "keypoints", "hull", *KNOWN_POSES)
        if self.start not in allowed:
            raise InputError(f"There is no start {self.start!r}; the starts are {', '.join(allowed)}.")
        for name, value, low, high, unit in (
            ("height", self.height, 0.5, 2.5, "m"),
            ("mass", self.mass, 8.0, 350.0, "kg"),
        ):
            if value is not None and not low <= value <= high:
                raise InputError(f"A {name} of {value:g} {unit} is no person's; give {low:g} to {high:g} {unit}.")

    @property
    def poses(self) -> Sequence[str]:
        """Names of the known poses in which the person may stand at the start."""
        return KNOWN_POSES if self.start in ("auto", "keypoints", "hull") else (self.start,)


@dataclass(frozen=True)
class SubjectEstimate:
    """Estimated body of a person.

    body: in clothes, as cameras see it.
    naked: without clothes.
    factors: (K,) anthropometry.SHAPE_FACTORS relative to the template.
    covariance: (K, K) covariance of the factors.
    start: (D,) pose in the first frame used.
    frames: numbers of the fitted frames.
    poses: (F, D) poses in them.
    template, template_poses: body and poses before the fit.
    iou_before, iou: (F, C) overlap of the body before and after the fit.
    notes: sentences for the user.
    unsure: (2, J) probability that a joint is elsewhere at the start, from the other starts that the masks allow.
    """

    body: Body
    naked: Body
    factors: Array
    covariance: Array
    start: Array
    frames: tuple[int, ...]
    poses: Array
    template: Body
    template_poses: Array
    iou_before: Array
    iou: Array
    notes: tuple[str, ...]
    unsure: Array

    @property
    def sizes(self) -> Sizes:
        """Sizes of the body without clothes; girths are those of the skin, as far as the thickness of
        clothes is known.
        """
        return sizes_of(self.naked)


def estimate_subject(
    frame_at: _FrameAt,
    n_frames: int,
    options: SubjectOptions | None = None,
    progress: _Progress = lambda done, total: None,
) -> SubjectEstimate:
    """Estimate the body of a recording's subject from silhouettes alone.

    frame_at: reads a frame by number.
    progress: called with done, total for every frame.
    Raises: EvidenceError where fewer than two views are usable, the person's size is impossible (units), no view shows
        the whole person, or no start explains the silhouettes.

    The person may do anything; different poses (bent elbows and knees) place the joints.
    """
    o = options or SubjectOptions()
    step = max(1, round(o.frame_rate / o.rate))
    indices, rate = range(0, n_frames, step)[: o.tracked], o.frame_rate / step
    steps, total = itertools.count(1), (1 + o.passes) * len(indices)

    def tick() -> None:
        progress(min(next(steps), total), total)

    seen = dict[int, Frame]()
    for i in indices:
        frame = frame_at(i)
        tick()
        if any(int(masks.usable.sum()) >= frame.fewest_views for masks in frame.of(Silhouettes)):
            seen[i] = frame
        elif not seen:
            raise EvidenceError(no_two_views(frame))
    numbers, frames = list(seen), list(seen.values())
    check_person_size(frames[0])
    border_notes = check_borders(frames, o.height)
    about = {"height": o.height, "seed": o.seed, "shared": o.shared}
    tried = [(numbers.index(i), s) for i, s in o.tried if i in seen]
    found = best_ways(human(), frames, rate, o.poses, tried=tried, **about)
    found.check(frames)
    first, at = found.starts.best.body, found.at
    tracked, iou = _tracked_poses(first, found.starts.best.pose, at, frames, rate, o.seed, tick)
    by_template, known = tracked, Known(o.height, o.mass)
    chosen, fit = fit_outlines(frames.__getitem__, first, tracked, iou, known, o.frames)
    for _ in range(o.passes - 1):
        # tracking with the fitted body is better, so other frames and better poses can be fitted
        tracked, iou = _tracked_poses(fit.body, tracked[at], at, frames, rate, o.seed, tick)
        chosen, fit = fit_outlines(frames.__getitem__, fit.body, tracked, iou, known, o.frames, fit)
    progress(total, total)
    body, x, views = fit.body, fit.log_factors, [frames[k] for k in chosen]
    iou_before, iou_after = overlaps(first, by_template[chosen], views), overlaps(body, fit.poses, views)
    note = (
        f"shape from the silhouettes of {len(chosen)} poses: mean IoU {np.nanmean(iou_before):.3f} -> "
        f"{np.nanmean(iou_after):.3f}, clothes about {100 * x[entity('clothing')]:.0f} mm"
    )
    return SubjectEstimate(
        body,
        body_of(human(), x, clothed=False),
        x,
        fit.covariance,
        refine(body, tracked[:1], prepare(frames[0], body, tracked[0]), SolveSettings())[0].pose,
        tuple(numbers[k] for k in chosen),
        fit.poses,
        first,
        by_template[chosen],
        iou_before,
        iou_after,
        (note, *border_notes),
        found.starts.unsure,
    )


def _tracked_poses(
    body: Body,
    start: Array,
    at: int,
    frames: Sequence[Frame],
    rate: float,
    seed: int,
    tick: Callable[[], None],
) -> tuple[Array, Array]:
    """Track the frames with few particles from frame `at` to both ends; correct exchanged sides.

    Returns: poses (T, D) and IoU (T,) in the order of the frames.
    """
    recipe = default(body, particles=SETTINGS.subject_particles, frame_rate=rate)
    tracker = Tracker(body, recipe, TrackerSettings(seed=seed, frame_rate=rate))
    found = dict[int, FrameEstimate]()
    for k, estimate in both_ways(tracker, start, at, frames):
        found[k] = estimate
        tick()
    in_order = [found[k] for k in range(len(frames))]
    tracked, _ = correct_left_right(tracker, in_order, lambda numbers: (frames[t] for t in numbers))
    return np.stack([e.pose for e in tracked]), np.array([1 - e.cost for e in tracked])


def fit_outlines(
    frame_at: _FrameAt,
    body: Body,
    poses: Array,
    iou: Array,
    known: Known,
    count: int = SETTINGS.subject_poses,
    before: ShapeFit | None = None,
) -> tuple[list[int], ShapeFit]:
    """Fit the human template to the outlines of a few different ones of the poses in which a body was tracked.

    frame_at: gives the frame of a pose by its row.
    body: the body that was tracked.
    poses, iou: (T, D) and (T,) overlap of each pose with the evidence.
    known: prior knowledge of the person.
    count: largest number of poses.
    before: an earlier fit, which is continued.
    Returns: rows of the poses, sorted, and the fit.
    """
    chosen = different_poses(body, poses, iou, count)
    how, start = ShapeSettings(), prior_mean()
    start[0] = np.log(body.stature / human().stature)
    if before is not None:
        how, start = replace(how, iterations=(0, *how.iterations[1:])), before.log_factors
    outlines = [surface_evidence(frame_at(k)) for k in chosen]
    return chosen, refine_shape(human(), poses[chosen], outlines, known=known, options=how, start=start)


def different_poses(body: Body, poses: Array, iou: Array, count: int) -> list[int]:
    """Select up to `count` of the poses (T, D) that differ most, among those with about the usual IoU.

    Farthest-point selection on joint positions relative to the pelvis and in its frame, and on the heading, so that
    changes of the viewed side count too.
    Returns: sorted indices.
    """
    usual = float(np.nanmedian(iou))
    allowed = [k for k in range(len(poses)) if iou[k] > 0.95 * usual] or list(range(len(poses)))
    rotations, joints = body.skeleton.forward(poses)
    local = np.einsum("tba,tjb->tja", rotations[:, 0], joints - joints[:, :1])
    heading = rotations[:, 0, :, 1] * 0.5
    feature = np.concatenate([local.reshape(len(poses), -1), heading], 1)
    return [allowed[k] for k in far_apart(feature[allowed], int(np.argmax(iou[allowed])), count)]


def overlaps(body: Body, poses: Array, frames: Sequence[Frame]) -> Array:
    """Compute the overlap (F, C) of a body in poses (F, D) with the masks of the frames."""
    return np.stack([prepare(f, body, q).silhouettes.overlap(body, q) for q, f in zip(poses, frames, strict=True)])


def with_outlines(fitted: KeypointSubject, frames: Sequence[Frame]) -> tuple[Body, str] | None:
    """Fit girths, clothes and the sizes that key points do not show to the outlines of a few different poses.

    fitted: body and poses from the key points of `frames`.
    Returns: body and a sentence; None where no frame has masks of that person.
    """
    solved = np.flatnonzero(np.isfinite(fitted.poses).all(1))
    looked_at = solved[
        np.unique(np.linspace(0, len(solved) - 1, min(SETTINGS.subject_looked_at, len(solved))).astype(int))
    ]
    shown = [n for n in looked_at.tolist() for _ in frames[n].of(Silhouettes)]
    views = {n: prepare(frames[n], fitted.body, fitted.poses[n]) for n in shown}
    found = {n: mean_overlap(fitted.body, fitted.poses[n], views[n]) for n in shown}
    usable = [n for n in shown if found[n] > SETTINGS.subject_the_person]
    if not usable:
        return None
    poses, overlap = fitted.poses[usable], np.array([found[n] for n in usable])
    chosen = different_poses(fitted.body, poses, overlap, SETTINGS.subject_poses)
    seen = [usable[k] for k in chosen]
    square = float(np.nanmedian(fitted.residual)) ** 2 + lasting_m(fitted.keypoints.names) ** 2
    known = Known(bones=float(np.clip(SETTINGS.subject_bones * square, *SETTINGS.subject_sure_bones)))
    fit = refine_shape(fitted.body, poses[chosen], [surface_evidence(frames[n]) for n in seen], known=known)
    after = np.mean([mean_overlap(fit.body, q, views[n]) for q, n in zip(fit.poses, seen, strict=True)])
    before = overlap[chosen].mean()
    if after < before:  # the masks are not of this body
        return fitted.body, f"girths of the template: outlines explain the masks no better (mean IoU {before:.3f})"
    return fit.body, f"girths from the silhouettes of {len(seen)} poses: mean IoU {before:.3f} -> {after:.3f}"


def save_subject(folder: str | Path, estimate: SubjectEstimate, source: str = "") -> tuple[Path, Path]:
    """Write body.npz (the clothed body, for `hypose track --subject`) and subject.toml (sizes in cm with standard
    deviations, and shape factors) into a folder; return their paths.
    """
    body, toml = Path(folder) / "body.npz", Path(folder) / "subject.toml"
    save_body(estimate.body, body)
    sd, skin, over = size_uncertainty(estimate), estimate.sizes.in_cm, sizes_of(estimate.body).in_cm
    about = {
        "body": body.name,
        "recording": source or None,
        "frames": list(estimate.frames),
        "mean_iou": round(float(np.nanmean(estimate.iou)), 4),
        "clothing_mm": round(1000 * CLOTHING_UNIT * float(estimate.factors[entity("clothing")]), 1),
    }
    lines = [
        "# A person's body, estimated from silhouettes. Lengths in cm; sd: one standard deviation.",
        "# Factors are natural logarithms relative to the template; clothing in units of 10 cm.",
        *toml_lines(about),
    ]
    for name, cm in skin.items():
        clothed = round(over[name], 2) if name.endswith("girth") else None
        sizes = {"cm": round(cm, 2), "sd": round(100 * sd[name], 2), "over_clothes_cm": clothed}
        lines += ["", f'[sizes."{name}"]', *toml_lines(sizes)]
    spread = np.sqrt(np.diag(estimate.covariance)).tolist()
    for name, value, width in zip(SHAPE_FACTOR_NAMES, estimate.factors.tolist(), spread, strict=True):
        lines += ["", f'[factors."{name}"]', *toml_lines({"value": round(value, 5), "sd": round(width, 5)})]
    write_text(toml, "\n".join(lines) + "\n")
    return body, toml


def subject_file(path: str | Path) -> Path:
    """Return the path of body.npz for a subject given as its folder, subject.toml or body.npz."""
    p = Path(path)
    if p.is_dir():
        return p / "body.npz"
    return p.with_name("body.npz") if p.name == "subject.toml" else p


def load_subject(path: str | Path) -> Body:
    """Load the body of a subject, given as its folder, subject.toml or body.npz.

    Raises: InputError names the missing input.
    """
    return load_body(subject_file(path))


def size_uncertainty(estimate: SubjectEstimate, draws: int = 24) -> dict[str, float]:
    """Compute the standard deviation (m) of every body size, from shapes drawn at random from the fit's covariance
    (fixed seed).

    draws: number of shapes.
    Returns: standard deviation by the name of the size.
    """
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(estimate.covariance)
    light = replace(human(), coarse=human().fine)
    rows = []
    for z in rng.standard_normal((draws, len(SHAPE_FACTOR_NAMES))):
        rows.append(sizes_of(body_of(light, estimate.factors + root @ z, clothed=False)).in_cm)
    return {k: float(np.std([r[k] for r in rows])) / 100 for k in rows[0]}


def measured_height(frame_at: _FrameAt, body: Body, poses: Array, iou: Array) -> float | None:
    """Estimate the person's height from silhouettes and depth of a motion that was tracked with a given height or
    body.

    poses: (T, D) of `body`.
    iou: (T,) overlap of each pose with the evidence.
    frame_at: function that reads a frame by its number.
    Returns: height, m; None where the evidence does not determine it.
    """
    known = np.flatnonzero(np.isfinite(iou)).tolist()
    if len(known) < 2:
        return None
    poses = poses[known]
    chosen, free = fit_outlines(lambda k: frame_at(known[k]), body, poses, iou[known], Known())
    if not np.sqrt(free.covariance[0, 0]) < SETTINGS.subject_sure:
        return None
    seen = [frame_at(known[k]) for k in chosen]
    before, after = (np.nanmean(overlaps(b, q, seen)) for b, q in ((body, poses[chosen]), (free.body, free.poses)))
    return free.body.stature if 1 - after < SETTINGS.subject_no_worse * (1 - before) else None


# ---- body and start of a recording ----------------------------------------------------------------------------------


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


def find_subject(frame_at: _FrameAt, n_frames: int, options: SubjectOptions) -> TrackedSubject:
    """Find body and start pose of the subject from the frames of a recording.

    With key points: lengths and start from their robust triangulation, girths from the silhouettes.
    Without key points: start in a known pose at the visual hull; then lengths, girths and clothes from the
        silhouettes of the first seconds.
    frame_at: function that reads a frame by its number.
    n_frames: number of frames.
    Raises: InputError where the start 'keypoints' has no key points; EvidenceError where no start is found.
    """
    first = frame_at(0)
    points = first.of(Keypoints)
    if options.start == "keypoints" and not points:
        raise InputError("The start 'keypoints' needs key points, and this recording has none; use the start 'hull'.")
    if points and options.start in ("keypoints", "auto"):
        return _by_points(frame_at, n_frames, options)
    body = options.body
    if body is not None:
        if options.tried:
            frames = [frame_at(k) for k in range(min(n_frames, options.tracked))]
            known = {"height": body.stature, "seed": options.seed, "tried": options.tried}
            pose = best_ways(body, frames, options.frame_rate, shared=options.shared, **known).ways[0].poses[0]
        else:
            prepared = prepare(first, body, np.zeros(body.skeleton.dof))
            pose = starts_in_frame(body, prepared, body.stature, names=options.poses)[0].pose
        return TrackedSubject(body, None, pose, (GIVEN,))
    estimate = estimate_subject(frame_at, n_frames, options)
    notes = [f"height {estimate.body.stature:.3f} m from the silhouettes"] if options.height is None else []
    return TrackedSubject(estimate.body, None, estimate.start, (*notes, *estimate.notes), unsure=estimate.unsure)


def _by_points(frame_at: _FrameAt, n_frames: int, options: SubjectOptions) -> TrackedSubject:
    """Find the subject by key points, which also give the start pose; a known body is not changed."""
    sampled = np.unique(np.linspace(0, n_frames - 1, min(n_frames, 40)).astype(int))
    seen = [f for f in map(frame_at, sampled.tolist()) for _ in f.of(Keypoints)]
    if not seen:
        raise EvidenceError("No frame has key points to start from; use the start 'hull'.")
    keypoints = pieces_of(seen, Keypoints)
    body, poses, notes = options.body, None, [GIVEN]
    if body is None:
        points, _, _ = triangulate_keypoints(keypoints, worse=view_factors(keypoints))
        fitted = subject_from_keypoints(human(), points, keypoints[0].names)
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
