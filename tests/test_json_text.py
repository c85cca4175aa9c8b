"""Numbers of foreign JSON: none overflows, those that mean something stay what they are."""

import math

import numpy as np
import pytest

from hypose.json_text import parse_json


@pytest.mark.parametrize("value", [0, -7, 2**53 + 1, 1_795_000_000_123_456_789, 2**63 - 1, -(2**63)])
def test_integers_of_64_bits_stay_exact(value):
    read = parse_json(f'{{"n": [{value}]}}')["n"][0]
    assert isinstance(read, int) and read == value


@pytest.mark.parametrize("digits", [str(2**63), "9" * 20, "9" * 21, "1" + "0" * 308, "-" + "9" * 5000])
def test_larger_ones_are_floats_that_fit_into_arrays(digits):
    read = parse_json(digits)
    assert isinstance(read, float)
    assert np.array([read]).dtype == np.float64 and math.copysign(1, read) == (-1 if digits[0] == "-" else 1)
    assert math.isinf(read) == (len(digits) > 309)


def test_what_is_no_json_is_a_value_error():
    for text in ("{", b"\xff\xfe", "[1,]"):
        with pytest.raises(ValueError):
            parse_json(text)
