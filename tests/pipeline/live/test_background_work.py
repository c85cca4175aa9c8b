"""What is found beside live tracking: masks are kept whole, offsets of cameras are found, a body is fitted."""

import os
import signal
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from hypose.cameras.camera import CameraRig
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.pipeline.live.background_work import BackgroundWork, PackedMasks, fitted_body, offsets_of
from hypose.synthetic.scenes import Corruptions, camera_rig, make_scene


def test_masks_are_kept_bit_for_bit(rng):
    cameras = camera_rig("humaneva-4")
    mixed = CameraRig(
        tuple(c.scaled(size) for c, size in zip(cameras, ((160, 120), (130, 97), (197, 151), (64, 90)), strict=True))
    )
    masks = [rng.integers(0, 2, c.size[::-1]).astype(np.uint8) for c in mixed]
    s = make_silhouettes([masks[0], np.zeros_like(masks[1]), None, masks[3]], mixed)
    kept = PackedMasks.of(Frame(7.25, 3, s))
    back = kept.silhouettes(mixed)
    assert kept.time == 7.25 and (back.masks == s.masks).all() and back.masks.shape == s.masks.shape
    assert (back.usable == s.usable).all() and back.reasons == s.reasons
    assert kept.bits.nbytes < s.masks.nbytes / 7


def kept_of(desync, seconds=6.0, seed=2):
    cameras = camera_rig("humaneva-4").scaled(0.5)
    what = replace(Corruptions(), desync=desync)
    scene = make_scene("walk", "neutral", cameras, seconds=seconds, seed=seed, corruption=what)
    frames = list(scene.mask_frames())
    return [PackedMasks.of(f) for f in frames], frames[0].silhouettes.rig, scene.frame_rate


@pytest.mark.slow
def test_a_camera_that_is_late_is_found():
    kept, cameras, rate = kept_of((0, 0, 2, 0))
    found = offsets_of(kept, cameras, rate)
    assert found is not None
    assert found - np.median(found) == pytest.approx([0, 0, 2 / rate, 0], abs=0.25 / rate)


@pytest.mark.slow
def test_cameras_that_are_in_step_have_no_offsets():
    assert offsets_of(*kept_of((0,))) is None


def test_who_stands_still_tells_nothing_of_offsets():
    kept, cameras, rate = kept_of((0, 0, 2, 0), seconds=2.0)
    still = [replace(kept[0], time=k / rate) for k in range(100)]
    assert offsets_of(still, cameras, rate) is None


@pytest.mark.slow
def test_a_body_is_fitted_to_what_was_kept():
    kept, cameras, rate = kept_of((0,), seconds=3.6)
    body = fitted_body(kept[::2], cameras, rate / 2, None, 0)
    truth = make_scene("walk", "neutral", "humaneva-4", seconds=0.1, seed=2).subject
    assert body is not None and body.stature == pytest.approx(truth.stature, rel=0.03)


@pytest.mark.skipif(sys.platform == "win32", reason="NOT tested: kill -9; run it on Linux")
def test_a_process_that_is_killed_costs_what_it_was_doing_and_no_more():
    work = BackgroundWork()
    try:
        under_way = work._thread.submit(work._elsewhere, time.sleep, 60)
        while work._process is None:
            time.sleep(0.01)
        number = work._process.pid
        os.kill(number, signal.SIGKILL)
        assert under_way.result() is None
        assert work._elsewhere(os.getpid) not in (None, number)
    finally:
        work.close()
