"""Live, all of it: virtual cameras, an empty room, somebody who walks, and a camera that is unplugged meanwhile."""

import multiprocessing
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.virtual_cameras import CameraFaults, VirtualCameras
from hypose.errors import InputError
from hypose.pipeline.live.engine import EMPTY_ROOM, LiveEngine, LiveOptions
from hypose.pipeline.live.eyes import EyesOptions, LiveView
from hypose.pipeline.live.live_people import FOLLOWING
from hypose.synthetic.rigs import rig
from hypose.synthetic.scenes import make_scene

RATE = 8.0
EMPTY = 8  # pictures of the empty room
AWAY_S = 3.0


def jpegs(pictures):
    return [cv2.imencode(".jpg", p, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes() for p in pictures]


class Kept:
    def __init__(self):
        self.poses, self.statuses, self.phases = [], [], []

    def seen(self, seen):
        self.poses += [(time.monotonic(), pose) for pose in seen.poses]

    def status(self, status):
        self.statuses.append((time.monotonic(), status))
        if not self.phases or self.phases[-1] != status.phase:
            self.phases.append(status.phase)


def until(met, seconds, engine):
    end = time.monotonic() + seconds
    while not met():
        assert engine.failed is None and time.monotonic() < end, (engine.failed, engine.status())
        time.sleep(0.05)


def test_cameras_in_and_poses_out_while_one_is_unplugged():
    # slowly: a busy computer skips much, and the clip is played forwards and backwards
    scene = make_scene(
        "walk", "neutral", rig("humaneva-4").scaled(0.25), seconds=3.0, frame_rate=RATE, seed=1, speed=0.3
    )
    views = range(len(scene.rig))
    clips = [jpegs(scene.rgb_frames(v)) for v in views]
    room = [jpegs(scene.background_frames(v, EMPTY)) for v in views]
    before = {p.pid for p in multiprocessing.active_children()}
    kept = Kept()
    with VirtualCameras(clips, RATE, first=room) as cameras:
        names = scene.given_rig.names
        live = [LiveView(n, a) for n, a in zip(names, cameras.addresses, strict=True)]
        options = LiveOptions(EyesOptions(RATE, countdown=0.0), measure=False)
        engine = LiveEngine(scene.given_rig, live, options, [kept])
        try:
            cameras.begin = time.monotonic() + 600.0
            engine.start()
            until(lambda: EMPTY_ROOM in kept.phases and engine.phase != EMPTY_ROOM, 120, engine)
            cameras.begin = time.monotonic()
            until(lambda: len(kept.poses) > 10, 90, engine)
            gone = time.monotonic() - cameras.begin
            cameras.faults = replace(CameraFaults(), gone=((), (), ((gone, gone + AWAY_S),), ()))
            until(lambda: engine.status().cameras[2].returns == 1 and kept.poses[-1][1].views.all(), 60, engine)
            status = engine.status()
        finally:
            engine.stop()
    assert engine.failed is None and kept.phases[0] == EMPTY_ROOM and kept.phases[-1] == FOLLOWING

    # where the person truly was
    off = []
    for _, pose in kept.poses:
        n = cameras.shown(pose.time)
        k = min(max(int(n), 0), len(scene) - 2)
        there = scene.joints[k] + (n - k) * (scene.joints[k + 1] - scene.joints[k])
        off.append(np.linalg.norm(pose.joints - there, axis=-1).mean())
    assert np.median(off) < 0.08, off
    assert not any(pose.lost for _, pose in kept.poses[5:])

    # the output does not stop, and it is said what is missing
    begin = cameras.begin + gone
    while_gone = [p for _, p in kept.poses if begin + 0.3 < p.time < begin + AWAY_S]
    assert len(while_gone) > 4 and not any(p.views[2] for p in while_gone)
    assert all(p.views.sum() >= 2 for p in while_gone)
    said = {w for _, s in kept.statuses for w in s.words}
    assert any(w.startswith(f"{names[2]} is missing: ") for w in said), said
    assert not any(w.startswith(f"{names[c]} is missing") for w in said for c in (0, 1, 3)), said
    assert status.latency[0] < 5000 and 0 <= status.skipped < 1 and set(status.stages) >= {"masks", "track"}
    assert {p.pid for p in multiprocessing.active_children()} <= before


def test_one_camera_is_not_enough():
    cameras = rig("humaneva-4")
    with pytest.raises(InputError, match="needs two cameras or more, or one depth camera, and 1 is given"):
        LiveEngine(cameras.select(["cam1"]), [LiveView("cam1", "0")])


def test_a_camera_that_cannot_be_opened_is_named_and_nothing_stays(tmp_path):
    cameras = rig("humaneva-4")
    views = [LiveView(n, str(tmp_path / f"{n}.mp4")) for n in cameras.names]
    engine = LiveEngine(cameras, views, LiveOptions(measure=False))
    try:
        with pytest.raises(InputError, match=r"There is no file .*cam1\.mp4"):
            engine.start()
    finally:
        engine.stop()
    assert not multiprocessing.active_children()
