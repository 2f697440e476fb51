"""The noise that samples show: rounding is recognized, and numbers of all digits have none."""

import numpy as np
import pytest

from cpid_drake.identification.sample_noise import rounding


@pytest.mark.parametrize("size", [1e-5, 1e-4, 1.0, 3e3])
@pytest.mark.parametrize("decimals", [1, 3, 6, 9])
def test_the_last_decimal_of_rounded_numbers_is_found(size, decimals):
    values = size * np.random.default_rng(1).normal(size=(200, 3))
    assert rounding(values) < 1e-9  # all digits, however small the numbers are
    rounded = np.round(values, decimals)
    assert rounding(rounded) == (10.0**-decimals if rounded.any() else 0.0)
