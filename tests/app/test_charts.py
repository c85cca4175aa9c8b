"""Names from elsewhere in plots."""

from xml.etree import ElementTree

import numpy as np
import pytest

from hypose.app.reports.charts import LEFT_COLOUR, Axes, chart


def test_any_name_may_stand_in_a_chart():
    axes = Axes("\x1b[31mMädchen 走る\x07 <b>", "a & b")
    axes.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), LEFT_COLOUR, "\x1b<i>")
    found = ElementTree.fromstring(chart([[axes]], 200)).iter("{http://www.w3.org/2000/svg}text")
    texts = ["".join(e.itertext()) for e in found]
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
