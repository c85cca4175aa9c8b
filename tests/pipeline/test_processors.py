"""The same clip and seed give the same motion on another processor, as far as one can be played on this one."""

import os
import subprocess
import sys

import numpy as np
import pytest

PROGRAM = """
import sys
import numpy as np
from benchmarks.robustness.small_recordings import small_scene
from hypose.pipeline.run import track_source
from hypose.pipeline.track_options import TrackOptions

class Frames:
    def __init__(self, frames):
        self.frames = frames
    def __len__(self):
        return len(self.frames)
    def frame(self, index, /):
        return self.frames[index]

motion = track_source(Frames(list(small_scene(3, 12).mask_frames())), 25.0, TrackOptions()).motion
np.save(sys.argv[1], motion.joints)
"""


def older_libraries():
    """The environment in which numpy and its linear algebra do as on a processor of 2008."""
    dispatched = np._core._multiarray_umath.__cpu_dispatch__
    usable = [f for f in dispatched if np._core._multiarray_umath.__cpu_features__.get(f)]
    return {"NPY_DISABLE_CPU_FEATURES": " ".join(usable), "OPENBLAS_CORETYPE": "Nehalem"}


@pytest.fixture(scope="module")
def joints_with(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joints")

    def track(name, **environment):
        path = folder / f"{name}.npy"
        if not path.exists():
            run = subprocess.run(
                [sys.executable, "-c", PROGRAM, str(path)],
                env={**os.environ, **environment},
                capture_output=True,
                text=True,
            )
            assert run.returncode == 0, run.stderr
        return np.load(path)

    return track


@pytest.mark.long
@pytest.mark.skipif(os.uname().machine != "x86_64" if hasattr(os, "uname") else True, reason="switches of x86-64")
def test_other_libraries_of_mathematics_change_no_pose(joints_with):
    here, there = joints_with("here"), joints_with("libraries", **older_libraries())
    assert np.abs(here - there).max() < 1e-9


@pytest.mark.long
def test_code_for_any_processor_changes_no_pose(joints_with):
    here, there = joints_with("here"), joints_with("generic", NUMBA_CPU_NAME="generic")
    assert np.abs(here - there).max() < 1e-9
