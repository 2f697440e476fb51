"""What a result warns of, whoever reads it."""

from functools import partial

import pytest
from sensing_cases import Sines, coarse_suite, measured, small_craft

from cpid_drake import identify
from cpid_drake.estimation.trajectory_fit import fit_trajectory
from cpid_drake.identification import fit_estimator
from cpid_drake.sensing.noise import add_noise


@pytest.mark.parametrize("iterations", [1, 60])
def test_a_fit_that_does_not_converge_says_so(tmp_path, skewed_target, monkeypatch, iterations):
    monkeypatch.setattr(
        fit_estimator, "fit_trajectory", partial(fit_trajectory, max_iterations=iterations)
    )
    craft, suite = small_craft(tmp_path), coarse_suite()
    motion = Sines.drawn(4, seed=101, duration=5.0, size=0.6)
    samples = add_noise(suite, measured(craft, motion, skewed_target, suite), seed=1)
    found = identify(craft, samples, sensors=suite, estimator="trajectory_fit")
    assert found.converged == (iterations > 1)
    warned = any("did not converge" in warning for warning in found.warnings)
    assert warned == (iterations == 1)
