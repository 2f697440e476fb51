"""Numbers are printed with the digits that their σ gives a meaning, and read back as they are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cpid_drake.files.digits import (
    decimals,
    decimals_of,
    rounded_pair,
    significant,
    with_half_width,
)

SIZES = st.floats(1e-12, 1e12)


@pytest.mark.parametrize(
    ("value", "text"),
    [(114.3, "110"), (-2.84, "-2.8"), (0.0000123, "0.000012"), (999.9, "1000"), (0.0, "0")],
)
def test_two_digits_are_written_out(value, text):
    assert significant(value) == text


@given(SIZES, st.sampled_from([-1, 1]))
def test_two_digits_are_within_half_of_the_last_one(size, sign):
    value = sign * size
    assert float(significant(value)) == pytest.approx(value, rel=0.0501)


@given(st.floats(1e-6, 9.9e8))
def test_a_number_of_sigma_has_no_exponent(value):
    assert "e" not in significant(value)


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (8.4951, 0.0172, "8.495 ± 0.017"),
        (1234.0, 110.0, "1230 ± 110"),
        (3.2e-6, 1.2e-7, "3.20e-06 ± 0.12e-06"),
        (-0.0001, 0.02, "0.000 ± 0.020"),
        (8.5, np.nan, "8.5 ± nan"),
    ],
)
def test_a_value_has_the_digits_of_its_interval(value, half, text):
    assert with_half_width(value, half) == text


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e6))
def test_rounding_is_small_beside_the_interval(value, half):
    shown, spread = map(float, rounded_pair(value, half))
    assert abs(shown - value) <= 0.0501 * half + 1e-9 * abs(value)
    assert spread == pytest.approx(half, rel=0.0501)


@given(st.floats(1e-8, 100.0))
def test_an_interval_is_shown_with_three_digits(width):
    assert 100 <= round(width * 10 ** decimals(width), 6) < 1000


def test_a_single_bound_has_three_digits():
    assert decimals_of(1.454171, np.nan) == decimals_of(np.nan, -1.454171) == 2
