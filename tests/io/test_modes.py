"""modes.npz: read back as written, padded to the most modes, and refused when it is something else."""

import numpy as np
import pytest

from hypose.body.motion import Modes
from hypose.errors import InputError
from hypose.io.motions.results import load_joints_of_modes, load_modes, save_modes


def some(t, k, seed=0, d=5, j=3):
    rng = np.random.default_rng(seed)
    weights = rng.random((t, k))
    return Modes(
        rng.normal(size=(t, k, d)),
        rng.normal(size=(t, k, j, 3)),
        weights / weights.sum(1, keepdims=True),
        rng.normal(size=(t, k)),
        rng.normal(size=(t, k, d, d)).astype(np.float32),
        rng.normal(size=(t, j, 3, 3)),
        rng.random((t, j)),
        np.full(t, k, dtype=np.int64),
    )


def test_read_back(tmp_path) -> None:
    modes = some(4, 2)
    save_modes(modes, tmp_path / "modes.npz")
    again = load_modes(tmp_path / "modes.npz")
    for name in ("poses", "joints", "weights", "costs", "covariances", "joint_covariance", "depth_sd", "alive"):
        np.testing.assert_array_equal(getattr(modes, name), getattr(again, name))
    assert len(again) == 4
    joints, weights = load_joints_of_modes(tmp_path / "modes.npz")
    np.testing.assert_array_equal(joints, modes.joints)
    np.testing.assert_array_equal(weights, modes.weights)


def test_joints_and_weights_must_belong_together(tmp_path) -> None:
    np.savez(tmp_path / "modes.npz", joints=np.zeros((4, 2, 3, 3)), weights=np.zeros((4, 3)))
    with pytest.raises(InputError, match="do not belong together"):
        load_joints_of_modes(tmp_path / "modes.npz")


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_other_files_are_refused(tmp_path, content) -> None:
    path = tmp_path / "modes.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="modes.npz"):
        load_modes(path)


def test_arrays_of_something_else_are_refused(tmp_path) -> None:
    np.savez(tmp_path / "modes.npz", x=np.zeros(3))
    with pytest.raises(InputError, match="no file of modes"):
        load_modes(tmp_path / "modes.npz")
    with pytest.raises(InputError, match="joints is missing"):
        load_joints_of_modes(tmp_path / "modes.npz")
