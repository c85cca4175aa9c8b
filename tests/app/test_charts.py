"""Names from elsewhere in plots."""

from xml.etree import ElementTree

import numpy as np
import pytest

from hypose.app.reports.charts import LEFT_COLOUR, Axes, _ticks, chart


def texts_of(picture):
    found = ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}text")
    return ["".join(e.itertext()) for e in found]


def test_any_name_may_stand_in_a_chart():
    axes = Axes("\x1b[31mMädchen 走る\x07 <b>", "a & b")
    axes.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), LEFT_COLOUR, "\x1b<i>")
    texts = texts_of(chart([[axes]], 200))
    assert "\\x1b[31mMädchen 走る\\x07 <b>" in texts and "a & b" in texts and "■ \\x1b<i>" in texts


@pytest.mark.parametrize("values", [[], [np.nan, np.nan], [2.0, 2.0], [1e-7, np.nan, 3e5], [-1e6, 1e6]])
def test_any_values_make_a_chart(values):
    y = np.array(values)
    axes = Axes(x="x", y="y", equal=len(values) == 3)
    axes.line(np.arange(len(y)), y, LEFT_COLOUR)
    axes.band(np.arange(len(y)), y - 1, y + 1, LEFT_COLOUR)
    axes.dots(np.arange(len(y)), y, LEFT_COLOUR)
    axes.stretch(0.2, 0.4, LEFT_COLOUR, "lost")
    picture = chart([[axes, Axes()]], 200)
    ElementTree.fromstring(picture)
    assert "nan" not in picture and "inf" not in picture


def test_a_line_is_interrupted_where_it_is_not_known():
    axes = Axes()
    axes.line(np.arange(7.0), np.array([np.nan, 1, 2, np.nan, 3, 1, np.nan]), LEFT_COLOUR)
    way = next(p for p in chart([[axes]], 200).split('d="') if LEFT_COLOUR in p)
    assert way.count("M") == 2 and way.split('"')[0].count("L") == 2


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"),
    [(0, 1, 5, [0, 0.2, 0.4, 0.6, 0.8, 1]), (-7, 8, 4, [-5, 0, 5]), (3.2, 3.9, 1, [])],
)
def test_ticks_are_round_numbers(low, high, most, expected):
    assert _ticks(low, high, most) == pytest.approx(expected)
