import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.fusion import joints as jt


def test_names_may_come_in_any_order_and_spelling(rng):
    azure = jt.joint_sets()[2]
    order = rng.permutation(32)
    names = tuple(azure.joint_names[i].replace("_", " ").title() for i in order)
    found = jt.joint_set(names)
    assert found.name == "Azure Kinect"
    assert [jt.plain_name(names[i]) for i in found.common] == [
        jt.plain_name(azure.joint_names[i]) for i in azure.common
    ]
    for i, p in enumerate(found.parent):
        original = azure.parent[order[i]]
        assert (p == -1 and original == -1) or order[p] == original


def test_an_unknown_set_is_named_with_what_it_lacks():
    with pytest.raises(InputError, match=r"16 joints.*none of the known sets.*OpenNI"):
        jt.joint_set((*jt.COMMON, "tail"))


def test_all_ways_to_say_missing_become_one():
    p = np.ones((1, 15, 3))
    p[0, 0], p[0, 1], p[0, 2, 1] = np.nan, -9999, -9999
    state = np.full((1, 15), 2)
    state[0, 3] = 0
    f = SensorJoints(p, state, np.zeros(1), jt.COMMON, ("a",))
    assert np.isnan(f.positions[0, :4]).all() and np.isfinite(f.positions[0, 4:]).all()
    assert f.state[0, :5].tolist() == [0, 0, 0, 0, 2]
    assert np.isfinite(p[0, 3]).all()  # the caller's array is left alone


def test_millimetres_and_wrong_shapes_are_refused_in_a_sentence():
    with pytest.raises(InputError, match="front.*joint head.*cannot be metres.*by 1000"):
        SensorJoints(np.full((1, 15, 3), 1800.0), np.full((1, 15), 2), np.zeros(1), jt.COMMON, ("front",))
    with pytest.raises(InputError, match="all sensors must name the same joints"):
        SensorJoints(np.zeros((1, 25, 3)), np.full((1, 25), 2), np.zeros(1), jt.COMMON, ("front",))
    with pytest.raises(InputError, match="state is 0, 1 or 2"):
        SensorJoints(np.zeros((1, 15, 3)), np.full((1, 15), 7), np.zeros(1), jt.COMMON, ("front",))
