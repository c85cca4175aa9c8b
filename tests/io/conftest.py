"""A body and a motion of it, made by hand: motion files need no tracker."""

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from scripts.fuzz_targets import write_good
from tests import missing


@pytest.fixture(scope="session")
def small_body():
    return human()


@pytest.fixture(scope="session")
def small_motion(small_body):
    """60 frames at 30 fps: every dof swings within its limits, the body turns once and walks; 5 frames are lost."""
    skeleton, rng, n = small_body.skeleton, np.random.default_rng(5), 60
    times = 0.4 + np.arange(n) / 30
    phase, speed = rng.uniform(0, 2 * np.pi, skeleton.dof), rng.uniform(0.5, 2, skeleton.dof)
    swing = 0.5 * np.sin(phase + 2 * np.pi * speed * (times[:, None] - times[0]) / 2)
    middle, half = np.zeros(skeleton.dof), np.ones(skeleton.dof)
    middle[6:] = (skeleton.lower[6:] + skeleton.upper[6:]) / 2
    half[6:] = (skeleton.upper[6:] - skeleton.lower[6:]) / 2
    poses = middle + half * swing
    poses[:, 2] += 0.95
    poses[:, 5] += np.linspace(0, 2 * np.pi, n)
    lost = np.zeros(n, dtype=bool)
    lost[20:25] = True
    extrapolated = np.zeros(n, dtype=bool)
    extrapolated[30] = True
    return Motion(
        skeleton,
        times,
        skeleton.forward(poses)[1],
        poses,
        isotropic(np.full((n, 19), 0.0042)),
        lost,
        extrapolated,
        np.where(lost, 0, 4),
        np.full(n, np.nan),
        {"recipe": "test"},
    )


@pytest.fixture(scope="session")
def opensim():
    """The OpenSim library; tests that compare with it are skipped, by name, where it is not installed."""
    module = missing.module("opensim", "agreement with OpenSim", "pip install opensim")
    module.Logger.setLevelString("Error")
    return module


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A folder with a good file of every reader."""
    folder = tmp_path_factory.mktemp("good")
    write_good(folder)
    return folder
