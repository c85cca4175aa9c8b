"""Which pictures belong together, and for how long it is worth waiting: no clock runs here."""

import numpy as np
import pytest

from hypose.pipeline.live.feeds import Delivered, is_there, newest_instant
from hypose.pipeline.settings import SETTINGS

PERIOD = 1 / 30
DELAY = 0.004  # s from a picture to its arrival


def camera(until, phase=0.0, delay=DELAY, without=(), count=12, period=PERIOD, begin=100.0):
    """What has arrived of a camera by the time `until` of those taken at begin + phase + n * period."""
    numbers = [n for n in range(400) if n not in without and begin + phase + n * period + delay <= until][-count:]
    times = np.array([begin + phase + n * period for n in numbers])
    return Delivered(times, times + delay, period if len(numbers) > 3 else float("nan"))


def shown(cameras, instant):
    return [None if k is None else c.times[k] for c, k in zip(cameras, instant.shots, strict=True)]


def run(cameras_at, seconds=2.0, begin=101.0, step=0.001):
    """Every instant that is told, and when, while time passes."""
    last, now, out = -np.inf, begin, []
    while now < begin + seconds:
        instant, wait = newest_instant(cameras_at(now), last, now)
        if instant is not None:
            out.append((now, instant, shown(cameras_at(now), instant)))
            last = instant.time
        else:
            assert wait > now
        now += step
    return out


def test_triggered_cameras_are_told_as_soon_as_the_last_one_has_arrived():
    found = run(lambda now: [camera(now, delay=d) for d in (0.003, 0.005, 0.011)])
    assert len(found) in (59, 60, 61)
    for now, instant, times in found[1:]:
        assert len(set(times)) == 1 and None not in times
        assert now - instant.time == pytest.approx(0.011, abs=0.0021)


def test_free_running_cameras_give_one_instant_per_period_of_their_nearest_pictures():
    phases = (0.0, 0.011, 0.023, 0.029)
    found = run(lambda now: [camera(now, phase=p) for p in phases])
    instants = np.array([i.time for _, i, _ in found])
    assert len(found) >= 58 and np.diff(instants).min() > 0.6 * PERIOD - 1e-9
    for now, instant, times in found:
        assert None not in times and np.abs(np.array(times) - instant.time).max() <= 0.55 * PERIOD
        assert now - instant.time < PERIOD + SETTINGS.feeds_slack_s


def test_jitter_loses_no_instant_and_never_goes_back():
    rng = np.random.default_rng(4)
    late = np.abs(rng.normal(0, 0.01, (3, 400)))

    def at(now):
        out = []
        for c in range(3):
            times = 100.0 + np.arange(400) * PERIOD
            arrivals = np.maximum.accumulate(times + late[c])
            here = np.flatnonzero(arrivals <= now)[-12:]
            out.append(Delivered(times[here], arrivals[here], PERIOD))
        return out

    instants = np.array([i.time for _, i, _ in run(at, 3.0)])
    assert (np.diff(instants) > 0).all() and len(instants) > 80
    assert np.diff(instants).max() < 3.1 * PERIOD


def test_a_lost_picture_is_waited_for_a_little_and_then_done_without():
    lost = 45
    found = run(lambda now: [camera(now), camera(now), camera(now, without=(lost,))])
    (now, instant, times) = next(f for f in found if abs(f[1].time - (100 + lost * PERIOD)) < 1e-6)
    assert times[2] is None and times[:2] == [instant.time] * 2
    assert instant.time + DELAY < now <= instant.time + DELAY + SETTINGS.feeds_slack_s + 0.0021
    assert all(None not in times for _, i, times in found if i is not instant)


def test_a_camera_that_has_gone_is_waited_for_until_it_counts_as_gone_and_then_no_more():
    def at(now):
        return [camera(now), camera(now), camera(min(now, 101.5))]

    found = run(at, 2.5)
    assert len(found) > 72  # the output does not stop
    assert np.diff([i.time for _, i, _ in found]).max() < 2.1 * PERIOD
    gone = [f for f in found if f[0] > 101.5 + SETTINGS.feeds_gone_s + PERIOD]
    assert len(gone) > 28
    for now, instant, times in gone:
        assert times[2] is None and now - instant.time < DELAY + 0.0021
    assert not is_there(at(103.0)[2], 103.0) and is_there(at(103.0)[0], 103.0)


def test_slow_cameras_are_not_taken_for_gone():
    slow = camera(101.0, period=0.5, begin=98.0)
    assert is_there(slow, 102.5) and not is_there(slow, 104.5)


@pytest.mark.parametrize("late", [0.05, 0.12, 0.2, 0.4])
@pytest.mark.parametrize("phases", [(0.0,), (0.0, 0.011, 0.023), (0.0, 0.0003, 0.0007)])
def test_a_camera_that_is_late_makes_all_of_it_late_and_ends_nothing(late, phases):
    """The others free-run, or have arrivals that differ a little; of them as much is kept as `Feed` keeps."""

    def at(now):
        phone = camera(now, phase=0.017, delay=late)
        return [camera(now, phase=p, count=12 + int(late / PERIOD)) for p in phases] + [phone]

    found = run(at, 2.0, step=0.004)
    assert len(found) > 55 and all(None not in times for _, _, times in found)
    assert max(now - instant.time for now, instant, _ in found) < late + PERIOD + SETTINGS.feeds_slack_s
