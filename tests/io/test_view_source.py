"""From a stored picture to a mask and to the picture in it, whose memory is used again."""

import cv2
import numpy as np
import pytest

from hypose.cameras.camera import Camera
from hypose.compute import mask_runs
from hypose.evidence.background import from_frames
from hypose.evidence.silhouettes import make_segmenter
from hypose.io.recordings.view_source import Preparer, mask_in

W, H = 90, 70


@pytest.mark.parametrize("lens", [0.0, -0.2])
@pytest.mark.parametrize("working", [(W, H), (45, 35)])
def test_the_picture_is_known_within_the_mask_also_where_that_reaches_beyond_the_band(rng, lens, working):
    camera = Camera(
        "a", np.array([[80.0, 0, 44.5], [0, 80, 34.5], [0, 0, 1]]), np.r_[lens, np.zeros(4)], np.eye(4), (W, H)
    )
    prepare = Preparer(camera, camera.pinhole().scaled(working), (0.0, 0.0))
    room = cv2.blur(rng.integers(60, 200, (H, W, 3)).astype(np.uint8), (9, 9))
    empty = [np.clip(room + rng.normal(0, 2, room.shape), 0, 255).astype(np.uint8) for _ in range(6)]
    segment = make_segmenter(from_frames([prepare(image) for image in empty]))
    w, h = working
    beyond = 0
    for left in range(0, W - 20, 10):
        image = empty[0].copy()
        image[20:, left : left + 20] = rng.integers(0, 256, (H - 20, 20, 3))
        for band in (None, np.zeros((h, w), np.uint8)):
            if band is not None:
                band[h // 5 : -2, 2:-2] = 1  # closing ends a mask at the border of the picture
            prepare.within(np.zeros_like(image), None)  # what was there before
            runs, picture = mask_in(image, prepare, segment, band)
            mask = mask_runs.draw(runs)
            assert mask.any()
            np.testing.assert_array_equal(picture[mask > 0], prepare(image)[mask > 0])
            beyond += band is not None and bool((mask & (1 - band)).any())
    assert beyond
