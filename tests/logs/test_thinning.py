"""Selections of long series are even and bounded, however the series is cut into parts."""

import numpy as np
import pytest

from cpid_drake.logs.log import Samples
from cpid_drake.logs.thinning import EvenSelection


@pytest.mark.parametrize("part", [1, 7, 64, 10_000])
@pytest.mark.parametrize("count", [1, 99, 100, 101, 1234])
def test_every_kth_sample_is_kept_and_k_is_as_small_as_possible(part, count):
    time = np.arange(count, dtype=float)
    selection = EvenSelection(100)
    for start in range(0, count, part):
        piece = time[start : start + part]
        selection.add(Samples(piece, piece[:, None, None] * np.ones((2, 3))))
    samples = selection.samples()
    np.testing.assert_array_equal(samples.time, time[:: selection.every])
    np.testing.assert_array_equal(samples.value[:, 1, 2], samples.time)
    assert selection.count == count
    assert len(samples) <= 100
    assert selection.every == 1 or len(time[:: selection.every // 2]) > 100
