"""Ordinary motions, also weak and noisy ones, are answered, and the answers are right."""

import numpy as np
import pytest
from ordinary_cases import Design, make
from scipy.stats import chi2
from worlds.answers import answer

pytestmark = pytest.mark.slow

NUMBERS = [number for number in range(30) if Design(number).sensors != "coarse"][:24]
"""Logs of all crafts and motions.

The encoders of "coarse" have 12 bits: at rest, their rounding is no white noise, which they
declare, and a log of joints that rest for long can be off by 6 σ.
"""


def test_ordinary_motions_are_identified():
    """All ten parameters are known, or it is said what is open; the errors are as σ says."""
    answers = []
    for number in NUMBERS:
        case, sweeps = make(Design(number)), []
        found = answer(
            case.spacecraft,
            case.log,
            case.truth.to_vector(),
            sensors=case.sensors,
            planar=True if case.spacecraft.tree.normal_B is not None else None,
            progress=lambda step, sweeps=sweeps: sweeps.append("sweep" in step),
        )
        name = f"{case.design}: {found}"
        answers.append(found)
        assert found.code == 0 or (found.code == 3 and found.said), name
        assert found.converged, name
        assert sum(sweeps) <= 18, name
        assert found.worst < 4.5, name  # of 240: 0.2 %
    low, high = chi2.ppf([5e-4, 1 - 5e-4], sum(each.rank for each in answers))
    assert low < np.nansum([each.nees for each in answers]) < high
