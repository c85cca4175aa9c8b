"""Pictures of a benchmark's figures: which bar stands where, and files that are pictures."""

import cv2
import pytest

from benchmarks.bench_plot import grouped, plot_report
from hypose.errors import InputError


def row(metric, case, value, sd=None):
    return {"metric": metric, "case": case, "value": value, "unit": "mm", "sd": sd}


def test_cases_are_series_and_groups():
    found = grouped(["apf", "apf/wave", "hpf", "hpf/wave"], "all")
    assert found == {
        "apf": ("apf", "all"),
        "apf/wave": ("apf", "wave"),
        "hpf": ("hpf", "all"),
        "hpf/wave": ("hpf", "wave"),
    }
    found = grouped(["legs", "both/legs"], "silhouettes")
    assert found == {"legs": ("silhouettes", "legs"), "both/legs": ("both", "legs")}
    assert grouped(["keypoints", "keypoints/view 1"], "all")["keypoints"] == ("keypoints", "all")


@pytest.mark.parametrize("name", ["table-2.4", "sync"])
def test_a_picture_is_drawn(tmp_path, name):
    rows = [
        row("extremity_error_mm", f"{p}{a}", v, 2.0) for v, p in ((80, "apf"), (40, "dd-hpf+")) for a in ("", "/wave")
    ]
    rows += [row("hand_error_mm", "apf", float("nan")), row("hand_error_mm", "hpf", 60.0)]
    plot_report({"name": name, "results": rows}, tmp_path / "a.png")
    picture = cv2.imread(str(tmp_path / "a.png"))
    assert picture.shape[1] > 700 and picture.std() > 10
    plot_report({"name": name, "results": rows}, tmp_path / "a.svg")
    assert "dd-hpf+" in (tmp_path / "a.svg").read_text()


def test_bad_input_is_told_in_a_sentence(bench, tmp_path):
    code, _, err = bench("table-2.4", "--plot", tmp_path / "a.doc")
    assert code == 2 and ".png, .svg, .pdf" in err and "Traceback" not in err
    with pytest.raises(InputError, match="no figures"):
        plot_report({"name": "table-2.4", "results": []}, tmp_path / "a.png")
