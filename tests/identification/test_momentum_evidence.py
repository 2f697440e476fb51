"""What counts as evidence against a total momentum of zero."""

from dataclasses import replace

import pytest
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake import TotalMomentum, identify
from cpid_drake.identification.momentum_test import CONTRADICTED, _contradicts
from cpid_drake.identification.result import MomentumChanges


@pytest.fixture(scope="module")
def fits(craft, skewed_target):
    """Fits to samples of a momentum of zero: with a change of momentum, and an unknown one."""
    suite, motion = coarse_suite(), Sines.drawn(4, seed=101, duration=6.0, size=0.6)
    samples = measured(craft, motion, skewed_target, suite)
    zero, free = (
        identify(craft, samples, sensors=suite, momentum=momentum, is_final=False)
        for momentum in (TotalMomentum.zero(), TotalMomentum.unknown())
    )
    return replace(zero, momentum_changes=MomentumChanges(1, 3.0)), free


def test_an_unknown_momentum_that_needs_no_change_contradicts_zero(fits):
    zero, free = fits
    assert free.momentum_changes.count == 0
    assert _contradicts(zero, free, CONTRADICTED)


def test_a_fit_that_found_no_answer_contradicts_nothing(fits):
    zero, free = fits
    assert not _contradicts(zero, replace(free, misfit=300.0), CONTRADICTED)
