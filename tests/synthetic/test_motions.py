import numpy as np
import pytest

from hypose.body.default_body import PARENTS
from hypose.errors import InputError
from hypose.geometry import so3_log
from hypose.synthetic.motions import MOTIONS, act
from hypose.synthetic.performance import hanging_from_rest, soles


@pytest.fixture(scope="module")
def shows(person):
    return {n: act(n, person, 6.0, 50.0, np.random.default_rng(3)) for n in MOTIONS}


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_are_smooth_and_on_the_ground(shows, name, person):
    """People's joints stay below about 10 m/s and 200 m/s^2; a jump of 1 cm between two frames would be 25 m/s^2 more
    at 50 Hz, of 10 cm 250."""
    p = shows[name]
    assert len(p) == 300 and p.frame_rate == pytest.approx(50.0)
    low = np.array([person.skin(p.rotations[t], p.root[t])[:, 2].min() for t in range(0, len(p), 5)])
    assert low.min() > -0.015 and low.max() < (0.07 if name in ("jog", "combo") else 0.03) and np.median(low) < 0.02
    v = np.diff(p.joints, axis=0) * 50
    assert np.linalg.norm(v, axis=-1).max() < 11
    assert np.linalg.norm(np.diff(v, axis=0), axis=-1).max() * 50 < 200


@pytest.mark.parametrize("name", MOTIONS)
def test_joints_stay_within_what_joints_can_do(shows, name, person):
    p = shows[name]
    r = p.rotations @ np.swapaxes(hanging_from_rest(person), -1, -2)
    local = np.swapaxes(r[:, PARENTS[1:]], -1, -2) @ r[:, 1:]
    angle = np.degrees(np.linalg.norm(so3_log(local), axis=-1))  # (T, 18): joints 1..18
    for joints, most in (
        ((1, 2, 3, 4), 35),
        ((5, 9), 25),
        ((6, 10), 179),
        ((7, 11), 150),
        ((13, 16), 125),
        ((14, 17), 140),
    ):
        assert angle[:, [j - 1 for j in joints]].max() < most
    for knee in (14, 17):  # knees bend backwards only
        assert np.degrees(so3_log(local[:, knee - 1])[:, 0]).min() > -2
    for elbow in (7, 11):  # elbows forwards only
        assert np.degrees(so3_log(local[:, elbow - 1])[:, 0]).max() < 3


def test_walking_feet_do_not_slide(person):
    p = act("walk", person, 4.0, 50.0)
    speed = np.linalg.norm(np.diff(p.root[:, :2], axis=0), axis=1) * 50
    assert 0.9 < speed.mean() < 1.6
    # one foot stands: the slower of the two soles' lowest points hardly moves over the ground
    straight = act("walk", person, 4.0, 50.0, radius=np.inf)
    motion = np.linalg.norm(soles(person, straight.rotations, straight.joints)[1][..., :2], axis=-1) * 50
    assert np.median(motion.min(1)) < 0.15 * speed.mean()
    assert np.percentile(motion.min(1), 95) < 0.5 * speed.mean()


def test_rates_show_the_same_motion(person):
    a, b = (
        act("wave", person, 2.0, 25.0, np.random.default_rng(5)),
        act("wave", person, 2.0, 50.0, np.random.default_rng(5)),
    )
    assert np.abs(a.joints - b.joints[::2][: len(a)]).max() < 0.01


def test_seeds_repeat_and_differ(person):
    a, b, c = (act("walk", person, 2.0, 25.0, np.random.default_rng(s)) for s in (1, 1, 2))
    assert np.array_equal(a.joints, b.joints)
    assert np.abs(a.joints - c.joints).max() > 0.02


def test_unknown_names_are_refused_with_the_list(person):
    with pytest.raises(InputError, match="walk, jog, box"):
        act("fly", person, 1.0, 25.0)
    with pytest.raises(InputError, match="positive duration"):
        act("walk", person, 0.0, 25.0)
