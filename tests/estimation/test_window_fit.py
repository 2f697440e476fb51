"""The fit of a window: its optimum, its derivatives, and the way to it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from block_cases import make_case
from scipy.stats import chi2
from sensing_cases import MOMENTUM, coarse_suite, measured

from cpid_drake import InertialParameters, InputError
from cpid_drake.dynamics.parameterizations import (
    LogCholesky,
    relative_parameterization,
    standard_to_pseudo_inertia,
)
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.sensitivity import perturbed
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation import window_minimum
from cpid_drake.estimation.blocks import with_bodies
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.estimation.recursive_fit import referred
from cpid_drake.estimation.window_fit import fit_window, inertia_uncertainty
from cpid_drake.estimation.window_sweep import WindowModels, explained_sweep
from cpid_drake.identification.fit_setup import prior_of
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import JointSensor

SUITE = coarse_suite(encoders=JointSensor(25.0, 1e-5))
EDGES = (-1e-7, 1.0, 2.0, 3.0)
FLAT = InertialParameters(60.0, [0.4, 0.1, 0.0], np.diag([10.0, 20.0, 30.0]))


@pytest.fixture(scope="module", params=["at rest", "tumbling", "flat"])
def window(request, tmp_path_factory, skewed_target):
    """Return case, solver, prior and blocks of a window."""
    momentum = MOMENTUM if request.param == "tumbling" else None
    target = FLAT if request.param == "flat" else skewed_target
    case = make_case(tmp_path_factory.mktemp("craft"), target, SUITE, momentum, 3.0)
    total = TotalMomentum.zero() if momentum is None else TotalMomentum.unknown()
    samples = add_noise(SUITE, case.samples, 1)
    blocks = [case.block(a, b, samples) for a, b in itertools.pairwise(EDGES)]
    return case, case.solver(), prior_of(case.craft.tree, total), blocks


@pytest.fixture(scope="module")
def found(window):
    _case, solver, prior, blocks = window
    return fit_window(solver, prior, blocks, prior.psi)


def starts(case):
    """Yield solid spheres about C's origin, of different masses and radii."""
    for share, radius in ((0.02, 0.3), (0.3, 0.5)):
        m = share * case.craft.mass
        target = InertialParameters(m, np.zeros(3), 0.4 * m * radius**2 * np.eye(3))
        yield relative_parameterization(case.craft.mass).from_parameters(target.to_vector())


def test_the_start_does_not_matter(window, found):
    """All starts end at one optimum, also that of a flat target at the limit of rigid bodies."""
    case, solver, prior, blocks = window
    assert found.converged
    root = found.sweep.state.root[-10:, -10:]
    for start in starts(case):
        other = fit_window(solver, prior, blocks, start)
        assert other.converged
        assert np.linalg.norm(root @ (other.psi - found.psi)) < 0.1  # σ


def far_starts(mass):
    """Yield targets of a fiftieth to all of the spacecraft's mass, up to 1.7 m from C's origin."""
    rng = np.random.default_rng(103)
    for _ in range(3):
        m = mass * np.exp(rng.uniform(np.log(0.02), 0.0))
        A = rng.normal(size=(3, 3))
        moment = 0.3 * m * A @ A.T
        inertia = np.trace(moment) * np.eye(3) - moment
        target = InertialParameters(m, rng.uniform(-1, 1, 3), inertia)
        yield relative_parameterization(mass).from_parameters(target.to_vector())


def test_a_far_start_gives_the_optimum_or_none(window, found):
    """The fit from a far start either ends at the optimum, or does not say that it converged."""
    case, solver, prior, blocks = window
    root = found.sweep.state.root[-10:, -10:]
    fits = [fit_window(solver, prior, blocks, start) for start in far_starts(case.craft.mass)]
    assert any(fit.converged for fit in fits)
    for fit in fits:
        if fit.converged:
            assert np.linalg.norm(root @ (fit.psi - found.psi)) < 0.1  # σ


@pytest.mark.parametrize("seed", [3, 4])
def test_the_values_about_which_constant_errors_are_linear_do_not_matter(
    seed, tmp_path, skewed_target
):
    """Of a chain of fits that begins with wrong values, or with those that suit each block."""
    plain = coarse_suite(encoders=JointSensor(25.0, 1e-5, zero_mrad=5.0, delay_ms=20.0))
    suite = replace(
        plain,
        attitude=replace(plain.attitude, mounting_arcsec=2000.0, delay_ms=50.0),
        gyro=replace(plain.gyro, scale_ppm=2000.0, misalignment_arcsec=500.0),
    )
    case = make_case(tmp_path, skewed_target, suite, MOMENTUM, 3.0)
    samples = add_noise(suite, case.samples, seed)
    blocks = [case.block(a, b, samples) for a, b in itertools.pairwise(EDGES)]
    solver, prior = case.solver(), prior_of(case.craft.tree, TotalMomentum.unknown())
    fits = []
    for about in (None, np.random.default_rng(seed).normal(size=solver.constants.size)):
        for _ in range(3):
            fit = fit_window(solver, prior, blocks, case.psi, constants=about)
            about = fit.sweep.state.best_constants(fit.psi)
        assert fit.converged
        assert fit.sweep.is_likely
        fits.append(fit)
    one, other = fits
    error = one.psi - case.psi
    assert error @ one.sweep.state.psi_information() @ error < chi2.isf(1e-3, 10)
    assert np.linalg.norm(one.sweep.state.root[-10:, -10:] @ (other.psi - one.psi)) < 0.1  # σ


def test_the_optimum_is_consistent(window, found):
    case, *_ = window
    error = found.psi - case.psi
    assert error @ found.sweep.state.psi_information() @ error < chi2.isf(1e-3, 10)
    assert found.sweep.is_likely
    assert 0.7 < found.sweep.misfit < 1.3


def test_errors_of_the_known_bodies_explain_the_samples(tmp_path, skewed_target):
    """The fit converges to a likely target, although none explains the samples without errors."""
    case = make_case(tmp_path, skewed_target, SUITE, None, 3.0)
    uncertainty = BodyUncertainty(mass=0.01, com=0.003, inertia=0.02)
    tree = perturbed(case.craft.tree, uncertainty, np.random.default_rng(5))
    exact = measured(case.craft, case.motion, skewed_target, SUITE, tree=tree)
    samples = add_noise(SUITE, exact, 1)
    blocks = [case.block(a, b, samples) for a, b in itertools.pairwise(EDGES)]
    prior = prior_of(case.craft.tree, TotalMomentum.zero())
    fit = fit_window(case.solver(uncertainty), prior, blocks, prior.psi)
    assert fit.converged
    assert 0.7 < fit.sweep.misfit < 1.3
    assert fit.sweep.is_likely
    blind = fit_window(case.solver(), prior, blocks, prior.psi, plain=True)
    assert blind.sweep.misfit > 3
    error = fit.psi - case.psi
    R, _ = fit.sweep.state.psi_equations()
    assert np.sum((R @ error) ** 2) < chi2.isf(1e-3, 10)
    distances, about = [], fit
    for _ in range(4):
        errors, distance = about.sweep.state.best_errors()
        solver, psi = with_bodies(case.solver(uncertainty), errors), about.psi
        about = fit_window(solver, prior, blocks, psi, again=True)
        assert about.converged
        distances.append(distance)
    assert distances[0] > 10
    assert distances[-1] < 0.1
    assert inertia_uncertainty(fit.sweep.state, case.solver()) > 5 * inertia_uncertainty(
        blind.sweep.state, case.solver()
    )


def test_the_information_is_the_derivative_of_the_cost(window, found):
    """χ² as a function of ψ alone: its gradient, by differences, is −2 Rᵀ z."""
    _, solver, prior, blocks = window
    state = found.sweep.state
    step = np.linalg.inv(state.root[-10:, -10:])  # columns: one σ of independent combinations
    psi = found.psi + step @ np.linspace(-1.0, 1.0, 10)
    here = explained_sweep(solver, prior, blocks, psi)
    expected = -2 * (here.state.root[-10:, -10:] @ step).T @ here.state.rest[-10:]
    for k in (0, 3, 6, 9):
        costs = [
            explained_sweep(solver, prior, blocks, psi + s * 0.3 * step[:, k]).cost for s in (1, -1)
        ]
        assert (costs[0] - costs[1]) / 0.6 == pytest.approx(expected[k], abs=0.15)


def test_the_first_stage_goes_through_rigid_bodies(window, monkeypatch):
    """Every target that it tries is one, even if the optimum is not."""
    _, solver, prior, blocks = window
    tried, free = [], []
    sweep, freed = WindowModels.sweep, window_minimum._freed

    def watched(self, psi, *others, **named):
        (free if free else tried).append(psi)
        return sweep(self, psi, *others, **named)

    def watching(*arguments):
        free.append(None)
        return freed(*arguments)

    monkeypatch.setattr(WindowModels, "sweep", watched)
    monkeypatch.setattr(window_minimum, "_freed", watching)
    fit_window(solver, prior, blocks[:1], prior.psi)
    assert len(tried) > 2
    for psi in tried:
        assert np.linalg.eigvalsh(standard_to_pseudo_inertia(psi))[0] > 0


def test_a_step_solves_the_equations_over_all_rigid_bodies(window, found):
    """Equations of a rigid body are solved by it; a strong damping leaves the body as it is."""
    case, _, prior, _ = window
    form, state = LogCholesky(np.abs(prior.psi)), found.sweep.state
    point = form.from_psi(case.psi)
    body, by_point = form.to_psi(point + 0.3 * np.sin(np.arange(10.0)))
    R = np.diag(1 / np.abs(by_point).max(axis=1))
    nominal, _ = form.to_psi(point)
    rest = np.concatenate([state.rest[:-10], R @ (body - nominal)])
    root = state.root.copy()
    root[-10:, -10:] = R
    here = replace(state, root=root, rest=rest, nominal=replace(state.nominal, psi=nominal))
    solved = form.to_psi(window_minimum._damped_step(form, point, here, 1e-12))[0]
    np.testing.assert_allclose(R @ solved, R @ body, atol=1e-3 * np.abs(rest[-10:]).max())
    kept = form.to_psi(window_minimum._damped_step(form, point, here, 1e8))[0]
    np.testing.assert_allclose(R @ kept, R @ nominal, atol=1e-3 * np.abs(rest[-10:]).max())


def test_the_uncertainty_of_the_inertia_is_that_of_samples(window, found):
    """RMS relative error of J over targets drawn from the information about ψ."""
    _, solver, _, _ = window
    state = found.sweep.state
    q = state.track.mean[:1]
    dynamics = relative_dynamics(solver.tree, q, 0 * q)
    J = dynamics.inertia(state.nominal.psi)[0]
    root = np.linalg.inv(np.linalg.cholesky(J))
    spread = np.linalg.inv(state.root[-10:, -10:])
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(2000):
        moved = dynamics.inertia(state.nominal.psi + spread @ rng.normal(size=10))[0] - J
        errors.append(np.sum((root @ moved @ root.T) ** 2) / 3)
    assert inertia_uncertainty(state, solver) == pytest.approx(np.sqrt(np.mean(errors)), rel=0.1)


def test_it_begins_with_what_the_prior_says(window):
    """Estimate and covariance of the state before the first block."""
    case, solver, prior, blocks = window
    psi = 1.3 * case.psi
    state = initial_state(solver, prior, psi, blocks[0])
    solution = np.linalg.solve(state.root, state.rest)
    sigma = 1 / np.diag(state.root)
    places = solver.places
    np.testing.assert_allclose(psi + solution[places["psi"]], prior.psi, atol=1e-9)
    np.testing.assert_allclose(sigma[places["psi"]], prior.psi_sigma)
    mean = state.nominal.L + solution[places["L"]]
    np.testing.assert_allclose(mean, prior.momentum.L_WScm_W, atol=1e-9)
    np.testing.assert_allclose(sigma[places["L"]], prior.L_sigma)
    np.testing.assert_allclose(sigma[places["bias"]], SUITE.gyro.bias_sigma)
    if prior.momentum.is_unknown:
        assert prior.L_sigma > np.linalg.norm(case.state(0.0).L)
        # The first rates tell the momentum of that target.
        dynamics = relative_dynamics(
            solver.tree, *case.motion.evaluate(np.zeros(1))[:, :2].swapaxes(0, 1)
        )
        w = blocks[0].samples.gyro.value[0]
        expected = dynamics.inertia(psi)[0] @ w + dynamics.momentum_at_rest(psi)[0]
        np.testing.assert_allclose(state.nominal.L, expected, rtol=1e-3, atol=0.05)
    else:
        assert prior.L_sigma < 1e-6


def test_without_attitude_there_is_no_start(window):
    _, solver, prior, blocks = window
    nothing = {"attitude": Samples(np.empty(0), np.empty((0, 4)))}
    blind = [replace(b, samples=b.samples.updated(nothing)) for b in blocks]
    with pytest.raises(InputError, match="no attitude samples"):
        fit_window(solver, prior, blind, prior.psi)


def test_log_cholesky():
    """ψ is a rigid body for any parameters; the derivative and the inverse are right."""
    rng = np.random.default_rng(102)
    form = LogCholesky(np.array([50.0, 1, 1, 1, 20, 0, 0, 25, 0, 30]))
    for _ in range(20):
        parameters = 2 * rng.normal(size=10)
        psi, jacobian = form.to_psi(parameters)
        assert np.linalg.eigvalsh(standard_to_pseudo_inertia(psi))[0] > 0
        for k, unit in enumerate(np.eye(10)):
            ahead, behind = (form.to_psi(parameters + s * 1e-6 * unit)[0] for s in (1, -1))
            tolerance = 1e-8 * np.abs(jacobian).max()
            column = (ahead - behind) / 2e-6
            np.testing.assert_allclose(jacobian[:, k], column, rtol=0, atol=tolerance)
    mild = 0.3 * rng.normal(size=10)
    np.testing.assert_allclose(form.from_psi(form.to_psi(mild)[0]), mild, rtol=0, atol=1e-12)


def test_a_target_relative_to_another_mass_is_the_same_target(tmp_path, skewed_target):
    case = make_case(tmp_path, skewed_target, SUITE, None, 3.0)
    uncertainty = BodyUncertainty(mass=0.05)
    solver = case.solver(uncertainty)
    other = with_bodies(solver, np.full(solver.consider_count, 2.0))
    assert other.tree.mass == pytest.approx(1.1 * case.craft.mass)
    psi = referred(case.psi, solver, other)
    assert abs(psi[0] / case.psi[0] - 1) > 1e-3
    target = relative_parameterization(1.1 * case.craft.mass).to_parameters(psi)
    np.testing.assert_allclose(target, skewed_target.to_vector(), rtol=1e-12)
