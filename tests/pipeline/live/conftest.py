"""Somebody who walks."""

import pytest

from benchmarks.robustness.small_recordings import small_scene
from hypose.evidence.frame import Frame
from hypose.synthetic.scenes import Scene
from tests.live_scenes import Beside


@pytest.fixture
def executor() -> Beside:
    return Beside()


@pytest.fixture(scope="package")
def walk() -> Scene:
    """4 s of walking, seen by four cameras of 160 x 120 px, 25 frames/s."""
    return small_scene(1, 100)


@pytest.fixture(scope="package")
def frames(walk: Scene) -> list[Frame]:
    return list(walk.mask_frames())
