"""The small body whose silhouettes are drawn, and masks of it."""

import numpy as np
import pytest

from hypose.body.body import Body
from hypose.cameras.camera import CameraRig
from hypose.compute.arrays import prepare_masks
from tests import reference
from tests.capsule_person import capsule_person


@pytest.fixture(scope="session")
def body() -> Body:
    return capsule_person(0.09)


def prepared_masks(body, rig: CameraRig, pose, usable=None):
    """The masks of a pose in all views, drawn by the plain rasterizer; usable: which views have one (default: all)."""
    v = body.skin(pose)
    masks = [reference.rasterize(v, body.coarse.faces, c.projection, c.size) for c in rig]
    there = np.ones(len(masks), bool) if usable is None else np.array(usable)
    return prepare_masks(np.stack(masks), there, rig.sizes, rig.projections)
