"""A camera's thread: what it delivers, what it loses, and what is said while it is away."""

import contextlib
import queue
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.videos.video import CameraImage, StreamEnded
from hypose.pipeline.live import feeds
from hypose.pipeline.live.feeds import CameraFeed
from hypose.pipeline.settings import SETTINGS
from tests.conftest import HANG_S
from tests.live_scenes import Clock

PICTURE = np.zeros((4, 4, 3), np.uint8)
BEGIN = 1000.0


class Camera:
    """A source whose shots a test puts in; an error put in is raised. opened: how often."""

    def __init__(self, live=True):
        self.live, self.opened, self.closed = live, 0, 0
        self.shots = queue.Queue()
        self.refuse = ""

    def open(self):
        if self.refuse:
            raise InputError(self.refuse)
        self.opened += 1
        return self

    def read(self):
        try:
            shot = self.shots.get(timeout=HANG_S)
        except queue.Empty:
            raise StreamEnded("The test is over.") from None
        if isinstance(shot, Exception):
            raise shot
        return shot

    def close(self):
        self.closed += 1


@contextlib.contextmanager
def feed(camera):
    arrived = threading.Condition()
    made = CameraFeed("left", camera.open, arrived)
    made.start()
    try:
        yield made, arrived
    finally:
        made._stop.set()
        camera.shots.put(StreamEnded("The test is over."))
        made.stop()
        assert not made._thread.is_alive()


def until(arrived, met):
    end = time.monotonic() + HANG_S
    with arrived:
        while not met():
            assert time.monotonic() < end
            arrived.wait(0.05)


def play(camera, numbers, stamps=False, begin=BEGIN, rate=20.0):
    for n in numbers:
        camera.shots.put(CameraImage(begin + n / rate, 7.0 + n / rate if stamps else None, PICTURE))


def test_the_newest_pictures_are_kept_with_their_times():
    camera = Camera()
    with feed(camera) as (made, arrived):
        play(camera, range(20))
        until(arrived, lambda: made.status().received == 20)
        reported, shots = made.delivered()
        assert len(shots) == SETTINGS.feeds_kept and reported.times == pytest.approx(BEGIN + np.arange(8, 20) / 20)
        assert reported.period == pytest.approx(0.05) and (reported.arrivals == reported.times).all()
        status = made.status()
        assert (status.lost, status.returns, status.ended) == (0, 0, False)
        made.offset = 0.25  # what it shows is older
        assert made.delivered()[0].times == pytest.approx(BEGIN - 0.25 + np.arange(8, 20) / 20)


@pytest.mark.parametrize(
    ("arrivals", "period", "lost"),
    [
        ([n / 20 for n in range(40) if n not in (12, 20, 21, 22)], 1 / 20, range(4, 5)),
        ([(n // 3) / 10 + 0.001 * (n % 3) for n in range(90)], 1 / 30, range(6)),
    ],
    ids=["lost", "three at once, as wireless networks deliver"],
)
def test_lost_pictures_are_counted_and_those_that_come_in_bunches_are_not(arrivals, period, lost):
    camera = Camera()
    with feed(camera) as (made, arrived):
        for arrival in arrivals:
            camera.shots.put(CameraImage(BEGIN + arrival, None, PICTURE))
        until(arrived, lambda: made.status().received == len(arrivals))
        assert made.delivered()[0].period == pytest.approx(period, rel=0.1) and made.status().lost in lost


def test_what_the_camera_tells_of_time_is_kept_to():
    camera = Camera()
    with feed(camera) as (made, arrived):
        late = np.abs(np.random.default_rng(1).normal(0, 0.02, 30))
        late[0] = 0.0
        for n in range(30):
            camera.shots.put(CameraImage(BEGIN + n / 20 + late[n], 7.0 + n / 20, PICTURE))
        until(arrived, lambda: made.status().received == 30)
        reported, _ = made.delivered()
        assert np.abs(reported.times - (BEGIN + np.arange(18, 30) / 20)).max() < 1e-6  # as if nothing came late


def test_a_camera_comes_back_and_its_absence_is_no_loss(monkeypatch):
    monkeypatch.setattr(feeds, "SETTINGS", replace(SETTINGS, feeds_again_s=0.01))
    camera = Camera()
    with feed(camera) as (made, arrived):
        play(camera, range(10))
        until(arrived, lambda: made.status().received == 10)
        camera.refuse = "The stream cannot be opened (Connection refused); check the address."
        camera.shots.put(StreamEnded("The stream broke off (the connection was closed)."))
        until(arrived, lambda: "refused" in made.status().trouble)
        status = made.status()
        assert status.rate == 0.0 and status.returns == 0 and not status.ended and camera.closed == 1
        camera.refuse = ""
        until(arrived, lambda: camera.opened == 2)
        play(camera, range(110, 130))
        until(arrived, lambda: made.status().received == 30)
        status = made.status()
        assert (status.lost, status.returns) == (0, 1)
        reported, _ = made.delivered()
        assert reported.times[-1] == pytest.approx(BEGIN + 129 / 20) and reported.period == pytest.approx(0.05)


def test_a_camera_that_is_opened_and_shows_nothing_has_not_come_back(monkeypatch):
    monkeypatch.setattr(feeds, "SETTINGS", replace(SETTINGS, feeds_again_s=0.01, feeds_longest_s=0.02))
    camera = Camera()
    with feed(camera) as (made, arrived):
        play(camera, range(5))
        for _ in range(4):
            camera.shots.put(StreamEnded("The stream broke off (timed out)."))
        until(arrived, lambda: camera.closed == 4)
        assert made.status().returns == 0 and made.status().trouble.startswith("The stream broke off")


def test_a_camera_that_stalls_is_told(monkeypatch):
    camera, clock = Camera(), Clock()
    monkeypatch.setattr(feeds, "time", clock)
    with feed(camera) as (made, arrived):
        play(camera, range(10), begin=clock.monotonic() - 5.0)
        until(arrived, lambda: made.status().received == 10)
        status = made.status()
        assert status.trouble == "it sends no pictures" and status.rate == 0.0 and not status.ended
        play(camera, [0], begin=clock.monotonic())
        until(arrived, lambda: made.status().received == 11)
        assert made.status().trouble == ""


@pytest.mark.parametrize("back", [0.3, 6.9, 3600.0])
def test_a_clock_that_is_set_back_or_begins_anew_costs_two_pictures(back):
    camera = Camera()
    with feed(camera) as (made, arrived):
        play(camera, range(20), stamps=True)
        for n in range(20, 60):  # the pictures go on, and tell a time that has been
            camera.shots.put(CameraImage(BEGIN + n / 20, 7.0 + n / 20 - back, PICTURE))
        until(arrived, lambda: made.status().received == 58)
        assert made.delivered()[0].times[-1] == pytest.approx(BEGIN + 59 / 20)


def test_a_file_ends_and_is_not_opened_again():
    camera = Camera(live=False)
    with feed(camera) as (made, arrived):
        play(camera, range(3))
        camera.shots.put(StreamEnded("walk.mp4 is over."))
        until(arrived, lambda: made.status().ended)
        assert made.status().trouble == "walk.mp4 is over." and camera.opened == camera.closed == 1


def test_a_camera_that_cannot_be_opened_at_the_start_is_an_error():
    camera = Camera()
    camera.refuse = "Camera 5 of this computer cannot be opened."
    with pytest.raises(InputError, match="Camera 5"):
        CameraFeed("left", camera.open, threading.Condition()).start()
