"""Find and correct depth cameras that stand elsewhere than the calibration says, or are knocked while they record.

The place of a sensor follows from how well its measurements fit the body that all of them see. The first sensor keeps
its place; the others turn about the vertical and move along the floor, as in the first registration
(`calibration.depth_registration`). One instant is searched at which places change.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hypose.body.body import Body
from hypose.calibration.depth_registration import in_camera, place_error, refine_registration
from hypose.calibration.findings import REVIEW, Finding
from hypose.evidence.depth_evidence import Depth, SurfacePoints
from hypose.evidence.frame import Frame
from hypose.fitting.articulated import SolveSettings
from hypose.geometry import Array
from hypose.pipeline.settings import SETTINGS
from hypose.pipeline.sources import FrameSource, Places, placed
from hypose.pipeline.subject import different_poses
from hypose.tracking.frame_evidence import prepare
from hypose.tracking.refinement import refine

_LONG_SOLVE = SolveSettings(iterations=12, coarse_iterations=6)


def moved_sensors(
    source: FrameSource, body: Body, poses: Array, iou: Array, frame_rate: float
) -> tuple[tuple[Places, ...], tuple[Finding, ...]]:
    """Find depth cameras that do not stand where the source says.

    poses: (T, D) as tracked.
    iou: (T,) overlap of each pose with the evidence; NaN: not known.
    frame_rate: Hz.
    Returns: corrected places, and findings; both empty where all places are right or there are fewer than two depth
        cameras.
    """
    depths = source.frame(0).of(Depth)
    count, least = len(poses), max(round(SETTINGS.moved_least_s * frame_rate), 3)
    if count < least or all(depth.usable.sum() < 2 for depth in depths):
        return (), ()
    depth = depths[0]
    reported = np.stack([c.camera_from_world for c in depth.rig])

    def places(frames: range, count: int = SETTINGS.moved_frames, iterations: int = 12) -> Array:
        known = (np.flatnonzero(np.isfinite(iou[frames.start : frames.stop])) + frames.start).tolist()
        if len(known) < least:
            return reported
        return solve_places(
            lambda k: source.frame(known[k]), body, poses[known], iou[known], reported, count, iterations
        )

    # a rough check must exceed half of both limits before all is solved
    third = max(count // 3, least)
    ends = range(third), range(count - third, count)
    if not any(_off(reported, places(end, *SETTINGS.moved_rough), poses[end[len(end) // 2]], 0.5) for end in ends):
        return (), ()
    first, last = places(ends[0]), places(ends[1])
    change = 0
    if count >= 2 * least and _off(first, last, poses[count // 2]):
        change = _changes(source, body, poses, first, last)
    stretches = [s for s in (range(change), range(change, count)) if len(s) >= least]
    found, said = list[Places](), list[Finding]()
    before = reported
    for stretch in stretches:
        now = places(stretch)
        off = _off(reported, now, poses[stretch[len(stretch) // 2]])
        for c, (degrees, metres) in off.items():
            when = "" if len(stretches) < 2 else f" from frame {stretch.start} to {stretch.stop - 1}"
            off_by = f"{1e3 * metres:.0f} mm off and turned by {degrees:.1f} degrees{when}"
            text = (
                f"{depth.rig.names[c]} stood {off_by}, by the person before all depth cameras: its place was found "
                "again for this run, and is to be corrected in the calibration"
            )
            said.append(Finding("moved", (depth.rig.names[c],), text, size=metres, severity=REVIEW))
        now = np.where(np.isin(np.arange(len(reported)), list(off))[:, None, None], now, reported)
        if not np.array_equal(now, before):
            found.append(Places(stretch.start if len(found) or stretch.start >= least else 0, now))
        before = now
    return tuple(found), tuple(said)


def _off(reported: Array, found: Array, pose: Array, share: float = 1.0) -> dict[int, tuple[float, float]]:
    """Measure by how much cameras are off, and keep those that are off by more than a share of the limits.

    pose: (D,) pose of the person.
    Returns: by camera index, degrees, and metres at the person's place.
    """
    errors = [place_error(f, t, pose[:3]) for f, t in zip(found, reported, strict=True)]
    return {
        c: e
        for c, e in enumerate(errors)
        if e[0] > share * SETTINGS.moved_off_degrees or e[1] > share * SETTINGS.moved_off_m
    }


def solve_places(
    frame_at: Callable[[int], Frame],
    body: Body,
    poses: Array,
    iou: Array,
    reported: Array,
    count: int,
    iterations: int = 12,
) -> Array:
    """Solve the places (C, 4, 4) of depth cameras from the poses of a body that all of them see.

    frame_at: gives the frame of a pose by its row.
    poses, iou: (T, D) and (T,) overlap of each pose with the evidence.
    reported: (C, 4, 4) places in which the frames have the cameras.
    count: number of different poses that are used.
    """
    chosen = different_poses(body, poses, iou, count)
    depths = [frame_at(k).the(Depth) for k in chosen]
    views = np.flatnonzero(np.any([own.usable for own in depths], 0))
    seen = [[_surface(own, int(c), reported[c]) for own in depths] for c in views]
    out = reported.copy()
    out[views] = refine_registration(body, poses[chosen], seen, reported[views], iterations)
    return out


def _surface(depth: Depth, view: int, camera_from_world: Array) -> SurfacePoints:
    """Select the points that one camera of a frame shows, and turn them into the camera's own frame."""
    s = depth.surface
    own = slice(int(s.first[view]), int(s.first[view + 1]))
    alone = SurfacePoints(s.points[own], s.normals[own], s.sd[own], np.array([0, own.stop - own.start]))
    return in_camera(alone, camera_from_world)


def _changes(source: FrameSource, body: Body, poses: Array, first: Array, last: Array) -> int:
    """Find the frame at which cameras moved from their first to their last places: where both explain most."""
    gain = np.zeros(len(poses))
    for t, pose in enumerate(poses):
        frame = source.frame(t)
        if frame.the(Depth).usable.sum() < 2:
            continue
        costs = [
            refine(body, pose[None], prepare(placed(frame, places), body, pose), _LONG_SOLVE)[0].cost
            for places in (first, last)
        ]
        gain[t] = costs[1] - costs[0]
    return int(np.argmin(np.r_[0.0, -np.cumsum(gain)]))
