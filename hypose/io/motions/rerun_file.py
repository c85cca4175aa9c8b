"""Rerun recordings (.rrd): the body, its skeleton and the 90 % regions of its joints over time, for Rerun's viewer.

The world is the recording's, metres, z up; times are the motion's, in seconds. Frames that are lost or predicted are in
another colour, and say so. Needs the extra [rerun]; nothing else of hypose does.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion, region_reach
from hypose.errors import extra
from hypose.io.files import atomic_path

_SURE, _UNSURE = (51, 122, 183), (217, 83, 79)
_SKIN = (204, 168, 143, 160)
_RADIUS = 0.012


def write_rrd(path: str | Path, motion: Motion, body: Body) -> None:
    """Write a motion; the body's surface where it has poses. An InputError when rerun-sdk is not installed."""
    rr = rerun_module()
    skeleton = motion.skeleton
    bones = [(int(p), j) for j, p in enumerate(skeleton.parents) if p >= 0]
    unsure = (motion.lost | motion.extrapolated).astype(bool)
    values, axes = np.linalg.eigh(np.nan_to_num(np.asarray(motion.joint_covariance, dtype=np.float64)))
    reach = region_reach(0.9) * np.sqrt(np.maximum(values, 0.0))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1  # rotations, not reflections
    with atomic_path(path) as temporary:
        stream = rr.RecordingStream("hypose", recording_id=Path(path).stem)
        stream.save(str(temporary))
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for t, time in enumerate(motion.times):
            joints = motion.joints[t]
            colour = _UNSURE if unsure[t] else _SURE
            seen = np.isfinite(joints).all(1)
            stream.set_time("time", duration=float(time))
            stream.set_time("frame", sequence=t)
            lines = [joints[[a, b]] for a, b in bones if seen[a] and seen[b]]
            stream.log("person/bones", rr.LineStrips3D(lines, colors=[colour] * len(lines), radii=_RADIUS / 2))
            names = [n for n, s in zip(skeleton.joint_names, seen, strict=True) if s]
            stream.log(
                "person/joints",
                rr.Points3D(joints[seen], colors=[colour] * len(names), radii=_RADIUS, labels=names, show_labels=False),
            )
            known = seen & np.isfinite(motion.joint_covariance[t]).all((1, 2))
            stream.log("person/regions_90", _regions(rr, joints[known], reach[t, known], axes[t, known], colour))
            if motion.poses is not None and np.isfinite(motion.poses[t]).all():
                mesh = rr.Mesh3D(
                    vertex_positions=body.skin(motion.poses[t]), triangle_indices=body.coarse.faces, albedo_factor=_SKIN
                )
                stream.log("person/body", mesh)
        stream.flush()
        stream.disconnect()


def _regions(rr: Any, centres: np.ndarray, reach: np.ndarray, axes: np.ndarray, colour: tuple[int, int, int]) -> Any:  # noqa: ANN401 (an archetype of rerun)
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(axes).as_quat() if len(axes) else np.zeros((0, 4))
    return rr.Ellipsoids3D(centers=centres, half_sizes=reach, quaternions=turns, colors=[(*colour, 90)] * len(centres))


def rerun_module() -> Any:  # noqa: ANN401 (a module)
    """Rerun's package; an InputError says how to get it."""
    return extra("rerun", "A Rerun recording", "rerun", "rerun-sdk")
