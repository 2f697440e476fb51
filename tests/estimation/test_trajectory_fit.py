"""The trajectory fit: its derivatives, its optimum, and that its covariance is what it says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    measured,
    momentum_about_com,
    small_craft,
    true_psi,
)

from cpid_drake import InertialParameters, InputError
from cpid_drake.dynamics.parameterizations import (
    LogCholesky,
    relative_parameterization,
    standard_to_pseudo_inertia,
)
from cpid_drake.dynamics.sensitivity import BodyUncertainty, perturbed
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation import trajectory_fit
from cpid_drake.estimation.likelihood.elimination import marginal
from cpid_drake.estimation.likelihood.model import TrajectoryModel
from cpid_drake.estimation.momentum_filter import vague_prior
from cpid_drake.estimation.trajectory_fit import fit_trajectory
from cpid_drake.identification.fit_estimator import (
    cramer_rao_bound,
    fit_measurements,
    identification_of_fit,
)
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import Gyro, JointSensor, VectorSensor
from cpid_drake.sensing.splines import smooth_joints

DURATION = 8.0
RICH = {"velocity": VectorSensor(4.0, 1e-3)}


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=101, duration=DURATION, size=0.6)


@pytest.fixture(scope="module")
def psi(craft, skewed_target):
    return true_psi(craft, skewed_target)


@pytest.fixture(scope="module")
def perfect(craft, motion, skewed_target):
    """Return what the coarse suite's sensors would give without noise."""
    return measured(craft, motion, skewed_target, coarse_suite())


def nees(error, information) -> float:
    return float(error @ information @ error)


def largest_error(found, true, scale) -> float:
    return float(np.abs((found - true) / scale).max())


# -- derivatives ----------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[None, MOMENTUM], ids=["at rest", "tumbling"])
def model(request, craft, motion, skewed_target):
    """Return a model with all sensors and a gyro bias of many nodes, and the true state."""
    momentum = request.param
    suite = coarse_suite(gyro=Gyro(20.0, 0.005, 1.0, 5.0), **RICH)
    samples = measured(craft, motion, skewed_target, suite, momentum)
    total = TotalMomentum.zero()
    if momentum is not None:
        total = TotalMomentum.unknown(momentum_about_com(craft, motion, skewed_target, momentum))
    model = TrajectoryModel(
        craft.tree,
        smooth_joints(samples, suite),
        samples,
        suite,
        momentum=total,
        psi_prior=(np.zeros(10), np.full(10, 50.0)),
        step=0.0125,
    )
    state = model.start(true_psi(craft, skewed_target))
    return model, replace(state, bias=1e-6 * np.ones_like(state.bias))


def by_differences(model, state, change, step):
    ahead, behind = (
        model.residuals(model.trajectory(model.retracted(state, s * change))) for s in (step, -step)
    )
    return -(ahead - behind) / (2 * step)


def test_jacobian(model):
    """Of the predicted readings by every unknown; the grid's own error is of the fourth order."""
    model, state = model
    exact = model.jacobian(model.trajectory(state))
    assert exact.shape == (len(model.sample_rows()), model.size)
    steps = {"psi": 1e-3, "attitude": 1e-5, "p_Wcm": 1e-3, "v_Wcm": 1e-3, "L": 1e-3, "bias": 1e-5}
    for name, columns in model.columns.items():
        for k in range(columns.start, columns.stop)[:: 4 if name == "bias" else 1]:
            column = by_differences(model, state, np.eye(model.size)[k], steps[name])
            # Momentum's coupling is integrated by the trapezoidal rule.
            tolerance = (3e-5 if model.momentum.is_unknown else 1e-6) * np.abs(column).max()
            np.testing.assert_allclose(
                exact[:, k], column, rtol=0, atol=tolerance, err_msg=f"{name} {k}"
            )


def test_joint_jacobian(model, craft):
    """By coefficients of the joints' splines, in units of their σ."""
    model, state = model
    exact, joints = model.joint_jacobian(model.trajectory(state)), model.joints
    K, root = joints.basis.size, np.linalg.cholesky(joints.covariance)
    assert exact.shape[1] == 4 * K
    step = 1.0
    for joint, k in ((0, 0), (1, 3), (2, K // 2), (3, K - 2), (1, K - 1)):
        readings = []
        for sign in (1, -1):
            coefficients = joints.coefficients.copy()
            coefficients[:, joint] += sign * step * root[:, k]
            other = TrajectoryModel(
                craft.tree,
                replace(joints, coefficients=coefficients),
                model.measurements,
                model.suite,
                momentum=TotalMomentum(is_unknown=model.momentum.is_unknown),
                psi_prior=model.psi_prior,
                step=0.0125,
            )
            readings.append(other.residuals(other.trajectory(state)))
        column = -(readings[0] - readings[1]) / (2 * step)
        tolerance = 1e-3 * np.abs(column).max()
        np.testing.assert_allclose(exact[:, joint * K + k], column, rtol=0, atol=tolerance)


def test_body_jacobian(model, craft):
    """By each body's ten numbers, in units of their σ; the target stays the same body."""
    model, state = model
    uncertainty = BodyUncertainty(mass=0.01, com=0.002, inertia=0.02)
    exact = model.body_jacobian(model.trajectory(state), uncertainty)
    parameterization = relative_parameterization(model.dynamics.mass)
    target = parameterization.to_parameters(state.psi)

    class Drawn:
        """In place of a random generator: draws one number that is not zero."""

        def __init__(self, body, k, value):
            self.values = np.zeros((len(craft.tree.bodies), 10))
            self.values[body, k] = value
            self.body = -1

        def standard_normal(self, n):
            self.body += 1
            return self.values[self.body]

    for body, k in ((0, 0), (0, 2), (0, 5), (1, 0), (2, 3), (4, 8)):
        readings = []
        for value in (0.1, -0.1):
            tree = perturbed(craft.tree, uncertainty, Drawn(body, k, value))
            other = TrajectoryModel(
                tree,
                model.joints,
                model.measurements,
                model.suite,
                momentum=TotalMomentum(is_unknown=model.momentum.is_unknown),
                psi_prior=model.psi_prior,
                step=0.0125,
            )
            psi = relative_parameterization(other.dynamics.mass).from_parameters(target)
            moved = replace(state, psi=psi)
            residuals = other.residuals(other.trajectory(moved))
            readings.append(residuals[: -10 - moved.bias.size])
        column = -(readings[0] - readings[1]) / 0.2
        tolerance = 1e-4 * np.abs(column).max()
        rows = exact[: len(column), 10 * body + k]
        np.testing.assert_allclose(rows, column, rtol=0, atol=tolerance, err_msg=f"{body}, {k}")


def test_end_attitude_jacobian(model):
    model, state = model
    exact = model.end_attitude_jacobian(model.trajectory(state))
    for k, unit in list(enumerate(np.eye(model.size)))[::2]:
        R = [model.trajectory(model.retracted(state, s * 1e-5 * unit)).R[-1] for s in (1, -1)]
        turn = Rotation.from_matrix(R[0] @ R[1].T).as_rotvec() / 2e-5
        np.testing.assert_allclose(exact[:, k], turn, rtol=1e-3, atol=1e-7)


def test_log_cholesky():
    """ψ(λ) is a rigid body whatever λ, its derivative right, and its inverse its inverse."""
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


# -- the optimum ----------------------------------------------------------------------------------


@pytest.mark.parametrize("momentum", [None, MOMENTUM], ids=["at rest", "tumbling"])
def test_without_noise_it_finds_the_truth(craft, motion, skewed_target, momentum):
    """To 1e-7 of m, 0.5 m and tr I: what is left is the grid's error and the joints' spline's."""
    suite = coarse_suite(encoders=JointSensor(50.0), **RICH)
    samples = measured(craft, motion, skewed_target, suite, momentum)
    joints = smooth_joints(samples, suite)
    model = TrajectoryModel(
        craft.tree,
        joints,
        samples,
        suite,
        momentum=TotalMomentum(is_unknown=momentum is not None),
        step=0.01,
    )
    fit = fit_trajectory(model, vague_prior(model.dynamics.mass, model.dynamics.I_K[0]).psi)
    assert fit.converged
    true = skewed_target.to_vector()
    scale = np.array([true[0], 0.5, 0.5, 0.5, *6 * [true[4:7].sum()]])
    assert largest_error(identification_of_fit(fit).parameters, true, scale) < 1e-7
    assert fit.chi_squared < 1e-2
    if momentum is not None:
        true = momentum_about_com(craft, motion, skewed_target, momentum)
        np.testing.assert_allclose(fit.state.L, true.L_WScm_W, rtol=0, atol=1e-5)
        np.testing.assert_allclose(fit.state.v_Wcm, true.v_WScm_W, rtol=0, atol=1e-7)


def far_starts(mass):
    """Targets from a fiftieth of the spacecraft's mass to all of it, up to 1.7 m off the hand."""
    rng = np.random.default_rng(103)
    for _ in range(3):
        m = mass * np.exp(rng.uniform(np.log(0.02), 0.0))
        A = rng.normal(size=(3, 3))
        moment = 0.3 * m * A @ A.T
        inertia = np.trace(moment) * np.eye(3) - moment
        yield relative_parameterization(mass).from_parameters(
            InertialParameters(m, rng.uniform(-1, 1, 3), inertia).to_vector()
        )


FLAT = InertialParameters(60.0, [0.4, 0.1, 0.0], np.diag([10.0, 20.0, 30.0]))


@pytest.mark.parametrize("which", ["skewed", "flat"])
@pytest.mark.parametrize("momentum", [None, MOMENTUM], ids=["at rest", "tumbling"])
def test_the_start_does_not_matter(craft, motion, skewed_target, which, momentum):
    """All end at one optimum, that of a flat target (at the edge of what can be) too."""
    target, suite = (FLAT if which == "flat" else skewed_target), coarse_suite()
    samples = add_noise(suite, measured(craft, motion, target, suite, momentum), 1)
    model = TrajectoryModel(
        craft.tree,
        smooth_joints(samples, suite),
        samples,
        suite,
        momentum=TotalMomentum(is_unknown=momentum is not None),
    )
    fits = [fit_trajectory(model, start) for start in far_starts(craft.mass)]
    assert all(fit.converged for fit in fits)
    assert max(fit.iterations for fit in fits) < 60
    for fit in fits[1:]:
        difference = fit.state.psi - fits[0].state.psi
        assert nees(difference, fits[0].psi_information()) < 1e-8  # 1e-4 σ


def test_the_first_stage_goes_through_rigid_bodies(craft, motion, monkeypatch):
    """Every state it tries is one, even where the optimum is not."""
    suite = coarse_suite()
    samples = add_noise(suite, measured(craft, motion, FLAT, suite), 2)
    model = TrajectoryModel(craft.tree, smooth_joints(samples, suite), samples, suite)
    tried, stage = [], trajectory_fit._log_cholesky_stage
    predict = model.trajectory

    def watched(state, near=None):
        tried.append(state.psi)
        return predict(state, near)

    def watching(*arguments):
        monkeypatch.setattr(model, "trajectory", watched)
        try:
            return stage(*arguments)
        finally:
            monkeypatch.setattr(model, "trajectory", predict)

    monkeypatch.setattr(trajectory_fit, "_log_cholesky_stage", watching)
    fit_trajectory(model, next(far_starts(craft.mass)))
    assert len(tried) > 5
    for psi in tried:
        assert np.linalg.eigvalsh(standard_to_pseudo_inertia(psi))[0] > 0


def test_the_optimum_may_lie_beyond_what_can_be(craft, motion):
    """Of a flat target about half of the estimates do: none is pushed back to the edge."""
    suite = coarse_suite()
    samples = measured(craft, motion, FLAT, suite)
    beyond = []
    for seed in range(8):
        fit = fit_measurements(craft.tree, add_noise(suite, samples, seed), suite)
        result = identification_of_fit(fit)
        beyond.append(not result.raw().is_feasible())
        assert result.feasible().is_feasible()
    assert sum(beyond) > 0


def test_a_known_momentum_is_not_estimated(craft, motion, skewed_target, psi):
    """Given, it makes the target better known than estimated; taken as zero, it spoils all."""
    suite = coarse_suite()
    samples = add_noise(suite, measured(craft, motion, skewed_target, suite, MOMENTUM), 3)
    known = momentum_about_com(craft, motion, skewed_target, MOMENTUM)
    told = fit_measurements(craft.tree, samples, suite, momentum=known)
    open_ = fit_measurements(craft.tree, samples, suite, momentum=TotalMomentum.unknown())
    untold = fit_measurements(craft.tree, samples, suite)
    assert told.model.size == open_.model.size - 6
    np.testing.assert_array_equal(told.state.L, known.L_WScm_W)
    np.testing.assert_array_equal(told.state.v_Wcm, known.v_WScm_W)
    for fit in (told, open_):
        assert nees(fit.state.psi - psi, fit.psi_information()) < chi2.ppf(0.999, 10)
    sigmas = [np.sqrt(np.diag(np.linalg.inv(fit.psi_information()))) for fit in (told, open_)]
    assert (sigmas[0] < sigmas[1]).all()
    assert untold.chi_squared > 100 * told.chi_squared


def test_an_unknown_momentum_is_recovered_within_its_sigma(craft, motion, skewed_target):
    suite = coarse_suite()
    samples = measured(craft, motion, skewed_target, suite, MOMENTUM)
    momentum = momentum_about_com(craft, motion, skewed_target, MOMENTUM)
    true = np.concatenate([momentum.L_WScm_W, momentum.v_WScm_W])
    values = []
    for seed in range(6):
        fit = fit_measurements(
            craft.tree, add_noise(suite, samples, seed), suite, momentum=TotalMomentum.unknown()
        )
        columns = np.r_[fit.model.columns["L"], fit.model.columns["v_Wcm"]]
        rest = np.setdiff1d(np.arange(fit.model.size), columns)
        order = np.concatenate([columns, rest])
        information = marginal(fit.information[order[:, None], order], 6)
        values.append(nees(np.concatenate([fit.state.L, fit.state.v_Wcm]) - true, information))
    assert chi2.ppf(0.001, 36) < sum(values) < chi2.ppf(0.999, 36)


# -- statistics -----------------------------------------------------------------------------------


def test_errors_are_as_its_covariance_and_the_bound_say(craft, motion, skewed_target, perfect, psi):
    """Over thirty seeds: NEES, χ², and each parameter's error against the Cramér-Rao bound."""
    suite, seeds, true = coarse_suite(), 30, skewed_target.to_vector()
    bound = np.sqrt(np.diag(cramer_rao_bound(craft.tree, psi, perfect, suite)))
    errors, values, fits = [], [], []
    for seed in range(seeds):
        fit = fit_measurements(craft.tree, add_noise(suite, perfect, seed), suite)
        result = identification_of_fit(fit)
        errors.append(result.parameters - true)
        values.append(nees(errors[-1], np.linalg.inv(result.covariance)))
        fits.append(fit)
    low, high = chi2.ppf([0.001, 0.999], 10 * seeds) / seeds
    assert low < np.mean(values) < high
    # The ratio of 30 errors to their σ is known to 13 %.
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    assert ratio.min() > 0.7
    assert ratio.max() < 1.3
    assert 0.9 < np.sqrt(np.mean(ratio**2)) < 1.1
    rows, freedom = fits[0].rows, fits[0].rows - fits[0].model.size
    per_row = np.mean([fit.chi_squared for fit in fits]) / freedom
    assert abs(per_row - 1) < 4 * np.sqrt(2 / (rows * seeds))
    assert all(fit.converged for fit in fits)
    # No bias: the mean error is within its own σ's reach.
    assert np.abs(np.mean(errors, axis=0) / bound * np.sqrt(seeds)).max() < 3.5


def test_uncertain_known_bodies_are_covered_by_their_share(craft, motion, skewed_target, psi):
    """Fitted as if the spacecraft were the nominal one: right with its share, far off without."""
    suite, uncertainty = coarse_suite(), BodyUncertainty(mass=0.01, com=0.002, inertia=0.01)
    rng, seeds, true = np.random.default_rng(104), 12, skewed_target.to_vector()
    with_share, without = [], []
    for seed in range(seeds):
        tree = perturbed(craft.tree, uncertainty, rng)
        samples = add_noise(suite, measured(craft, motion, skewed_target, suite, tree=tree), seed)
        fit = fit_measurements(craft.tree, samples, suite, known_bodies=uncertainty)
        result = identification_of_fit(fit)
        error = result.parameters - true
        with_share.append(nees(error, np.linalg.inv(result.covariance)))
        alone = identification_of_fit(replace(fit, consider=np.zeros_like(fit.consider)))
        without.append(nees(error, np.linalg.inv(alone.covariance)))
    low, high = chi2.ppf([0.001, 0.999], 10 * seeds) / seeds
    assert low < np.mean(with_share) < high
    assert np.mean(without) > 20 * high


def spoiled(samples, size, seed):
    """Return samples (N, width) with 2 % of them, at least one, changed by a function."""
    rng = np.random.default_rng(seed)
    which = rng.choice(len(samples), max(1, round(0.02 * len(samples))), replace=False)
    value = samples.value.copy()
    shift = size * rng.normal(size=(len(which), 3))
    if value.shape[1] == 4:
        attitude = Rotation.from_quat(value[which], scalar_first=True)
        value[which] = (attitude * Rotation.from_rotvec(shift)).as_quat(scalar_first=True)
    else:
        value[which] += shift
    return Samples(samples.time, value), len(which)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_outliers_do_not_move_the_robust_fit(craft, perfect, seed):
    """Degrees and decimetres off: it stays within 2 σ of the clean fit, the plain one does not."""
    suite = coarse_suite()
    clean = add_noise(suite, perfect, seed)
    attitude, some = spoiled(clean.attitude, 0.02, seed)
    position, more = spoiled(clean.position, 0.2, seed + 100)
    bad = replace(clean, attitude=attitude, position=position)
    reference = fit_measurements(craft.tree, clean, suite)
    robust, plain = (fit_measurements(craft.tree, bad, suite, robust=r) for r in (True, False))
    information = reference.psi_information()
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    shift = robust.state.psi - reference.state.psi
    assert np.abs(shift / sigma).max() < 2
    assert np.abs((plain.state.psi - reference.state.psi) / sigma).max() > 10
    assert robust.converged
    assert some + more <= robust.downweighted <= some + more + 2
    # Huber's loss: a residual of r > 2.5 σ has the weight 2.5 / r, so that the loss grows linearly.
    own_noise = np.vstack(list(robust.own_noise().values()))
    size = np.sqrt(np.mean(own_noise**2, axis=1))
    weights = robust.weights[: 3 * len(size) : 3] ** 2
    np.testing.assert_allclose(weights, np.minimum(1, 2.5 / size), atol=5e-3)


def test_without_outliers_the_robust_fit_is_the_plain_one(craft, perfect):
    """Up to the few samples that noise alone takes beyond 2.5 σ on all three axes together."""
    suite = coarse_suite()
    samples = add_noise(suite, perfect, 4)
    plain, robust = (fit_measurements(craft.tree, samples, suite, robust=r) for r in (False, True))
    difference = robust.state.psi - plain.state.psi
    assert nees(difference, plain.psi_information()) < 0.05**2
    assert robust.downweighted <= 2


def test_a_prior_counts_as_ten_more_measurements(craft, perfect, psi):
    """Where data say little it decides; where they say much it does not matter."""
    suite = coarse_suite()
    early = add_noise(suite, perfect, 5).between(0.0, 1.0)
    joints = smooth_joints(early, suite)
    sigma = np.array([5.0, *3 * [2.0], *6 * [3.0]])
    mean = psi + sigma * np.random.default_rng(105).normal(size=10)
    fits = [
        fit_trajectory(TrajectoryModel(craft.tree, joints, early, suite, psi_prior=prior), mean)
        for prior in (None, (mean, sigma), (mean, sigma / 1e6))
    ]
    assert all(fit.converged for fit in fits)
    free, informed, fixed = fits
    np.testing.assert_allclose(fixed.state.psi, mean, rtol=0, atol=1e-3)
    assert informed.rows == free.rows + 10
    more = informed.psi_information() - np.diag(sigma**-2.0)
    posterior = np.sqrt(np.diag(np.linalg.inv(informed.psi_information())))
    assert (posterior <= sigma * (1 + 1e-9)).all()
    assert np.abs((informed.state.psi - psi) / posterior).max() < 4
    # The data's own share is what it is without the prior, up to where it is evaluated.
    scale = 1 / np.sqrt(np.diag(more))
    difference = (more - free.psi_information()) * scale * scale[:, None]
    assert np.abs(difference).max() < 0.2


# -- what sensors there are -----------------------------------------------------------------------


@pytest.mark.parametrize("unknown_momentum", [False, True])
@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize("others", [(), ("position",), ("velocity",), ("position", "velocity")])
def test_any_sensors_beside_attitude_will_do(
    craft, motion, skewed_target, psi, gyro, others, unknown_momentum
):
    """Absent from the suite, or without a sample in it: the same, and consistent."""
    rich = coarse_suite(**RICH)
    samples = add_noise(rich, measured(craft, motion, skewed_target, rich), 6)
    kept = {*others, *(["gyro"] if gyro else [])}
    absent = {"gyro", "position", "velocity"} - kept
    poor = replace(rich, **dict.fromkeys(absent))
    nothing = np.empty(0, dtype=int)
    silent = replace(samples, **{name: getattr(samples, name).where(nothing) for name in absent})
    fits = [
        fit_measurements(craft.tree, m, suite, momentum=TotalMomentum(is_unknown=unknown_momentum))
        for m, suite in ((samples, poor), (silent, rich))
    ]
    np.testing.assert_allclose(fits[0].state.psi, fits[1].state.psi, rtol=1e-12, atol=1e-12)
    fit = fits[0]
    assert fit.converged
    assert set(fit.model.sensors) == {"attitude", *kept}
    assert ("p_Wcm" in fit.model.columns) == ("position" in others)
    assert ("v_Wcm" in fit.model.columns) == (unknown_momentum and bool(others))
    assert nees(fit.state.psi - psi, fit.psi_information()) < chi2.ppf(0.9999, 10)


def test_the_zero_of_the_clock_does_not_matter(craft, motion, skewed_target):
    """Position and velocity at the start, gyro bias and all else are those of the first time."""
    suite = coarse_suite(gyro=Gyro(20.0, 0.005, 1.0, 5.0), **RICH)
    samples = add_noise(suite, measured(craft, motion, skewed_target, suite, MOMENTUM), 11)
    later = samples.updated({n: Samples(s.time + 50.0, s.value) for n, s in samples.items()})
    fits = [
        fit_measurements(craft.tree, each, suite, momentum=TotalMomentum(is_unknown=True))
        for each in (samples, later)
    ]
    diagonals = [np.diag(fit.information) for fit in fits]
    np.testing.assert_allclose(*diagonals, rtol=1e-4)
    here, there = (fit.state for fit in fits)
    np.testing.assert_allclose(there.psi, here.psi, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(there.p_Wcm, here.p_Wcm, atol=1e-5)
    np.testing.assert_allclose(there.v_Wcm, here.v_Wcm, atol=1e-6)
    np.testing.assert_allclose(there.bias, here.bias, atol=1e-8)


def test_samples_outside_the_joint_motion_are_left_out(craft, perfect):
    """A second more at either end, of sensors that start early and stop late."""
    suite = coarse_suite()
    samples = add_noise(suite, perfect, 7)
    time = samples.encoders.time
    short = replace(samples, encoders=samples.encoders.where((time >= 1) & (time <= 7)))
    fit = fit_measurements(craft.tree, short, suite)
    assert fit.model.measurements.attitude.time[[0, -1]] == pytest.approx([1.0, 7.0])
    assert fit.rows == len(fit.model.sample_rows())
    for name in ("gyro", "position"):
        late = getattr(samples, name)
        late = replace(samples, **{name: Samples(late.time + 100, late.value)})
        assert name not in fit_measurements(craft.tree, late, suite).model.sensors
    away = Samples(samples.attitude.time + 100, samples.attitude.value)
    with pytest.raises(InputError, match="no attitude samples"):
        fit_measurements(craft.tree, replace(samples, attitude=away), suite)


def test_without_an_attitude_sensor_it_is_refused(craft, perfect):
    suite = coarse_suite()
    suite.attitude = None
    with pytest.raises(InputError, match="no attitude samples"):
        fit_measurements(craft.tree, perfect, suite)


def test_a_second_without_encoders_does_not_make_it_overconfident(craft, motion, skewed_target):
    """Encoders that are good enough for the gap's misfit to show, if there were any."""
    suite = coarse_suite(encoders=JointSensor(50.0, 1e-6), gyro=Gyro(20.0, 0.001, 1.0, 0.0))
    perfect = measured(craft, motion, skewed_target, suite)
    true, values = skewed_target.to_vector(), []
    for seed in range(6):
        samples = add_noise(suite, perfect, seed)
        time = samples.encoders.time
        gapped = replace(samples, encoders=samples.encoders.where((time < 3.5) | (time > 4.5)))
        result = identification_of_fit(fit_measurements(craft.tree, gapped, suite))
        values.append(nees(result.parameters - true, np.linalg.inv(result.covariance)))
    assert np.mean(values) < chi2.ppf(0.999, 60) / 6


def test_it_says_whether_it_converged(craft, perfect):
    suite = coarse_suite()
    samples = add_noise(suite, perfect, 8)
    assert fit_measurements(craft.tree, samples, suite).converged
    model = TrajectoryModel(craft.tree, smooth_joints(samples, suite), samples, suite)
    start = vague_prior(craft.mass, model.dynamics.I_K[0]).psi
    assert not fit_trajectory(model, start, max_iterations=1).converged
