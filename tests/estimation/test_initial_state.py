"""What is known before the first block does not depend on the nominal values."""

import numpy as np
import pytest
from block_cases import make_case
from sensing_cases import coarse_suite

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.block_state import solution
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.identification.fit_setup import prior_of
from cpid_drake.sensing.sensors import JointSensor

SUITE = coarse_suite(encoders=JointSensor(20.0, 1e-5, zero_mrad=10.0))


@pytest.mark.parametrize("nominal", [np.zeros(4), np.array([0.5, -0.3, 1.2, 0.0])])
def test_joint_zeros_are_most_likely_zero(nominal, tmp_path, skewed_target):
    case = make_case(tmp_path, skewed_target, SUITE, duration=1.0)
    solver, prior = case.solver(), prior_of(case.craft.tree, TotalMomentum.zero())
    block = case.block(-1e-7, 1.0, case.samples)
    known = initial_state(solver, prior, prior.psi, block, nominal)
    place = solver.places["encoders.zero"]
    change = solution(known.root, known.rest, None)[place]
    np.testing.assert_allclose(known.nominal.constants, nominal)
    np.testing.assert_allclose(known.nominal.constants + change, 0.0, atol=1e-12)
