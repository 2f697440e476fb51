"""The noise level of a log is that of its good samples."""

import numpy as np
import pytest

from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Samples
from cpid_drake.logs.noise_estimation import noise_level, rounding


def test_rare_outliers_do_not_change_the_noise_level():
    """One sample in a thousand is off by a hundred σ: the root mean square would be five σ."""
    rng = np.random.default_rng(3)
    time, sigma = np.arange(0.0, 40.0, 0.01), 1e-3
    value = np.sin(time)[:, None] * [1.0, 2.0, -1.0] + sigma * rng.normal(size=(time.size, 3))
    value[500::1000] += 100 * sigma
    assert noise_level(Samples(time, value)) == pytest.approx(sigma, rel=0.1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("count", [0, 1, 4])
def test_a_few_samples_show_no_noise(count):
    with pytest.raises(InputError, match=f"{count} samples are too few"):
        noise_level(Samples(np.arange(float(count)), np.zeros((count, 3))))


@pytest.mark.parametrize(("size", "decimals"), [(1e-5, 3), (1e-4, 9), (1.0, 1), (3e3, 6)])
def test_the_last_decimal_of_rounded_numbers_is_found(size, decimals):
    values = size * np.random.default_rng(1).normal(size=(200, 3))
    assert rounding(values) < 1e-9  # all digits, however small the numbers are
    rounded = np.round(values, decimals)
    assert rounding(rounded) == (10.0**-decimals if rounded.any() else 0.0)
