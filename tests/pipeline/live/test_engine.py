"""Live, all of it: virtual cameras, an empty room, a person who walks, and a camera that is unplugged meanwhile."""

import multiprocessing

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.pipeline.live.capture import CaptureOptions, LiveView
from hypose.pipeline.live.engine import EMPTY_ROOM, LiveEngine
from hypose.pipeline.live.live_people import STATE_TRACKING
from hypose.synthetic.scenes import camera_rig
from tests.conftest import HANG_S
from tests.live_scenes import Stage, in_step, slow_walk, until

RATE = 8.0
AWAY_S = 3.0


class Kept:
    def __init__(self):
        self.poses, self.statuses, self.phases = [], [], []

    def seen(self, seen):
        self.poses += seen.poses

    def status(self, status):
        self.statuses.append(status)
        if not self.phases or self.phases[-1] != status.phase:
            self.phases.append(status.phase)


def test_cameras_in_and_poses_out_while_one_is_unplugged(monkeypatch):
    scene = slow_walk()
    stage, kept, names = Stage(scene, RATE, 8), Kept(), scene.given_rig.names
    in_step(monkeypatch, stage)
    views, options = [LiveView(n, "") for n in names], CaptureOptions(RATE, countdown=0.0)
    engine = LiveEngine(scene.given_rig, views, options, measure=False, listeners=[kept])
    try:
        engine.start()
        until(lambda: EMPTY_ROOM in kept.phases and engine.phase != EMPTY_ROOM, engine)
        stage.begin = stage.clock.monotonic()
        until(lambda: len(kept.poses) > 10, engine)
        gone = stage.clock.monotonic()
        stage.gone[names[2]] = gone, gone + AWAY_S
        until(lambda: engine.status().cameras[2].returns == 1 and kept.poses[-1].views.all(), engine)
        status = engine.status()
    finally:
        engine.stop()
    assert engine.failed is None and kept.phases[0] == EMPTY_ROOM and kept.phases[-1] == STATE_TRACKING

    # where the person truly was
    off = [np.linalg.norm(p.joints - scene.joints[stage.shown(p.time)], axis=-1).mean() for p in kept.poses]
    assert np.median(off) < 0.08, off
    assert not any(pose.lost for pose in kept.poses[5:])

    # the output does not stop, and it is said what is missing
    while_gone = [p for p in kept.poses if gone + 0.3 < p.time < gone + AWAY_S]
    assert len(while_gone) > 4 and not any(p.views[2] for p in while_gone)
    assert all(p.views.sum() >= 2 for p in while_gone)
    said = {w for s in kept.statuses for w in s.words}
    assert any(w.startswith(f"{names[2]} is missing: ") for w in said), said
    assert not any(w.startswith(f"{names[c]} is missing") for w in said for c in (0, 1, 3)), said
    assert status.latency[0] < 5000 and 0 <= status.skipped < 1 and set(status.stages) >= {"masks", "track"}


def test_one_camera_is_not_enough():
    cameras = camera_rig("humaneva-4")
    with pytest.raises(InputError, match="needs two cameras or more, or one depth camera, and 1 is given"):
        LiveEngine(cameras.select(["cam1"]), [LiveView("cam1", "0")])


def test_a_camera_that_cannot_be_opened_is_named_and_nothing_stays(tmp_path):
    cameras = camera_rig("humaneva-4")
    views = [LiveView(n, str(tmp_path / f"{n}.mp4")) for n in cameras.names]
    engine = LiveEngine(cameras, views, measure=False)
    try:
        with pytest.raises(InputError, match=r"There is no file .*cam1\.mp4"):
            engine.start()
    finally:
        engine.stop()
    for process in multiprocessing.active_children():
        process.join(HANG_S)
        assert process.exitcode == 0
