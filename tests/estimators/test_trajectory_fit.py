"""The trajectory fit: right derivatives, the right optimum from anywhere, honest intervals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from cpid_drake import load_scenario, load_sensors, shipped_scenario
from cpid_drake.estimators.trajectory_fit import LogCholesky, fit_trajectory
from cpid_drake.estimators.trajectory_model import TrajectoryModel
from cpid_drake.inertia import InertialParameters, relative_unknowns, standard_to_pseudo_inertia
from cpid_drake.momentum_sensitivity import BodyUncertainty
from cpid_drake.sensor_identification import cramer_rao_bound, identification_of_fit
from cpid_drake.sensors import Samples, VectorSensor, add_noise
from cpid_drake.smoothing import smooth_joints
from cpid_drake.studies import accuracy

END = 5.0
TUMBLE = np.array([30.0, -20.0, 25.0, 4.0, 2.0, -3.0])


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(shipped_scenario("exciting_motion"))


@pytest.fixture(scope="module")
def spacecraft(scenario):
    return scenario.make_spacecraft()


@pytest.fixture(scope="module")
def target():
    inertia = [[22.0, 1.0, -0.5], [1.0, 28.0, 0.7], [-0.5, 0.7, 16.0]]
    return InertialParameters(100.0, [0.43, 0.05, -0.03], inertia)


@pytest.fixture(scope="module")
def case(scenario, spacecraft, target):
    """Return a function (suite, momentum) -> (case, perfect measurements)."""

    def make(suite, momentum=None):
        momentum = np.zeros(6) if momentum is None else momentum
        made = accuracy._case(scenario, spacecraft, target, suite, (), 0)
        made = replace(made, duration=END, momentum_W=momentum)
        return made, accuracy._perfect(made, spacecraft.tree, spacecraft.joint_names)

    return make


@pytest.fixture(scope="module")
def suite():
    return replace(load_sensors("servicer"), velocity=VectorSensor(5.0, 1e-3))


@pytest.fixture(scope="module")
def psi(spacecraft, target):
    return relative_unknowns(spacecraft.mass).from_parameters(target.to_vector())


def model_of(spacecraft, measurements, suite, **options):
    return TrajectoryModel(
        spacecraft.tree, smooth_joints(measurements, suite), measurements, suite, **options
    )


def true_state(model, psi, made, spacecraft):
    L, v_Wcm = accuracy._momentum_about_com(made, spacecraft.tree)
    return replace(model.start(psi), L=L, v_Wcm=v_Wcm)


@pytest.mark.parametrize("momentum", [None, TUMBLE], ids=["at rest", "tumbling"])
def test_prediction_at_the_truth_is_what_perfect_sensors_read(
    case, suite, spacecraft, psi, momentum
):
    made, perfect = case(suite, momentum)
    model = model_of(spacecraft, perfect, suite, unknown_momentum=momentum is not None)
    trajectory = model.trajectory(true_state(model, psi, made, spacecraft))
    assert np.abs(model.residuals(trajectory)).max() < 0.1  # of a σ


@pytest.mark.parametrize("momentum", [None, TUMBLE], ids=["at rest", "tumbling"])
def test_jacobian_is_the_derivative(case, suite, spacecraft, psi, momentum):
    made, perfect = case(suite, momentum)
    model = model_of(spacecraft, perfect, suite, unknown_momentum=momentum is not None)
    state = true_state(model, psi, made, spacecraft)
    jacobian = model.jacobian(model.trajectory(state))
    steps = np.concatenate([np.full(10, 1e-2), np.full(model.size - 10, 1e-6)])
    for i, step in enumerate(steps):
        change = np.zeros(model.size)
        change[i] = step
        ahead, behind = (
            model.residuals(model.trajectory(model.moved(state, sign * change))) for sign in (1, -1)
        )
        column = (behind - ahead) / (2 * step)
        assert np.abs(column - jacobian[:, i]).max() < 0.01 * np.abs(column).max()


def test_nuisance_columns_are_the_derivatives_by_the_joint_splines(case, suite, spacecraft, psi):
    made, perfect = case(suite, TUMBLE)
    joints = smooth_joints(perfect, suite)
    options = {"unknown_momentum": True}
    model = TrajectoryModel(spacecraft.tree, joints, perfect, suite, **options)
    state = true_state(model, psi, made, spacecraft)
    nuisance = model.nuisance(model.trajectory(state))
    root, K = np.linalg.cholesky(joints.covariance), joints.basis.size
    for j, k in ((0, 3), (4, K // 2), (11, K - 3)):
        ends = []
        for sign in (1, -1):
            coefficients = joints.coefficients.copy()
            coefficients[:, j] += sign * 30 * root[:, k]
            moved = replace(joints, coefficients=coefficients)
            other = TrajectoryModel(spacecraft.tree, moved, perfect, suite, **options)
            ends.append(other.residuals(other.trajectory(state)))
        column = (ends[1] - ends[0]) / 60
        assert np.abs(column - nuisance[:, j * K + k]).max() < 0.05 * np.abs(column).max()


def test_far_starts_end_at_one_optimum(case, suite, spacecraft, psi):
    _, perfect = case(suite)
    measurements = add_noise(suite, perfect, 3)
    model = model_of(spacecraft, measurements, suite)
    starts = (
        psi,
        relative_unknowns(spacecraft.mass).from_parameters(
            InertialParameters(400.0, [-0.5, 0.6, 0.4], np.diag([90.0, 60.0, 70.0])).to_vector()
        ),
        relative_unknowns(spacecraft.mass).from_parameters(
            InertialParameters(5.0, [0.0, 0.0, 0.0], 0.3 * np.eye(3)).to_vector()
        ),
    )
    fits = [fit_trajectory(model, start) for start in starts]
    sigma = 1 / np.sqrt(np.diag(fits[0].psi_information()))
    for fit in fits:
        assert fit.converged
        assert (np.abs(fit.state.psi - fits[0].state.psi) < 0.05 * sigma).all()
        assert 0.85 < fit.chi_squared / fit.rows < 1.15


def test_errors_are_at_the_bound_and_covered(case, spacecraft, target, psi):
    suite = load_sensors("servicer")
    _, perfect = case(suite)
    bound = cramer_rao_bound(spacecraft.tree, psi, perfect, suite)
    errors, squares = [], []
    for seed in range(8):
        measurements = add_noise(suite, perfect, seed)
        fit = fit_trajectory(model_of(spacecraft, measurements, suite), psi)
        result = identification_of_fit(fit)
        error = result.parameters - target.to_vector()
        errors.append(error)
        squares.append(error @ np.linalg.solve(result.covariance, error))
    low, high = chi2.ppf([0.0005, 0.9995], 80) / 8
    assert low < np.mean(squares) < high
    pooled = np.sqrt(np.mean(np.square(errors) / np.diag(bound)))
    assert 0.6 < pooled < 1.4


def test_momentum_of_a_tumbling_target_is_found(case, spacecraft, psi):
    suite = load_sensors("servicer")
    made, perfect = case(suite, TUMBLE)
    measurements = add_noise(suite, perfect, 2)
    model = model_of(spacecraft, measurements, suite, unknown_momentum=True)
    fit = fit_trajectory(model, 1.2 * psi)
    L, v_Wcm = accuracy._momentum_about_com(made, spacecraft.tree)
    sigma = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    assert (np.abs(fit.state.L - L) < 5 * sigma[model.columns["L"]]).all()
    assert (np.abs(fit.state.v_Wcm - v_Wcm) < 5 * sigma[model.columns["v_Wcm"]]).all()
    assert np.linalg.norm(fit.state.L - L) < 0.01 * np.linalg.norm(L)


def test_outliers_do_not_move_the_robust_fit(case, spacecraft, target, psi):
    suite = load_sensors("servicer")
    _, perfect = case(suite)
    clean = add_noise(suite, perfect, 4)
    position = clean.position.value.copy()
    position[[7, 23, 41]] += [0.4, -0.3, 0.5]
    spoiled = replace(clean, position=Samples(clean.position.time, position))
    reference = fit_trajectory(model_of(spacecraft, clean, suite), psi)
    model = model_of(spacecraft, spoiled, suite)
    robust, plain = fit_trajectory(model, psi, robust=True), fit_trajectory(model, psi)
    assert robust.downweighted >= 3
    spread = np.sqrt(np.diag(np.linalg.inv(reference.psi_information())))
    assert (np.abs(robust.state.psi - reference.state.psi) < 2 * spread).all()
    assert (
        np.abs(plain.state.psi - reference.state.psi).max()
        > np.abs(robust.state.psi - reference.state.psi).max()
    )


def test_the_known_bodies_uncertainty_enters_the_covariance(case, spacecraft, psi):
    suite = load_sensors("servicer")
    _, perfect = case(suite)
    model = model_of(spacecraft, add_noise(suite, perfect, 5), suite)
    none = fit_trajectory(model, psi)
    one, two = (
        fit_trajectory(model, psi, known_bodies=BodyUncertainty(f * 0.01, f * 0.005, f * 0.01))
        for f in (1, 2)
    )
    assert not none.consider.any()
    np.testing.assert_allclose(two.consider, 4 * one.consider, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(one.state.psi, none.state.psi, rtol=1e-9)


def test_every_log_cholesky_vector_is_a_rigid_body_and_its_jacobian_right(psi):
    form = LogCholesky(np.abs(psi))
    rng = np.random.default_rng(2)
    np.testing.assert_allclose(form.to_psi(form.from_psi(psi))[0], psi, rtol=1e-9)
    for _ in range(50):
        parameters = rng.normal(scale=2.0, size=10)
        vector, jacobian = form.to_psi(parameters)
        assert np.linalg.eigvalsh(standard_to_pseudo_inertia(vector)).min() > -1e-9
        i = rng.integers(10)
        step = 1e-6 * np.eye(10)[i]
        column = (form.to_psi(parameters + step)[0] - form.to_psi(parameters - step)[0]) / 2e-6
        np.testing.assert_allclose(
            jacobian[:, i], column, rtol=1e-5, atol=1e-7 * np.abs(vector).max()
        )
