"""Names from elsewhere in plots."""

from xml.etree import ElementTree

from hypose.app.reports.plots import svg


def test_any_name_may_stand_in_a_plot(recwarn):
    def draw(figure):
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], label="\x1b[31mMädchen 走る\x07 <b>")
        axes.legend()

    picture = svg(draw, (3.0, 2.0))
    texts = [e.text for e in ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}text")]
    assert "\\x1b[31mMädchen 走る\\x07 <b>" in texts
    assert not recwarn.list
