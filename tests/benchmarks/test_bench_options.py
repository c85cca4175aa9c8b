"""What a benchmark says it takes is what it uses, and what it does not take is refused before anything is measured."""


def test_an_unknown_benchmark_lists_the_names(bench):
    code, _, said = bench("speed-of-light")
    assert code == 2 and "There is no benchmark 'speed-of-light'" in said and "table-2.3" in said
