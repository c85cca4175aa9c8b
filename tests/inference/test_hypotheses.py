"""The weighted set: log-domain weights, moments, and what happens when the evidence is gone."""

import numpy as np
import pytest

from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import stream


def make(log_weights, values=None):
    lw = np.asarray(log_weights, float)
    v = np.arange(lw.size * 2.0).reshape(*lw.shape, 2) if values is None else values
    return Hypotheses(v, lw)


def test_weights_survive_any_offset():
    expected = np.exp([0, -1, -2]) / np.exp([0, -1, -2]).sum()
    for offset in (0.0, -1e5, 1e5):
        np.testing.assert_allclose(make(np.array([0, -1, -2]) + offset).weights, expected, rtol=1e-9)


@pytest.mark.filterwarnings("error")
def test_evidence_adds_up_and_a_lost_population_starts_again():
    h = make([0.0, -1.0]).reweighted([-1.0, -3.0])
    np.testing.assert_allclose(h.weights, np.exp([-1, -4]) / np.exp([-1, -4]).sum())
    lost = h.reweighted([-np.inf, np.nan])
    np.testing.assert_array_equal(lost.weights, 0.5)
    again = lost.reweighted([np.log(0.25), np.log(0.75)])
    np.testing.assert_allclose(again.weights, [0.25, 0.75])
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        h.reweighted(np.zeros(3))


def test_take_carries_everything():
    rng = np.random.default_rng(0)
    h = Hypotheses(
        rng.normal(size=(2, 4, 3)),
        rng.normal(size=(2, 4)),
        rng.integers(0, 9, (2, 4)),
        columns={"covariance": rng.normal(size=(2, 4, 3, 3))},
    ).marked("solved", rng.random((2, 4)) < 0.5)
    index = np.array([[3, 3, 0], [1, 2, 1]])
    t = h.take(index)
    for b in range(2):
        np.testing.assert_array_equal(t.values[b], h.values[b, index[b]])
        np.testing.assert_array_equal(t.log_weights[b], h.log_weights[b, index[b]])
        np.testing.assert_array_equal(t.origin[b], h.origin[b, index[b]])
        np.testing.assert_array_equal(t.has("solved")[b], h.has("solved")[b, index[b]])
        np.testing.assert_array_equal(t.columns["covariance"][b], h.columns["covariance"][b, index[b]])


def test_roles_have_names_and_exclude_nothing():
    h = Hypotheses.uniform(np.arange(4.0)[:, None])
    assert not h.has("solved").any()
    both = h.marked("solved", [0]).marked("composite", [False, True, True, False])
    assert both.has("solved").tolist() == [True, False, False, False]
    assert both.has("composite").tolist() == [False, True, True, False]
    again = both.marked("solved", [1, 3])  # taken from all others, and from no other role
    assert again.has("solved").tolist() == [False, True, False, True]
    assert again.has("composite").tolist() == both.has("composite").tolist()
    assert both.has("solved").tolist() == [True, False, False, False]  # the old set is as it was


def test_streams_depend_on_their_address_only():
    def draw(*address):
        return stream(*address).standard_normal((6, 3))

    np.testing.assert_array_equal(draw(1, 2, 3), draw(1, 2, 3))
    addresses = [
        (1, 2, 3),
        (2, 2, 3),
        (1, 3, 3),
        (1, 2, 4),
        (1, 3, 2),
        (1, 2, -1),
    ]
    assert len({draw(*a).tobytes() for a in addresses}) == len(addresses)
    np.testing.assert_array_equal(stream(1, 2, 3).standard_normal((50, 3))[:6], draw(1, 2, 3))  # N does not matter
