"""modes.npz beside motion.npz: every hypothesis of every frame of a monocular track.

    modes = load_modes("results/monocular/modes.npz")
    modes.joints[t, k]      # (19, 3) m of mode k of frame t, NaN when frame t has fewer modes
    modes.weights[t]        # (K,), sum 1

The same safety as motion.npz: no pickle, nothing allocated before its size is known, equal modes give equal bytes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hypose.body.motion import Modes, modes_arrays
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.motions.results import load_archive, write_archive

_FORMAT = 1
_NEXT_STEP = "give the modes.npz that hypose track --recipe monocular wrote"
_DIMENSIONS = {
    "poses": 3,
    "joints": 4,
    "weights": 2,
    "costs": 2,
    "covariances": 4,
    "joint_covariance": 4,
    "depth_sd": 2,
    "alive": 1,
}


def save_modes(modes: Modes, path: str | Path) -> None:
    """Write whole or not at all."""
    write_archive(path, {**modes_arrays(modes), "format": np.array(_FORMAT)})


def load_modes(path: str | Path) -> Modes:
    """Read a modes.npz; an InputError names the file and what is wrong."""
    path = Path(path)
    arrays = load_archive(path, "file of modes", _NEXT_STEP)
    if arrays.pop("format", np.array(-1)).tolist() != _FORMAT:
        raise InputError(f"{path} is no file of modes of this version of hypose; {_NEXT_STEP}.")
    return _from_arrays(arrays, str(path))


def load_joints_of_modes(path: str | Path) -> tuple[Array, Array]:
    """joints (T, K, J, 3) m and weights (T, K) of a modes.npz alone, which is little of what it holds; an InputError as
    of `load_modes`."""
    path, names = Path(path), ("joints", "weights")
    found = load_archive(path, "file of modes", _NEXT_STEP, set(names))
    for name in names:
        if name not in found or found[name].dtype.kind != "f" or found[name].ndim != _DIMENSIONS[name]:
            raise InputError(f"{path} is damaged: {name} is missing or has another shape; track again.")
    joints, weights = (found[name] for name in names)
    if joints.shape[:2] != weights.shape or joints.shape[3] != 3:
        raise InputError(f"{path} is damaged: joints and weights do not belong together; track again.")
    return joints, weights


def _from_arrays(arrays: dict[str, np.ndarray], source: str) -> Modes:
    """The inverse of `modes_arrays`; an InputError naming the source when arrays are missing or of another kind."""
    for name, dimensions in _DIMENSIONS.items():
        kind = "i" if name == "alive" else "f"
        if name not in arrays or arrays[name].ndim != dimensions or arrays[name].dtype.kind != kind:
            raise InputError(f"{source} is damaged: {name} is missing or has another shape; track again.")
    unknown = set(arrays) - set(_DIMENSIONS)
    if unknown:
        raise InputError(f"{source} holds the unknown array {sorted(unknown)[0]!r}; track again.")
    return Modes(**arrays)
