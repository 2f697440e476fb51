"""The information in closed form, against the exact Cramér-Rao bound; base and efforts."""

from dataclasses import replace

import numpy as np
import pytest
from planning_cases import Planned
from scipy.spatial.transform import Rotation

from cpid_drake import InertialParameters
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.planning.base_motion import BASE_LIMITS, PlannedBaseMotion, known_instants
from cpid_drake.planning.information import covariance
from cpid_drake.planning.prediction import Prediction, loads_of
from cpid_drake.simulation.trials import motions_of


@pytest.fixture(scope="module")
def exciting():
    return Planned("exciting_motion", "flight")


@pytest.mark.parametrize(
    ("name", "preset"),
    [
        ("paper", "flight"),
        pytest.param("tumbling_capture", "servicer", marks=pytest.mark.slow),
        pytest.param("exciting_motion", "coarse", marks=pytest.mark.slow),
        pytest.param("single_arm_wheels", "servicer", marks=pytest.mark.slow),
    ],
)
def test_it_is_the_exact_bound_if_the_encoders_are_good(name, preset):
    """Start, bias and an unknown momentum are eliminated; the grid changes σ by at most 4 %."""
    case = Planned(name, preset)
    exact = case.planner.predict(case.motion, case.parameters).sigma
    np.testing.assert_allclose(case.sigma() / exact, 1.0, atol=0.04)


@pytest.mark.slow
def test_on_a_table_four_parameters_are_determined():
    """Without mounting, lever arm, zeros and delay, which the closed form leaves out."""
    case = Planned("air_bearing", "air_bearing")
    suite = case.suite
    suite.attitude = replace(suite.attitude, mounting_arcsec=0.0)
    suite.position = replace(suite.position, lever_arm_mm=0.0)
    suite.encoders = replace(suite.encoders, zero_mrad=0.0, delay_ms=0.0)
    suite.disturbances = None
    exact = case.planner.predict(case.motion, case.parameters).sigma
    known = np.flatnonzero(np.isfinite(exact))
    np.testing.assert_array_equal(known, [0, 1, 2, 6])
    np.testing.assert_allclose((case.sigma() / exact)[known], 1.0, atol=0.04)
    found = case.planner.objective.sigmas(np.zeros((1, *case.planner.family.shape)))
    assert found.shape[-1] == 4


@pytest.mark.slow
def test_a_velocity_sensor_measures_the_rate_of_the_position(exciting):
    suite = replace(exciting.suite, velocity=replace(exciting.suite.position, sigma=1e-6))
    case = replace(exciting.planner.case(exciting.motion, exciting.parameters), suite=suite)
    exact = Prediction.of(case, exciting.spacecraft).sigma
    assert (exact / exciting.sigma()).min() < 0.8
    np.testing.assert_allclose(exciting.sigma(suite) / exact, 1.0, atol=0.04)


def test_a_known_momentum_turns_what_is_known_of_the_attitude():
    """A fast tumble of 130 N·m·s whose momentum is given, by a star tracker alone."""
    case = Planned("tumbling_capture", "flight")
    planned = case.planner.case(case.motion, case.parameters)
    planned = replace(planned, momentum_W=3 * planned.momentum_W)
    momentum = planned.total_momentum(case.spacecraft.tree)
    momentum = replace(momentum, is_unknown=False)
    suite = replace(case.suite, gyro=None, position=None)
    told = replace(planned, momentum=momentum, suite=suite)
    exact = Prediction.of(told, case.spacecraft).sigma
    found = case.sigma(suite, case.base(momentum=momentum))
    np.testing.assert_allclose(found / exact, 1.0, atol=0.04)


def test_a_bias_that_grows_leaves_less_of_the_gyro(exciting):
    """It is one constant, as uncertain as it is at the end: more is in the exact bound."""
    steady, growing = (
        exciting.sigma(
            replace(exciting.suite, gyro=replace(exciting.suite.gyro, bias_random_walk=walk))
        )
        for walk in (0.0, 3.0)
    )
    assert (growing > steady).all()
    assert (growing / steady).max() > 1.01


@pytest.mark.parametrize("name", ["exciting_motion", "tumbling_capture"])
def test_the_base_moves_as_in_the_propagated_motion(name):
    """Its turn, rate and displacement, also with momentum: an independent integration."""
    case = Planned(name, "flight")
    base = case.base()
    planned = case.planner.case(case.motion, case.parameters)
    [moved] = motions_of([planned], case.spacecraft.tree, case.spacecraft.joint_names, base.times)
    np.testing.assert_allclose(base.R, moved.R_WB, atol=3e-3)
    w_B = np.einsum("nji,nj->ni", moved.R_WB, moved.w_WB)
    np.testing.assert_allclose(base.w, w_B, atol=3e-3 * np.abs(w_B).max())
    found = base.lengths()
    expected = (
        Rotation.from_matrix(moved.R_WB[0].T @ moved.R_WB).magnitude(),
        np.linalg.norm(moved.w_WB, axis=1),
        np.linalg.norm(moved.p_WB - moved.p_WB[0], axis=1),
    )
    for limit, values in zip(BASE_LIMITS, expected, strict=True):
        np.testing.assert_allclose(found[limit][:, 0], values, atol=0.02 * values.max())


def test_efforts_are_those_of_drakes_inverse_dynamics(exciting):
    """The momentum's rate, against the mass matrix of the plant; more with a heavier target."""
    body, tree = exciting.truth, exciting.spacecraft.tree
    heavy = InertialParameters(3 * body.mass, body.p_CTcm_C, 3 * body.I_TTcm_C)
    peaks = []
    for target in (body, heavy):
        base = exciting.base(exciting.form.from_parameters(target.to_vector()))
        samples = exciting.motion.evaluate(base.times)[:, None, :2]
        found = np.abs(base.efforts(tree, samples, target.to_standard_vector())[:, 0])
        case = exciting.planner.case(exciting.motion, target.to_vector())
        [expected], _ = loads_of([case], exciting.spacecraft)
        np.testing.assert_allclose(found.max(axis=0), expected, rtol=0.1, atol=0.1)
        peaks.append(expected.max())
    assert peaks[1] > 1.3 * peaks[0]


def test_joints_at_rest_leave_what_is_known_before(exciting):
    """One prior of the target, which the fit has too: log-sizes about a plausible solid."""
    q = exciting.motion.evaluate(0.0)[0]
    times = np.linspace(0.0, 10.0, 61)
    samples = np.zeros((len(times), 1, 2, len(q)))
    samples[:, 0, 0] = q
    tree = exciting.spacecraft.tree
    at_rest = PlannedBaseMotion.of(
        times, known_instants(tree, samples), TotalMomentum.zero(), exciting.psi
    )
    [found] = covariance(Model(tree, exciting.suite), at_rest)
    prior = Model(tree, exciting.suite).cone.prior(PSI, exciting.psi)
    unit = np.sqrt(np.diag(prior.covariance()))
    np.testing.assert_allclose(
        found / unit / unit[:, None], prior.covariance() / unit / unit[:, None], atol=1e-6
    )
