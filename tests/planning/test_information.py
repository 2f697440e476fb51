"""The fast information about the target, against the exact Cramér-Rao bound."""

from dataclasses import replace

import numpy as np
import pytest
from planning_cases import planned
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.unknowns import PSI
from cpid_drake.planning.information import InformationModel, inverse


def sigmas(case, model=None) -> np.ndarray:
    model = model or case.model
    F = model.information(model.jacobian(model.motions(case.samples()), case.psi))
    covariance = inverse(F)[0, model.psi, model.psi]
    return np.sqrt(np.diag(case.by_psi @ covariance @ case.by_psi.T))


@pytest.mark.parametrize(
    ("scenario", "preset"),
    [
        ("paper", "flight"),
        pytest.param("single_arm_wheels", "flight", marks=pytest.mark.slow),
        # A table; delays, a lever arm and a mounting are unknown.
        pytest.param("air_bearing", "air_bearing", marks=pytest.mark.slow),
    ],
)
def test_it_is_the_exact_bound_if_the_encoders_are_good(scenario, preset):
    """The grid, the thinned sensors and the one block change σ by at most 3 %."""
    case = planned(scenario, preset, fine_encoders=True)
    exact, known = case.bound(), case.spacecraft.tree.unknowns
    ratio = (sigmas(case) / exact)[np.isfinite(exact)]
    assert len(ratio) == len(known)
    np.testing.assert_allclose(ratio, 1.0, atol=0.03)


@pytest.mark.slow
def test_errors_of_encoders_make_a_small_difference(exciting):
    ratio = sigmas(exciting) / exciting.bound()
    assert (ratio > 0.9).all()
    assert (ratio < 1.02).all()


@pytest.mark.slow
def test_an_uncertain_spacecraft_limits_the_information_as_in_the_exact_bound():
    """The known bodies' errors make σ hundreds of times larger."""
    uncertain = planned("uncertain_spacecraft", "flight", fine_encoders=True)
    np.testing.assert_allclose(sigmas(uncertain) / uncertain.bound(), 1.0, atol=0.03)


def test_an_unknown_momentum_costs_as_much_as_in_the_exact_bound():
    case = planned("tumbling_capture", "servicer", fine_encoders=True)
    start = case.case.motion.evaluate(0.0)[0]
    assert case.case.momentum.is_unknown
    momentum = momentum_of(case, start)
    model = InformationModel(
        case.spacecraft.tree, case.case.suite, case.case.duration, momentum=momentum
    )
    np.testing.assert_allclose(sigmas(case, model) / case.bound(), 1.0, atol=0.04)


def momentum_of(case, q) -> TotalMomentum:
    """Return the case's momentum about the centre of mass, marked as unknown."""
    known = TotalMomentum.with_base_at_origin(
        case.spacecraft.tree, case.case.truth, q, case.case.momentum_W
    )
    return TotalMomentum.unknown(known)


def test_the_base_turns_as_in_the_propagated_motion():
    """On the coarse grid, with momentum: an independent integration, to 1e-4 rad."""
    case = planned("tumbling_capture", "flight")
    momentum = momentum_of(case, case.case.motion.evaluate(0.0)[0])
    model = InformationModel(
        case.spacecraft.tree, case.case.suite, case.case.duration, momentum=momentum
    )
    motions = model.motions(case.samples())
    found = motions.trajectory(model.state(case.psi)).R
    expected = propagate(
        case.spacecraft.tree,
        case.case.motion,
        case.case.truth.to_standard_vector(),
        model.times,
        momentum_W=case.case.momentum_W,
    )
    telemetry = expected.to_telemetry(case.spacecraft.joint_names, model.times, case.case.motion)
    assert np.abs(telemetry.R_WB[-1] - np.eye(3)).max() > 0.1
    np.testing.assert_allclose(found, telemetry.R_WB, atol=1e-4)


def test_with_momentum_a_change_of_the_attitude_grows():
    """The derivatives of the attitude by ψ, against differences; L × ξ turns the base further."""
    case = planned("tumbling_capture", "flight")
    momentum = momentum_of(case, case.case.motion.evaluate(0.0)[0])
    suite = replace(case.case.suite, gyro=None, position=None)
    model = InformationModel(case.spacecraft.tree, suite, case.case.duration, momentum=momentum)
    motions, psi = model.motions(case.samples()), case.psi
    rows = model.jacobian(motions, psi)[0].reshape(len(model.times), 3, -1)
    scale = model.suite.sigmas("attitude")[:, None]
    R_BS = model.suite.attitude.R_BS
    for k in range(10):
        step = np.zeros(10)
        step[k] = 1e-5 * psi[4]
        later, before = (motions.trajectory(model.state(psi + s * step)).R for s in (1, -1))
        turn = Rotation.from_matrix(np.swapaxes(before, 1, 2) @ later).as_rotvec()
        expected = turn @ R_BS / (2 * step[k])
        found = (rows * scale)[:, :, model.psi.start + k]
        np.testing.assert_allclose(found, expected, atol=3e-3 * np.abs(expected).max())


def test_a_constant_error_that_is_declared_costs_information(exciting):
    suite = replace(exciting.case.suite)
    suite.gyro = replace(suite.gyro, scale_ppm=300.0)
    suite.attitude = replace(suite.attitude, mounting_arcsec=100.0, delay_ms=20.0)
    model = InformationModel(exciting.spacecraft.tree, suite, exciting.case.duration)
    assert model.size == exciting.model.size + 7
    ratio = sigmas(exciting, model) / sigmas(exciting)
    assert (ratio > 1 - 1e-9).all()
    assert ratio.max() > 1.5


def test_the_prior_is_all_that_joints_at_rest_leave(exciting):
    model = exciting.model
    samples = np.repeat(exciting.samples()[:1], len(model.times), axis=0)
    samples[:, :, 1] = 0.0
    F = model.information(model.jacobian(model.motions(samples), exciting.psi))
    found = inverse(F)[0, model.psi, model.psi]
    prior = next(unknown for unknown in model.fit.table if unknown.name == PSI)
    np.testing.assert_allclose(np.sqrt(np.diag(found))[0], prior.sigma[0], rtol=0.5)
