"""Online estimation: consistent, in spite of faults, and aware of thrusters."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from cpid_drake import load_scenario, load_sensors, shipped_scenario
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.momentum_filter import BIAS, vague_prior
from cpid_drake.identification.filter_estimator import (
    identification_of_filter,
    online_estimator,
)
from cpid_drake.identification.fit_estimator import fit_measurements
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.noise import SensorNoise, add_noise
from cpid_drake.studies import trials

FIRED = (3.0, np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0]))
END = 6.0


@pytest.fixture(scope="module")
def cases():
    """Return a function (suite, momentum, firing) -> (spacecraft, suite, perfect, truth)."""
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    spacecraft = scenario.spacecraft.make()
    truth = scenario.target_truth()
    made = {}

    def make(name="flight", firing=None):
        key = (name, firing is None)
        if key not in made:
            suite = load_sensors(name)
            case = trials.make_case(scenario, spacecraft, truth, suite, (), 0)
            case = replace(case, duration=END, firing=firing)
            perfect = trials.ideal_samples(case, spacecraft.tree, spacecraft.joint_names)
            made[key] = spacecraft, suite, perfect, truth
        return made[key]

    return make


def run(spacecraft, suite, measurements, unknown_momentum=False):
    online = online_estimator(
        spacecraft, suite, momentum=TotalMomentum(is_unknown=unknown_momentum)
    )
    state = online.run(measurements)
    return identification_of_filter(online, state), state.filter


def nees(result, truth):
    error = result.parameters - truth.to_vector()
    sigma = np.sqrt(np.diag(result.covariance))
    unit = result.covariance / sigma / sigma[:, None]
    return error / sigma @ np.linalg.solve(unit, error / sigma)


@pytest.mark.parametrize(
    ("name", "unknown"), [("flight", False), ("flight", True), ("testbed", False)]
)
def test_errors_are_what_the_covariance_says(cases, name, unknown):
    spacecraft, suite, perfect, truth = cases(name)
    seeds = range(5)
    values = []
    for seed in seeds:
        result, state = run(spacecraft, suite, add_noise(suite, perfect, seed), unknown)
        assert result.is_observable
        assert state.momentum_changes == 0
        assert np.linalg.eigvalsh(state.P).min() > -1e-12 * np.abs(state.P).max()
        values.append(nees(result, truth))
    low, high = chi2.ppf([0.0005, 0.9995], 10 * len(values)) / len(values)
    assert low < np.mean(values) < high


def test_a_walking_bias_is_as_near_as_its_covariance_says(cases):
    """A bias that walks some degrees per hour in an hour is followed, no better and no worse."""
    spacecraft, suite, perfect, _ = cases("flight")
    walking = replace(suite, gyro=replace(suite.gyro, bias_random_walk=5.0))
    squares, seeds = [], range(4)
    for seed in seeds:
        _, state = run(spacecraft, walking, add_noise(walking, perfect, seed))
        count = len(perfect.gyro)
        error = SensorNoise(walking, seed).gyro_bias(count)[-1] - state.bias
        squares.append(error @ np.linalg.solve(state.P[BIAS, BIAS], error))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(seeds)) / len(seeds)
    assert low < np.mean(squares) < high


def test_the_filter_begins_with_the_bias_at_the_end_of_the_fit(cases):
    """A bias that walks has a node a second: value and covariance are those of the last one."""
    spacecraft, suite, perfect, _ = cases("flight")
    walking = replace(suite, gyro=replace(suite.gyro, bias_random_walk=5.0))
    samples = add_noise(walking, perfect, 1).between(0.0, 3.0)
    fit = fit_measurements(spacecraft.tree, samples, walking)
    state = online_estimator(spacecraft, walking).filter_state(fit)
    np.testing.assert_array_equal(state.bias, fit.state.bias[-1])
    covariance = np.linalg.inv(fit.information)
    last = fit.model.columns["bias"].stop
    expected = covariance[last - 3 : last, last - 3 : last]
    np.testing.assert_allclose(state.P[BIAS, BIAS], expected, rtol=1e-3, atol=1e-3 * expected.max())


def test_it_works_without_a_gyro(cases):
    spacecraft, suite, perfect, truth = cases("testbed")
    blind = replace(suite, gyro=None)
    empty = Samples(np.empty(0), np.empty((0, 3)))
    values = []
    for seed in range(3):
        measurements = replace(add_noise(suite, perfect, seed), gyro=empty)
        result, _ = run(spacecraft, blind, measurements)
        values.append(nees(result, truth))
    assert np.mean(values) < chi2.ppf(0.9995, 30) / 3


def test_a_firing_is_seen_within_a_second_and_forgotten(cases):
    spacecraft, suite, perfect, truth = cases("flight", firing=FIRED)
    values = []
    for seed in range(4):
        result, state = run(spacecraft, suite, add_noise(suite, perfect, seed))
        assert state.momentum_changes >= 1
        assert 0 < state.momentum_change_time - FIRED[0] < 1.0
        values.append(nees(result, truth))
    assert np.mean(values) < chi2.ppf(0.9995, 40) / 4


def spoil(samples, at, fault):
    """Return samples with one fault after a time."""
    time, value = samples.time.copy(), samples.value.copy()
    k = int(np.searchsorted(time, at))
    if fault == "nan":
        value[k, 0] = np.nan
    elif fault == "infinite stamp":
        time[k] = np.inf
    elif fault == "repeated":
        time[k] = time[k - 1]
    elif fault == "backwards":
        time[k] = time[k - 1] - 0.3
    elif fault == "far ahead":
        time[k] = 1e9
    elif fault == "huge":
        value[k] = 1e12
    elif fault == "zero":
        value[k] = 0.0
    elif fault == "sign":
        value[k:] = -value[k:]
    elif fault == "dropout":
        keep = (time < at) | (time > at + 0.5)
        time, value = time[keep], value[keep]
    return Samples(time, value)


COUNTED = ("nan", "infinite stamp", "repeated", "backwards", "far ahead")


@pytest.mark.parametrize("at", [0.5, 3.5], ids=["while fitting", "while filtering"])
@pytest.mark.parametrize(
    ("name", "fault"),
    [(name, fault) for name in ("attitude", "gyro", "position", "encoders") for fault in COUNTED]
    + [(name, "dropout") for name in ("attitude", "gyro", "position", "encoders")]
    + [("attitude", "sign"), ("attitude", "zero"), ("gyro", "huge"), ("position", "huge")],
)
def test_faults_do_not_poison_the_estimate(cases, name, fault, at):
    spacecraft, suite, perfect, truth = cases("flight")
    clean = add_noise(suite, perfect, 1)
    measurements = replace(clean, **{name: spoil(getattr(clean, name), at, fault)})
    online = online_estimator(spacecraft, suite)
    state = online.start()
    order = sorted(
        (
            (k / getattr(suite, sensor).rate, rank, sensor, time, value)
            for rank, sensor in enumerate(("gyro", "attitude", "encoders", "position"))
            for k, (time, value) in enumerate(
                zip(getattr(measurements, sensor).time, getattr(measurements, sensor).value)
            )
        ),
        key=lambda sample: sample[:2],
    )
    for _, _, sensor, time, value in order:  # in the order in which they were taken
        online.process(state, sensor, time, value)
    result = identification_of_filter(online, state)
    assert np.isfinite(state.filter.P).all()
    assert np.isfinite(result.parameters).all()
    error = np.abs(result.parameters - truth.to_vector())
    assert (error < 5 * np.sqrt(np.diag(result.covariance))).all()
    # A gap before the first fit may cost a new beginning, and that is counted as a change.
    assert state.filter.momentum_changes <= (fault == "dropout" and at < 1.0)
    if fault in COUNTED:
        assert state.filter.rejected[online.filter.index(name)] >= 1
    assert result.feasible().is_feasible()


def test_the_prior_is_vague_and_possible(servicer):
    still = np.zeros((1, len(servicer.joint_names)))
    inertia = relative_dynamics(servicer.tree, still, still).I_K[0]
    prior = vague_prior(servicer.mass, inertia)
    parameters = relative_parameterization(servicer.mass).to_parameters(prior.psi)
    assert 0 < parameters[0] < servicer.mass
    assert (prior.psi_sigma[[0, 4, 7, 9]] > prior.psi[[0, 4, 7, 9]]).all()


def test_before_the_first_fit_nothing_is_claimed(cases):
    spacecraft, suite, perfect, _ = cases("flight")
    result, _ = run(spacecraft, suite, add_noise(suite, perfect, 0).between(0.0, 0.5))
    assert result.solution.rank == 0
    assert np.isnan(result.parameters).all()
    assert result.spatial_inertia().IsNaN()
