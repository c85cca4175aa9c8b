"""How near people come in the benchmark of several people is what its page says."""

import pytest

from benchmarks.people.together import SETTINGS, nearest


@pytest.mark.parametrize("name", [n for n, s in SETTINGS.items() if s.near])
@pytest.mark.parametrize("seed", [0, 300])
def test_people_come_as_near_to_each_other_as_the_setting_says(name, seed):
    people = [p for _, p in SETTINGS[name].make(seed, None)]
    closest = min(nearest(a, b) for k, a in enumerate(people) for b in people[:k])
    assert SETTINGS[name].near - 0.05 < closest < SETTINGS[name].near + 0.06
