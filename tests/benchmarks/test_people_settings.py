"""How near people come in the benchmark of several people is what its page says."""

import pytest

from benchmarks.people import together
from benchmarks.people.together import SETTINGS, nearest


@pytest.mark.parametrize("name", [n for n, s in SETTINGS.items() if s.near])
@pytest.mark.parametrize("seed", [0, 300])
def test_people_come_as_near_to_each_other_as_the_setting_says(name, seed):
    people = [p for _, p in SETTINGS[name].make(seed, None)]
    closest = min(nearest(a, b) for k, a in enumerate(people) for b in people[:k])
    assert SETTINGS[name].near - 0.05 < closest < SETTINGS[name].near + 0.06


def test_starts_of_people_who_are_found_later_are_no_time_of_tracking(monkeypatch):
    clock, now = together._Clock(), iter([0.0, 5.0, 10.0, 11.0, 13.0, 14.0, 18.0, 20.0])
    monkeypatch.setattr(together.time, "process_time", lambda: next(now))
    clock("subject", 0, 1), clock("subject", 1, 1)  # before tracking
    clock("track", 0, 2)
    for _ in range(2):
        clock("subject", 0, 1), clock("subject", 1, 1)
    clock("track", 2, 2)
    assert (clock.track, clock.starts) == (10.0, 6.0)
