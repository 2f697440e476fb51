"""A guess of the target beforehand: what it is worth to a filter, and that it is not overrated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured, small_craft

from cpid_drake import InertialParameters, TargetPrior
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.online import run
from cpid_drake.estimation.unknowns import Model
from cpid_drake.identification.online import identification_of_state
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor
from cpid_drake.simulation.noise import SensorNoise

SIGMA, SEEDS = 0.15, 5
POOR = {
    "attitude": AttitudeSensor(5.0, 200.0, 1600.0, np.array([0.0, 0.6, 0.8])),
    "gyro": Gyro(20.0, 0.3, 60.0, 6.0),
    "position": VectorSensor(5.0, 2e-2),
    "encoders": JointSensor(20.0, 1e-4),
}


def drawn_prior(truth, rng) -> TargetPrior:
    """Return a rigid body that differs from the true one as the prior says."""
    sigma = SIGMA * parameter_scale(truth)
    while True:
        guess = truth + sigma * rng.normal(size=10)
        if InertialParameters.from_vector(guess).is_physically_consistent():
            return TargetPrior("a guess", guess, np.diag(sigma**2))


@pytest.mark.slow
def test_poor_sensors_and_a_guess_know_more_than_poor_sensors(tmp_path, skewed_target):
    """After 1.5 s errors are smaller with guesses that err as they say, and σ tells how large."""
    craft, suite = small_craft(tmp_path), coarse_suite(**POOR)
    truth = skewed_target.to_vector()
    perfect = measured(craft, Sines.drawn(4, 3, 1.5), skewed_target, suite)
    squares, errors = [], {"guess": [], "nothing": []}
    for seed in range(SEEDS):
        noise = SensorNoise(suite, seed)
        noisy = {}
        for name in suite.present():
            samples = getattr(perfect, name)
            noisy[name] = Samples(samples.time, noise.apply(name, samples.value))
        vague = Model(craft.tree, suite)
        prior = drawn_prior(truth, np.random.default_rng(1000 + seed)).of_psi(vague)
        for name, model in (("guess", replace(vague, rows=(prior,))), ("nothing", vague)):
            state = run(model, [perfect.updated(noisy)])
            result = identification_of_state(model, state, TotalMomentum.zero())
            error = result.parameters - truth
            errors[name].append(error)
            if name == "guess":
                squares.append(error @ np.linalg.solve(result.covariance, error))
    with_guess, without = (np.sqrt(np.mean(np.square(each), axis=0)) for each in errors.values())
    assert (with_guess < 1.1 * without).all()
    assert with_guess[4:].sum() < 0.7 * without[4:].sum()
    low, high = chi2.ppf([0.001, 0.999], 10 * SEEDS)
    assert low < np.sum(squares) < high
