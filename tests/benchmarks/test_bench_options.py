"""Names, cases and options of benchmarks are checked before anything is measured."""

import pytest


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("speed-of-light", "There is no benchmark 'speed-of-light'"),
        ("fusion", "--case: table-1, human4d"),
        ("people --case nobody", "--case: players, clothes"),
        ("mono --case speed --seeds 3", "does not use --seeds"),
    ],
)
def test_what_cannot_be_measured_is_refused(bench, asked, said):
    code, _, error = bench(*asked.split())
    assert code == 2 and said in " ".join(error.split())
