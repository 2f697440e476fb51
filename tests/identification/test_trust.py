"""No path to an answer leads around the gate: what is wrong is estimated, or the answer doubted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    log_of,
    measured,
    nees,
    sigmas,
    small_craft,
    true_telemetry,
)

from cpid_drake import (
    InertialParameters,
    identify,
    load_scenario,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.gaussian import Gaussian, solution_of
from cpid_drake.identification.checks import fit_checks
from cpid_drake.identification.consistency import checked
from cpid_drake.identification.observed import Observed
from cpid_drake.identification.result import Identification
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.suite import SensorSuite

DURATION = 6.0
KNOWN_SENSORS = {"sample_count": 100, "estimator": "trajectory_fit", "sensors": SensorSuite()}
SECOND_IS_SLOW = ("least_squares", pytest.param("trajectory_fit", marks=pytest.mark.slow))
"""A fit to a log that nothing explains takes long."""


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=101, duration=DURATION, size=0.6)


def errors_in_sigma(found, target):
    return (found.parameters - target.to_vector()) / sigmas(found)


class TestMomentum:
    @pytest.mark.parametrize("momentum_W", [None, MOMENTUM])
    def test_standard_rows_test_the_momentum_for_eq18(
        self, craft, motion, skewed_target, momentum_W
    ):
        names, times = craft.joint_names, np.arange(0.0, 5.0, 0.05)
        exact = true_telemetry(craft.tree, names, motion, skewed_target, times, momentum_W)
        found = identify(craft, exact, rows="eq18")
        assert any("eq18 cannot estimate it" in d for d in found.failures) == (
            momentum_W is not None
        )


class TestBodies:
    """Only estimates that some rigid body may have pass."""

    def found(self, craft, parameters, widths) -> Identification:
        """Return an identification with independent errors of its parameters."""
        form = relative_parameterization(craft.mass)
        psi = form.from_parameters(np.array(parameters, dtype=float))
        R = form.jacobian(psi) / np.array(widths, dtype=float)[:, None]
        told = Gaussian.of_rows({"psi": 10}, np.column_stack([R, R @ psi]))
        solution = solution_of(told, psi, 1e6 * np.ones(10))
        return Identification.of_solution(form, solution, **KNOWN_SENSORS)

    def weakly_known(self, craft, share) -> Identification:
        """Return an identification of ψ, in which σ of the mass is this share of it."""
        form = relative_parameterization(craft.mass)
        body = InertialParameters(20.0, [0.4, 0.1, -0.3], np.diag([3.0, 4.0, 5.0]))
        psi = form.from_parameters(body.to_vector())
        R = np.diag(1 / np.array([share * psi[0], *3 * [0.01], *6 * [0.02]]))
        told = Gaussian.of_rows({"psi": 10}, np.column_stack([R, R @ psi]))
        return Identification.of_solution(
            form, solution_of(told, psi, 1e6 * np.ones(10)), **KNOWN_SENSORS
        )

    @pytest.mark.parametrize(
        "share", [*(pytest.param(each, marks=pytest.mark.slow) for each in (1e-3, 0.1)), 0.3]
    )
    def test_intervals_are_the_extreme_values_within_what_is_known(self, craft, share):
        """With the mass, all others change, and not in proportion."""
        found = self.weakly_known(craft, share)
        U = np.linalg.inv(found.solution.determined.R)

        def value(z, i, sign):
            psi = found.solution.values + U @ (1.959964 * z / np.linalg.norm(z))
            return -sign * found.form.to_parameters(psi)[i]

        for i in range(10):
            for side, sign in enumerate((-1, 1)):
                starts = np.vstack([np.eye(10), -np.eye(10)])[[0, 10, 1, 11, 4, 14]] + 0.01
                least = min(minimize(value, z, (i, sign)).fun for z in starts)
                end, width = found.intervals[i, side], np.diff(found.intervals[i])[0]
                assert abs(end + sign * least) < 0.02 * width

    def test_a_centre_of_mass_is_not_known_where_the_mass_may_be_zero(self, craft):
        found = self.weakly_known(craft, 0.6)
        assert found.intervals[0, 0] < 0 < 20 < found.intervals[0, 1]
        assert np.isnan(found.parameters[1:]).all()
        assert not found.is_complete
        assert "interval of m contains zero" in found.explain()

    @pytest.mark.parametrize(
        ("mass", "moments", "sigma", "said"),
        [
            (50, (5.0, 6.0, 7.0), 0.01, ""),
            (50, (5.0, 6.0, 11.2), 0.1, ""),  # beyond the triangle inequality by one σ
            (50, (5.0, 6.0, 12.5), 0.1, "moments"),  # by nine σ
            (50, (5.0, 6.0, 11.0), 1e-9, ""),  # a flat body
            (50, (-2.0, 6.0, 7.0), 0.1, "moments"),
            (-10, (5.0, 6.0, 7.0), 0.1, "the mass -10 kg is not positive"),
        ],
    )
    def test_the_distance_to_a_rigid_body_is_measured_in_sigma(
        self, craft, mass, moments, sigma, said
    ):
        widths = [0.1, *3 * [1e-3], *6 * [sigma]]
        found = checked(self.found(craft, [mass, 0.1, 0, 0, *moments, 0, 0, 0], widths), craft.tree)
        assert found.passed == (not said)
        assert said in "".join(found.failures)

    def test_what_is_known_roughly_is_not_shown(self, craft):
        """The σ of Ixx is half its size; the others are known all the same."""
        form = relative_parameterization(craft.mass)
        psi = form.from_parameters(np.array([50, 0, 0, 0, 5.0, 6, 7, 0, 0, 0], dtype=float))
        scale = np.where(psi > 1e-9, psi, 5.0)
        sigma = np.where(np.arange(10) == 4, 0.5, 1e-3) * scale
        told = Gaussian.of_rows({"psi": 10}, np.column_stack([np.diag(1 / sigma), psi / sigma]))
        solution = solution_of(told, psi, scale)
        found = checked(Identification.of_solution(form, solution, **KNOWN_SENSORS), craft.tree)
        assert np.flatnonzero(np.isnan(found.parameters)).tolist() == [4]
        assert not found.is_complete
        assert "Not identifiable: 1 combination of Ixx" in found.explain()
        assert found.consistent is None

    @pytest.mark.parametrize("factor", [3.0, 44.0])
    def test_a_floor_that_is_far_noisier_than_declared_fails(self, factor):
        """A push from outside looks like white forces, which leave no residuals to test."""
        failed = [c for c in fit_checks(True, Observed(noise={"acceleration_noise": factor}))]
        assert any(not c.passed and "acceleration noise 44" in c.sentence for c in failed) == (
            factor > 4
        )


class TestNoiseInRegressors:
    @pytest.mark.parametrize("decimals", [3, 4, 6, 9])
    def test_intervals_of_rounded_logs_hold(self, craft, motion, skewed_target, decimals):
        times = np.arange(0.0, DURATION, 0.02)
        telemetry = true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, times)
        found = identify(craft, log_of(telemetry, decimals))
        assert found.passed
        assert np.abs(errors_in_sigma(found, skewed_target)).max() < 4

    @pytest.mark.parametrize("estimator", SECOND_IS_SLOW)
    def test_a_wrong_joint_in_a_noisy_log_is_found_or_a_failed_check(
        self, craft, motion, suite, skewed_target, estimator
    ):
        samples = add_noise(suite, measured(craft, motion, skewed_target, suite), seed=5)
        encoders = samples.encoders
        value = encoders.value + np.array([0.0, 0.0, 0.1, 0.0])
        spoiled = samples.updated({"encoders": Samples(encoders.time, value)})
        for sensors in (suite, replace(suite, unstated=None)):
            found = identify(craft, spoiled, sensors=sensors, estimator=estimator)
            assert not found.passed


@pytest.mark.parametrize(
    ("joint", "drift"), [(1, 0.0), (1, 5e-4), (2, 2e-4)], ids=["none", "slide", "elbow"]
)
def test_a_joint_that_drifts_is_in_the_intervals(craft, suite, skewed_target, joint, drift):
    """By 0.5 mm or 0.2 mrad in 10 s: many σ of the target, and no residual shows it."""
    motion = Sines.drawn(4, seed=101, duration=10.0, size=0.6)
    samples = measured(craft, motion, skewed_target, suite)
    time, value = samples.encoders.time, samples.encoders.value
    moved = value + drift * np.outer(time / 10.0, np.arange(4) == joint)
    samples = samples.updated({"encoders": Samples(time, moved)})
    sensors = replace(suite, unstated=None)
    found = identify(craft, add_noise(suite, samples, seed=0), sensors=sensors)
    assert found.passed
    assert nees(found, skewed_target) < chi2.isf(1e-3, 10)
    [effect] = [each for each in found.effects if each.name == "encoders.drift"]
    expected = 100 * drift * (np.arange(4) == joint)
    assert (np.abs(effect.value - expected) < 4 * effect.sigma).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_only_noise_moves_is_not_known(paper_target, suite, seed):
    """Three parallel joints move the base in its plane of symmetry, and noise out of this plane."""
    craft = make_simulation(load_scenario(shipped_scenario("single_arm_wheels"))).spacecraft
    middle = {"arm_joint2": -0.8, "arm_joint4": 1.3, "arm_joint6": 0.6}
    moving = np.isin(craft.joint_names, list(middle))
    motion = Sines.drawn(len(moving), seed=seed, duration=10.0, size=0.3)
    at = np.array([middle.get(name, 0.0) for name in craft.joint_names])
    motion = replace(motion, middle=at, amplitude=motion.amplitude * moving)
    samples = measured(craft, motion, paper_target, suite)
    found = identify(craft, add_noise(suite, samples, seed=seed), sensors=suite)
    assert np.isnan(found.parameters[[4, 6]]).all()
    known = np.isfinite(found.parameters)
    assert nees(found, paper_target) < chi2.isf(1e-3, known.sum())


def test_a_momentum_too_small_to_be_noticed_is_in_the_intervals(craft, suite, skewed_target):
    """1.3 mN·m·s are 2.6 σ of the momentum, and 8 σ of a target that is fitted with zero."""
    motion = Sines.drawn(4, seed=101, duration=5.0, size=0.6)
    momentum_W = np.array([-0.35e-3, -0.64e-3, -1.08e-3, 0.0, 0.0, 0.0])
    samples = measured(craft, motion, skewed_target, suite, momentum_W)
    found = identify(craft, add_noise(suite, samples, seed=1), sensors=suite)
    assert nees(found, skewed_target) < chi2.isf(1e-4, 10) or not found.passed


def test_an_exact_point_mass_is_not_doubted(tmp_path):
    """Its inertia about its centre of mass is zero up to rounding, of either sign."""
    craft = small_craft(tmp_path)
    point = InertialParameters(20.0, [0.4, 0.1, -0.2], np.zeros((3, 3)))
    exact = true_telemetry(
        craft.tree, craft.joint_names, Sines.drawn(4, 1, 10.0), point, np.arange(0, 10, 0.1)
    )
    for rows in ("standard", "relative", "eq18"):
        assert identify(craft, exact, rows=rows).passed
