"""What a benchmark says it takes is what it uses, and what it does not take is refused before anything is measured."""

import ast
import inspect
import textwrap

import pytest

from benchmarks.bench_list import benchmarks, run_benchmark
from hypose.errors import InputError

_MEANS = {"seed_range": {"seeds", "first_seed"}, "folder": {"data"}, "part": {"parts"}}
FIELDS = {"seeds", "first_seed", "data", "parts", "other"}
VALUES = {"seeds": 3, "first_seed": 7, "data": "recordings", "parts": "parts", "other": True}


def used(function, seen=None):
    """The options that a function reads, itself or in functions that it hands its BenchOptions to."""
    seen = set() if seen is None else seen
    if function in seen:
        return set()
    seen.add(function)
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    given = {
        a.arg
        for a in ast.walk(tree)
        if isinstance(a, ast.arg) and isinstance(a.annotation, ast.Name) and a.annotation.id == "BenchOptions"
    }
    scope = dict(function.__globals__)
    for node in ast.walk(tree):  # what is imported inside, because modules would import each other
        if isinstance(node, ast.ImportFrom) and node.module:
            for name in node.names:
                module = __import__(node.module, fromlist=[name.name])
                scope[name.asname or name.name] = getattr(module, name.name)
    out = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in given:
            out |= _MEANS.get(node.attr, {node.attr} & FIELDS)
        if isinstance(node, ast.Call) and any(isinstance(a, ast.Name) and a.id in given for a in node.args):
            for part in (node.func, *node.args):
                found = _function(part, scope)
                if inspect.isfunction(found) and found.__module__.startswith("benchmarks."):
                    out |= used(found, seen)
    return out


def _function(node, scope):
    if isinstance(node, ast.Name):
        return scope.get(node.id)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return getattr(scope.get(node.value.id), node.attr, None)
    return None


@pytest.mark.parametrize(("name", "benchmark"), list(benchmarks().items()))
def test_a_benchmark_takes_what_it_uses_and_refuses_the_rest(name, benchmark):
    assert benchmark.takes == used(benchmark.measure)
    for option in FIELDS - benchmark.takes:
        with pytest.raises(InputError, match=f"{name} does not use --{option.replace('_', '-')}; leave it out"):
            run_benchmark(name, **{option: VALUES[option]})


def test_an_unknown_benchmark_lists_the_names(bench):
    code, _, said = bench("speed-of-light")
    assert code == 2 and "There is no benchmark 'speed-of-light'" in said and "table-2.3" in said
