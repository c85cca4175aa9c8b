"""What a test needs that may not be here. Such a test is skipped in one form of words, and from these the line is made
that ends a run: what was not tested, and what would bring it."""

import importlib
import re
from collections import Counter
from collections.abc import Iterable
from types import ModuleType
from typing import NoReturn

import pytest

_FORM = re.compile(r"NOT tested: (?P<what>.+?); (?P<remedy>[^;]+)$")


def skip(what: str, remedy: str) -> NoReturn:
    """Skip: `what` (a noun) is not tested here; `remedy` (what to do, without a semicolon) would bring it."""
    __tracebackhide__ = True  # the list of skipped tests names the test's line
    pytest.skip(f"NOT tested: {what}; {remedy}")


def module(name: str, what: str, remedy: str) -> ModuleType:
    """The module called `name`, or a skip as by `skip`."""
    __tracebackhide__ = True
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        skip(what, remedy)
    except ImportError as error:  # it is there, but a library of the system's that it calls is not
        skip(what, f"mend {name}, which cannot be loaded ({str(error).replace(';', ',')})")


def closing_line(reasons: Iterable[str]) -> str:
    """One line on these reasons of skipped tests, one part per remedy, the most tests first; "" for none.

    Reasons in another form than `skip` gives them are counted and left to the list above the line.
    """
    tests: Counter[str] = Counter()
    things: dict[str, list[str]] = {}
    for reason in reasons:
        found = _FORM.search(reason)
        remedy = found["remedy"] if found else "listed above"
        tests[remedy] += 1
        what = found["what"] if found else "what cannot be tried on this machine"
        if what not in things.setdefault(remedy, []):
            things[remedy].append(what)
    parts = [f"{', '.join(things[r])} ({n} {'test' if n == 1 else 'tests'}: {r})" for r, n in tests.most_common()]
    return "Not tested: " + "; ".join(parts) + "." if parts else ""
