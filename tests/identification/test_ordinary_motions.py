"""Ordinary motions, also weak and noisy ones, are answered, and the answers are right."""

import pytest
from ordinary_cases import Design
from reference.ordinary import answer, band

pytestmark = pytest.mark.slow

NUMBERS = [number for number in range(30) if Design(number).sensors != "coarse"][:24]
"""Logs of all crafts and motions.

The encoders of "coarse" have 12 bits: at rest, their rounding is no white noise, which they
declare, and a log of joints that rest for long can be off by 6 σ.
"""


def test_ordinary_motions_are_identified():
    """All ten parameters are known, or it is said what is open; the errors are as σ says."""
    answers = [answer(Design(number)) for number in NUMBERS]
    assert not [str(each) for each in answers if not each.answered]
    assert not [str(each) for each in answers if not each.converged or sum(each.sweeps) > 20]
    low, high = band(sum(each.rank for each in answers))
    assert low < sum(each.nees for each in answers) < high
    assert not [str(each) for each in answers if each.worst > 4.5]  # of 240: 0.2 %
