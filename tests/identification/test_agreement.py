"""χ² of a difference between sources is that of their samples: what was vague is no source."""

import numpy as np
import pytest

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.identification.agreement import Sources

SIGMA = 2.0
"""σ of what each source says, as large as that of the prior."""


def said(value, entries):
    """Return what a source says of the first entries of a target of ten."""
    rows = np.column_stack([np.eye(10)[:entries], np.full(entries, value)]) / SIGMA
    return Gaussian.of_rows({"target": 10}, rows)


@pytest.mark.parametrize("entries", [10, 6])
def test_chi_squared_of_a_difference_has_no_prior_in_it(entries):
    """Two sources with values 3 and 7 of some entries: (7 − 3)² / (σ² + σ²) for each of these."""
    vague = Gaussian.of_rows({"target": 10}, np.column_stack([np.eye(10), np.zeros(10)]) / SIGMA)
    gaussians = {"one": said(3.0, 10), "other": said(7.0, entries)}
    sources = Sources(vague, gaussians, "target", np.full(10, 1e3))
    chi_squared, freedom = sources.difference(["one"], ["other"])
    assert freedom == entries
    assert chi_squared == pytest.approx(entries * 16 / (2 * SIGMA**2), rel=1e-3)
