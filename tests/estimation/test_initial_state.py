"""What is known before the first block does not depend on the nominal values."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import make_case
from sensing_cases import coarse_suite

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.block_state import solution
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.identification.fit_setup import prior_of
from cpid_drake.sensing.sensors import JointSensor

PLAIN = coarse_suite(encoders=JointSensor(20.0, 1e-5, zero_mrad=10.0))
SUITE = replace(PLAIN, attitude=replace(PLAIN.attitude, delay_ms=20.0, mounting_arcsec=300.0))


@pytest.mark.parametrize("size", [0.0, 0.5, 3.0])
def test_constant_errors_are_most_likely_zero(size, tmp_path, skewed_target):
    """Delay (1), mounting (3) and zeros (4), about whatever values."""
    case = make_case(tmp_path, skewed_target, SUITE, duration=1.0)
    solver, prior = case.solver(), prior_of(case.craft.tree, TotalMomentum.zero())
    nominal = size * np.array([0.5, -0.3, 1.2, 0.0, 1.0, -1.0, 0.2, 0.7])
    block = case.block(-1e-7, 1.0, case.samples)
    known = initial_state(solver, prior, prior.psi, block, nominal)
    change = solution(known.root, known.rest, None)
    np.testing.assert_allclose(known.nominal.constants, nominal)
    for name in ("attitude.delay", "attitude.mounting", "encoders.zero"):
        of_error = solver.constants.place(name)
        values = known.nominal.constants[of_error] + change[solver.places[name]]
        np.testing.assert_allclose(values, 0.0, atol=1e-12)
    np.testing.assert_allclose(known.best_constants(prior.psi), 0.0, atol=1e-12)
