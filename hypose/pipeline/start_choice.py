"""Choose the right start pose among those that several frames allow.

A single frame, and the half second after it, may not show front and back, above all where other people hide an arm or
the feet. So where masks are shared with others, the starts of several frames are each tracked through all of them.
Where the person is alone, the frame decides that is explained best.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.body.body import Body
from hypose.cameras.camera import triangulate
from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Silhouettes, pieces_of
from hypose.geometry import Array
from hypose.inference.layer import Recovery
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.frame_evidence import mean_overlap, prepare
from hypose.tracking.recipes import default
from hypose.tracking.start_search import (
    KNOWN_POSES,
    Start,
    Starts,
    by_their_ways,
    hull_of,
    recover,
    starts_in_frame,
    weigh_starts,
)
from hypose.tracking.tracker import FrameEstimate, Tracker, TrackerSettings

# ---- subject checks ------------------------------------------------------------------------------------------------
# Checks of the silhouettes of a person who is to be measured: units, image borders, the named pose.


_EDGES = ("left", "right", "top", "bottom")
_UNITS = {"cm": 0.01, "mm": 0.001, "m": 1.0}


def no_two_views(frame: Frame) -> str:
    """Write the sentence for the user that says why a body cannot be measured in a frame with too few usable views,
    and what to do.
    """
    why = [r for masks in frame.of(Silhouettes) for r in masks.reasons if r]
    first = f" ({why[0].rstrip('.')})" if why else ""
    if frame.kind == "depth":
        return (
            f"No depth camera shows a person in frame {frame.index}{first}; begin with --frames where a person stands "
            "on the floor without holes in the maps (sunlight, dark clothes), and record the empty room."
        )
    return (
        f"The subject's shape needs silhouettes in at least two views from the first frame on{first}; check masks with "
        "`hypose silhouettes`, or choose other frames."
    )


def check_person_size(frame: Frame) -> None:
    """Raise EvidenceError where the person of a frame is impossibly small or tall, with the
    calibration's likely unit.
    """
    heights = [tall for masks in frame.of(Silhouettes) if (tall := apparent_height(masks)) is not None]
    height = heights[0] if heights else SETTINGS.check_extent_m[0]
    if SETTINGS.check_extent_m[0] <= height <= SETTINGS.check_extent_m[1]:
        return
    fitting = [u for u, k in _UNITS.items() if 1.0 <= height * k <= 2.4]
    advice = (
        f'calibration_unit = "{fitting[0]}" in recording.toml would make that {height * _UNITS[fitting[0]]:.2f} m'
        if fitting
        else "check the unit and the scale of the calibration, and that the masks show one person"
    )
    raise EvidenceError(f"Frame {frame.index}: the person in the silhouettes would be {height:.3g} m tall; {advice}.")


def apparent_height(silhouettes: Silhouettes) -> float | None:
    """Compute the height (m) of the mask's extent at the point nearest to the rays through the masks' middles.

    Returns: median over the usable views; None with fewer than two.
    Why not the hull: with a wrong unit it could have far too many cells.
    """
    rig, usable = silhouettes.rig, silhouettes.usable
    middles, extents = np.zeros((len(rig), 2)), np.zeros(len(rig))
    for c in np.flatnonzero(usable).tolist():
        v, u = np.nonzero(silhouettes.informative[c])
        middles[c] = 0.5 * (u.min() + u.max()), 0.5 * (v.min() + v.max())
        extents[c] = max(np.ptp(u) / rig[c].K[0, 0], np.ptp(v) / rig[c].K[1, 1])
    point = triangulate(rig, middles, usable)[0]
    depths = np.array([camera.depths(point) for camera in rig])
    ahead = usable & (depths > 0)
    return float(np.median((extents * depths)[ahead])) if ahead.any() else None


def cut_edges(silhouettes: Silhouettes, view: int) -> tuple[str, ...]:
    """Return the image borders ('left', 'right', 'top', 'bottom') at which a view cuts the person off."""
    width, height = (int(n) for n in silhouettes.rig.sizes[view])
    mask = silhouettes.informative[view, :height, :width]
    extent = int(np.ptp(np.flatnonzero(mask.any(1)))) if mask.any() else 0
    along = [int(line.sum()) for line in (mask[:, 0], mask[:, -1], mask[0], mask[-1])]
    # noise at the border does not count
    return tuple(e for e, n in zip(_EDGES, along, strict=True) if n > max(3, 0.02 * extent))


def check_borders(frames: Sequence[Frame], height: float | None) -> tuple[str, ...]:
    """Return notes on views that cut the person off.

    Raises: EvidenceError where no view ever shows the whole person and the height is not known.
    """
    seen: dict[str, list[tuple[str, ...]]] = {}
    for masks in pieces_of(frames, Silhouettes):
        for c in np.flatnonzero(masks.usable):
            seen.setdefault(masks.rig.names[int(c)], []).append(cut_edges(masks, int(c)))
    notes, whole = [], 0
    for name, edges in seen.items():
        cut = [e for e in edges if e]
        whole += len(edges) - len(cut)
        if len(cut) > 0.1 * len(edges):
            where = " and ".join(e for e in _EDGES if any(e in found for found in cut))
            notes.append(f"{name} cuts the person off at its {where} border in {len(cut)} of {len(edges)} frames")
    if whole == 0 and height is None:
        raise EvidenceError(
            f"No view ever shows the whole person ({'; '.join(notes)}), so the height cannot be seen; give it with "
            "--height, or choose other frames or cameras."
        )
    return tuple(f"{n}: what lies outside is not measured there" for n in notes)


def check_start(value: float, frame: int) -> None:
    """Raise EvidenceError where the best start explains too little of the silhouettes; value: its mean IoU."""
    if value < SETTINGS.check_least_overlap:
        raise EvidenceError(
            f"Frame {frame}: no body in a known pose explains the silhouettes, the best overlaps {value:.0%} of them; "
            "run hypose check, which looks at masks, calibration and synchronisation, or begin with --frames where the "
            "person stands apart from others."
        )


def both_ways(tracker: Tracker, start: Array, at: int, frames: Sequence[Frame]) -> Iterator[tuple[int, FrameEstimate]]:
    """Track frames forwards from number `at`, then backwards from it.

    start: (D,) pose before the first step.
    Yields: number and estimate of each frame.
    """
    for numbers in (range(at, len(frames)), range(at - 1, -1, -1)):
        followed = tracker.follow(tracker.start(start), (frames[k] for k in numbers))
        for k, (_, estimate) in zip(numbers, followed, strict=True):
            if k == at:
                start = estimate.pose
            yield k, estimate


@dataclass(frozen=True)
class StartTrial:
    """Start pose that was tracked through all frames, to judge it.

    start: the start.
    at: number of its frame.

    poses: (T, D) tracked poses.
    costs: (T,) 1 - IoU; NaN where nothing is seen.
    """

    start: Start
    at: int
    poses: Array
    costs: Array

    @property
    def cost(self) -> float:
        """Mean cost over the frames; infinite where the cost of no frame is known."""
        known = self.costs[np.isfinite(self.costs)]
        return float(known.mean()) if len(known) else np.inf


def way_of(
    start: Start, at: int, frames: Sequence[Frame], rate: float, seed: int = 0, best: StartTrial | None = None
) -> StartTrial | None:
    """Track a start through the frames after it and before it, with few particles.

    at: number of the start's frame.
    rate: rate of the frames, Hz.
    best: cheapest trial so far.
    Returns: the trial; None as soon as it clearly costs more than `best`.
    """
    body = start.body
    recipe = replace(default(body, SETTINGS.choice_particles, rate, rivals=1), recover=Recovery(find=recover))
    tracker = Tracker(body, recipe, TrackerSettings(seed=seed, frame_rate=rate, rival_every=SETTINGS.choice_never_s))
    found: dict[int, FrameEstimate] = {}
    for k, estimate in both_ways(tracker, start.pose, at, frames):
        found[k] = estimate
        if best is None or len(found) < SETTINGS.choice_enough:
            continue
        more = np.array([e.cost - best.costs[t] for t, e in found.items()])
        if np.nan_to_num(more).mean() > SETTINGS.choice_hopeless:
            return None
    costs = np.array([found[k].cost for k in range(len(frames))])
    return StartTrial(start, at, np.stack([found[k].pose for k in range(len(frames))]), costs)


@dataclass(frozen=True)
class BestWays:
    """Best starts of some frames.

    starts: the starts with their weights.
    at: number of the best start's frame.
    ways: starts that were tracked through all frames, best first; none where one frame decided.
    """

    starts: Starts
    at: int
    ways: tuple[StartTrial, ...] = ()

    def check(self, frames: Sequence[Frame]) -> None:
        """Raise EvidenceError where the best start does not explain its frame. Where it was tracked, the tracked pose
        in that frame is checked, since tracking corrects small errors of a start at once.
        """
        best = self.starts.best
        if self.ways:
            best = replace(best, pose=self.ways[0].poses[self.at])
        check_start(_overlap(best, frames[self.at]), frames[self.at].index)


def best_ways(
    template: Body,
    frames: Sequence[Frame],
    rate: float,
    poses: Sequence[str] = KNOWN_POSES,
    *,
    height: float | None = None,
    seed: int = 0,
    shared: bool = False,
    tried: Sequence[tuple[int, Start]] = (),
) -> BestWays:
    """Find the start poses that explain the silhouettes of frames best, with their weights.

    rate: rate of the frames, Hz.
    poses: names of known poses; a single one is expected in the first frame.
    height: m, where known.
    shared: the masks also show other people; then starts of several frames are tracked through all frames.
    tried: further starts that may be right, each with its frame number.
    Raises: EvidenceError where no frame has a visual hull.

    Why several frames: a hole in one mask cuts the hull, so other frames are used where the first leaves a doubt. The
    person's extent is the median height of the hulls.
    """
    numbers = sorted({0, len(frames) // 3, (2 * len(frames)) // 3}) if not tried else [len(frames) // 2]
    extent = _extent(template, frames, sorted({*numbers, 0, len(frames) // 6, len(frames) // 2, len(frames) - 1}))
    found: list[tuple[int, Starts]] = []
    alone: tuple[float, BestWays] | None = None
    failed: EvidenceError | None = None
    for k in numbers:
        try:
            # only the first frame is expected to show a named pose
            starts = _searched(template, frames, k, height, extent, KNOWN_POSES if k else poses)
        except EvidenceError as error:
            failed = failed or error
            continue
        if len(poses) == 1 and k == 0:
            _check_named(template, frames[0], poses[0], starts.best, extent)
        found.append((k, starts))
        value = _overlap(starts.best, frames[k])
        if alone is None or value > alone[0] + SETTINGS.choice_clearly:
            alone = value, BestWays(starts, k)
        if not shared and alone[0] > SETTINGS.choice_plain and alone[1].starts.weights[0] > SETTINGS.choice_sure:
            break
    if not found and not tried:
        raise failed or EvidenceError("No frame has a visual hull to start from; check the calibration and the masks.")
    if alone is not None and not tried and (len(found) == 1 or not shared):
        return alone[1]
    likely = [
        (k, start)
        for k, starts in found
        for start, weight in list(zip(starts.starts, starts.weights, strict=True))[: SETTINGS.choice_best]
        if weight > SETTINGS.choice_likely
    ]
    return _by_all_frames(frames, rate, [*tried, *likely], seed)


def _by_all_frames(frames: Sequence[Frame], rate: float, tried: Sequence[tuple[int, Start]], seed: int) -> BestWays:
    """Sort the starts by how well their tracks explain all frames."""
    ways: list[StartTrial] = []
    for k, start in tried:
        way = way_of(start, k, frames, rate, seed, min(ways, key=lambda w: w.cost, default=None))
        if way is not None:
            ways.append(way)
    starts, order = by_their_ways([w.start for w in ways], [w.poses for w in ways], np.array([w.cost for w in ways]))
    return BestWays(starts, ways[order[0]].at, tuple(ways[k] for k in order))


def _extent(template: Body, frames: Sequence[Frame], numbers: Sequence[int]) -> float | None:
    """Compute the median height (m) of the hulls in the frames `numbers`; None where there is no hull."""
    heights = []
    for k in numbers:
        with contextlib.suppress(EvidenceError):
            heights.append(hull_of(prepare(frames[k], template, np.zeros(template.skeleton.dof))).height)
    return float(np.median(heights)) if heights else None


def _searched(
    template: Body,
    frames: Sequence[Frame],
    at: int,
    height: float | None,
    extent: float | None,
    names: Sequence[str],
) -> Starts:
    """Search starts in frame number `at`, weighted by the frames after it, or before it where none follow."""
    zero = np.zeros(template.skeleton.dof)
    others = [at + k for k in SETTINGS.choice_later if at + k < len(frames)] or [
        at - k for k in SETTINGS.choice_later if at - k >= 0
    ]
    later = [prepare(frames[k], template, zero) for k in others]
    found = starts_in_frame(template, prepare(frames[at], template, zero), height, extent, names)
    return weigh_starts(found, [f for f in later if f.silhouettes.seen])


def _check_named(template: Body, frame: Frame, name: str, start: Start, extent: float | None) -> None:
    """Raise EvidenceError where a frame shows another known pose clearly better than the named one of the start."""
    prepared, height = prepare(frame, template, np.zeros(template.skeleton.dof)), start.body.stature
    others = {p: starts_in_frame(template, prepared, height, extent, (p,))[0] for p in KNOWN_POSES if p != name}
    overlap = {p: _overlap(other, frame) for p, other in others.items()}
    best, value = max(others, key=lambda p: overlap[p]), _overlap(start, frame)
    if value < overlap[best] - SETTINGS.check_worse_pose:
        raise EvidenceError(
            f"Frame {frame.index} does not show the pose {name!r}: a body in it overlaps {value:.0%} of the "
            f"silhouettes, in the pose {best!r} {overlap[best]:.0%}; give --start {best} or --start hull (find out), "
            "or begin with --frames where the pose is held."
        )


def _overlap(start: Start, frame: Frame) -> float:
    return mean_overlap(start.body, start.pose, prepare(frame, start.body, start.pose))
