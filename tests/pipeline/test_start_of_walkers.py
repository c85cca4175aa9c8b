"""Whoever walks at the beginning is not taken for somebody smaller."""

import numpy as np
import pytest

from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.pipeline.subject import SubjectOptions, find_subject


@pytest.mark.slow
def test_the_body_of_somebody_who_walks_is_found_in_its_size():
    scene = noisy_scene("walk", "neutral", "humaneva-4", seconds=2.4, seed=1)
    frames = list(scene.mask_frames(1.0))
    found = find_subject(lambda k: frames[k], len(frames), SubjectOptions("hull", frame_rate=25.0))
    assert found.body.stature == pytest.approx(scene.subject.stature, rel=0.03)
    away = np.linalg.norm(found.body.joints(found.start[None])[0] - scene.joints[0], axis=-1)
    assert away.mean() < 0.06
