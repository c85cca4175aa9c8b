"""What can be wrong with the silhouettes of a person who is to be measured: units, borders, the pose that was named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hypose.errors import EvidenceError
from hypose.evidence.frame import Frame, Silhouettes
from hypose.pipeline.settings import SETTINGS

_EDGES = ("left", "right", "top", "bottom")
_UNITS = {"cm": 0.01, "mm": 0.001, "m": 1.0}


def no_two_views(frame: Frame) -> str:
    """Why a body cannot be measured in a frame with fewer than two usable views, or none of depth cameras, and what to
    do."""
    why = [] if frame.silhouettes is None else [r for r in frame.silhouettes.reasons if r]
    first = f" ({why[0].rstrip('.')})" if why else ""
    if frame.depth is not None:
        return (
            f"No depth camera shows a person in frame {frame.index}{first}; begin with --frames where somebody stands "
            "on the floor without holes in the maps (sunlight, dark clothes), and record the empty room."
        )
    return (
        f"The subject's shape needs silhouettes in at least two views from the first frame on{first}; check masks with "
        "`hypose silhouettes`, or choose other frames."
    )


def check_person_size(frame: Frame) -> None:
    """An EvidenceError when the person of a frame is a giant or a dwarf, with the calibration's likely unit."""
    height = apparent_height(frame.silhouettes) if frame.silhouettes is not None else None
    if height is None or SETTINGS.check_smallest <= height <= SETTINGS.check_tallest:
        return
    fitting = [u for u, k in _UNITS.items() if 1.0 <= height * k <= 2.4]
    advice = (
        f'calibration_unit = "{fitting[0]}" in recording.toml would make that {height * _UNITS[fitting[0]]:.2f} m'
        if fitting
        else "check the unit and the scale of the calibration, and that the masks show one person"
    )
    raise EvidenceError(f"Frame {frame.index}: the person in the silhouettes would be {height:.3g} m tall; {advice}.")


def apparent_height(silhouettes: Silhouettes) -> float | None:
    """Extent (m) of what the masks show at the point nearest to the rays through their middles: the median over the
    usable views; None when there are fewer than two. No hull is made, whose size in cells a wrong unit would blow up.
    """
    rows, extents = [], []
    for c in np.flatnonzero(silhouettes.usable):
        v, u = np.nonzero(silhouettes.told[c])
        camera = silhouettes.rig[int(c)]
        pixel = np.array([0.5 * (u.min() + u.max()), 0.5 * (v.min() + v.max()), 1.0])
        rotation = camera.camera_from_world[:3, :3]
        ray = rotation.T @ np.linalg.solve(camera.K, pixel)
        centre = -rotation.T @ camera.camera_from_world[:3, 3]
        rows.append((centre, ray / np.linalg.norm(ray), rotation[2]))
        extents.append(max(np.ptp(u) / camera.K[0, 0], np.ptp(v) / camera.K[1, 1]))
    if len(rows) < 2:
        return None
    # the point with the least squared distance to all rays
    across = [np.eye(3) - np.outer(d, d) for _, d, _ in rows]
    right = np.asarray(sum(a @ c for a, (c, _, _) in zip(across, rows, strict=True)))
    point = np.linalg.lstsq(np.asarray(sum(across)), right, rcond=None)[0]
    depths = np.array([(point - c) @ axis for c, _, axis in rows])
    if not (depths > 0).any():
        return None
    return float(np.median((np.array(extents) * depths)[depths > 0]))


def cut_edges(silhouettes: Silhouettes, view: int) -> tuple[str, ...]:
    """Image borders ('left', 'right', 'top', 'bottom') at which a view cuts the person off."""
    width, height = (int(n) for n in silhouettes.rig.sizes[view])
    mask = silhouettes.told[view, :height, :width]
    extent = int(np.ptp(np.flatnonzero(mask.any(1)))) if mask.any() else 0
    along = [int(line.sum()) for line in (mask[:, 0], mask[:, -1], mask[0], mask[-1])]
    # a speck of noise at the border cuts nobody
    return tuple(e for e, n in zip(_EDGES, along, strict=True) if n > max(3, 0.02 * extent))


def check_borders(frames: Sequence[Frame], height: float | None) -> tuple[str, ...]:
    """Notes on views that cut the person off; an EvidenceError when no view ever shows the whole person and the height
    is unknown."""
    seen: dict[str, list[tuple[str, ...]]] = {}
    for frame in frames:
        if frame.silhouettes is None:
            continue
        for c in np.flatnonzero(frame.silhouettes.usable):
            seen.setdefault(frame.silhouettes.rig.names[int(c)], []).append(cut_edges(frame.silhouettes, int(c)))
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
    """An EvidenceError when the best start explains too little of the silhouettes. value: its mean IoU."""
    if value < SETTINGS.check_least_overlap:
        raise EvidenceError(
            f"Frame {frame}: no body in a known pose explains the silhouettes, the best overlaps {value:.0%} of them; "
            "run hypose check, which looks at masks, calibration and synchronisation, or begin with --frames where the "
            "person stands apart from others."
        )


def check_named_pose(named: str, value: float, others: Mapping[str, float], frame: int) -> None:
    """An EvidenceError when another known pose explains a frame clearly better than the named one; mean IoU of each."""
    best = max(others, key=lambda k: others[k])
    if value < others[best] - SETTINGS.check_worse_pose:
        raise EvidenceError(
            f"Frame {frame} does not show the pose {named!r}: a body in it overlaps {value:.0%} of the silhouettes, in "
            f"the pose {best!r} {others[best]:.0%}; give --start {best} or --start hull (find out), or begin with "
            "--frames where the pose is held."
        )
