"""The recursion over blocks equals one dense least-squares problem over all of them."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from block_cases import added_sensors, best_psi, make_case, rich_suite
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sensing_cases import MOMENTUM, coarse_suite, momentum_about_com

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation import block_equations, block_state, blocks
from cpid_drake.estimation.faults import block_model
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.estimation.likelihood.joint_motion import ORDER
from cpid_drake.identification.fit_setup import prior_of
from cpid_drake.sensing.disturbances import Disturbances
from cpid_drake.sensing.noise import SensorNoise, add_noise
from cpid_drake.sensing.sensors import Gyro

UNCERTAINTY = BodyUncertainty(mass=0.01, com=0.002, inertia=0.02)
EDGES = (-1e-7, 1.0, 2.3, 3.0)


@pytest.fixture(scope="module", autouse=True)
def sensors():
    with added_sensors():
        yield


@dataclass(frozen=True, eq=False)
class Solved:
    """Successive blocks, what was known before each and what came out."""

    solver: object
    prior: object
    suite: object
    blocks: list
    models: list
    before: list
    fits: list


def momentum_of(case):
    if case.momentum_W is None:
        return TotalMomentum.zero()
    true = momentum_about_com(case.craft, case.motion, case.target, case.momentum_W)
    return TotalMomentum.unknown(true)


def begun(case, solver, samples, edges):
    """Return prior, blocks and the state at the start, about the true values."""
    prior = prior_of(case.craft.tree, momentum_of(case))
    parts = [case.block(a, b, samples) for a, b in pairwise(edges)]
    state = initial_state(solver, prior, case.psi, parts[0])
    place, true = solver.places["L"], case.state(edges[0] if edges[0] > 0 else 0.0)
    # The same prior about the true angular momentum instead of that of the first gyro sample.
    rest = state.rest.copy()
    rest[place] += state.root[place, place] @ (state.nominal.L - true.L)
    return prior, parts, replace(state, nominal=replace(state.nominal, L=true.L), rest=rest)


@pytest.fixture(scope="module", params=[None, MOMENTUM], ids=["at rest", "tumbling"])
def solved(request, tmp_path_factory, skewed_target):
    """Return three blocks of different lengths, each linearized once."""
    case = make_case(tmp_path_factory.mktemp("craft"), skewed_target, rich_suite(), request.param)
    samples = add_noise(case.suite, case.samples, 1)
    solver = case.solver(UNCERTAINTY)
    prior, parts, state = begun(case, solver, samples, EDGES)
    models, before, fits = [], [], []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_equations, "CURVED", np.inf)
        for part in parts:
            models.append(block_model(solver, state, part))
            before.append(state)
            fits.append(solver.solve(state, models[-1]))
            state = fits[-1].state
    return Solved(solver, prior, case.suite, parts, models, before, fits)


def raw_encoder_rows(block, joints, suite):
    """Return [A | b] of the samples of joint sensors by the coefficients' errors."""
    A, b = [], []
    for d, name in enumerate(("encoders", "joint_rates")):
        samples, sigma = block.samples[name], suite.sigmas(name)[0]
        B = joints.basis(samples.time, d)
        A.append(B / sigma)
        b.append((samples.value - B @ joints.coefficients) / sigma)
    A, b = np.vstack(A), np.vstack(b)
    J = b.shape[1]
    return np.kron(np.eye(J), A), b.T.ravel()


def dense(solved):
    """Return [A | b] and the columns of ψ and bodies of one problem for all blocks.

    The unknowns are those of the first block's start, the random walk's steps and new coefficients
    of the joints of every block, ψ, and the bodies' errors. The unknowns of each block are linear
    functions of these, δ = T g + o.
    """
    model = solved.models[0]
    J = model.motion.joints.coefficients.shape[1]
    sizes = {"start": 6, "momentum": 6, "bias of gyro": 3, "bias of gyro_2": 3, "head": ORDER * J}
    sizes |= {f"walk {k}": 3 for k in range(len(solved.models))}
    sizes |= {
        f"joints {k}": (each.motion.joints.size - ORDER) * J for k, each in enumerate(solved.models)
    }
    sizes |= {"psi": 10, "bodies": solved.solver.consider_count}
    ends = np.cumsum([0, *sizes.values()])
    g = {name: slice(a, b) for name, a, b in zip(sizes, ends[:-1], ends[1:])}
    n = ends[-1]
    unit = np.eye(n)

    # The prior about the nominal values of the first block.
    prior, suite = solved.prior, solved.suite
    nominal = solved.before[0].nominal
    priors = {
        "start": np.repeat([np.pi, 1e3], 3),
        "momentum": np.repeat([prior.L_sigma, prior.v_sigma], 3),
        "bias of gyro": np.full(3, suite.gyro.bias_sigma),
        "bias of gyro_2": np.full(3, suite["gyro_2"].bias_sigma),
        "head": np.full(ORDER * J, 1e6),
        "psi": prior.psi_sigma,
    }
    rows, rest = [], []
    for name, sigma in priors.items():
        rows.append(unit[g[name]] / sigma[:, None])
        rest.append(np.zeros(len(sigma)))
    rest[-1] = (prior.psi - nominal.psi) / prior.psi_sigma

    samples = 0.0
    start, offset = unit[g["start"]], np.zeros(6)
    momentum, L_offset = unit[g["momentum"]], np.zeros(6)
    first, first_offset = unit[g["bias of gyro"]], np.zeros(3)
    constant, constant_offset = unit[g["bias of gyro_2"]], np.zeros(3)
    head, joints_before = unit[g["head"]], None
    for k, model in enumerate(solved.models):
        now, joints = solved.before[k].nominal, model.motion.joints
        K = joints.size
        T, o = np.zeros((model.size + sizes["bodies"], n)), np.zeros(model.size + sizes["bodies"])
        T[model.columns["start"]], o[model.columns["start"]] = start, offset
        T[model.columns["momentum"]], o[model.columns["momentum"]] = momentum, L_offset
        last = first + unit[g[f"walk {k}"]]
        T[model.columns["bias of gyro"]] = np.vstack([first, last])
        o[model.columns["bias of gyro"]] = np.tile(first_offset, 2)
        T[model.columns["bias of gyro_2"]] = constant
        o[model.columns["bias of gyro_2"]] = constant_offset
        place = model.columns["joints"].start + np.arange(K * J).reshape(J, K)
        T[place[:, :ORDER].ravel()] = head
        if joints_before is not None:
            o[place[:, :ORDER].ravel()] = (
                joints_before.coefficients[-ORDER:] - joints.coefficients[:ORDER]
            ).T.ravel()
        T[place[:, ORDER:].ravel()] = unit[g[f"joints {k}"]]
        T[model.columns["psi"]], T[model.columns["bodies"]] = unit[g["psi"]], unit[g["bodies"]]

        trajectory = model.motion.trajectory(replace(now, bias=now.bias[[0, 0, 1]]))
        A, turn = model.jacobian(trajectory)
        b = model.residuals(trajectory)
        rows.append(A @ T)
        rest.append(b - A @ o)
        growth = suite.gyro.bias_growth * np.sqrt(joints.end - joints.start)
        rows.append(unit[g[f"walk {k}"]] / growth)
        rest.append(np.zeros(3))
        B, b = raw_encoder_rows(solved.blocks[k], joints, suite)
        samples += float(b @ b - b @ (B @ np.linalg.lstsq(B, b, rcond=None)[0]))
        rows.append(B @ T[model.columns["joints"]])
        rest.append(b - B @ o[model.columns["joints"]])

        # What the next block starts from, as errors of its own nominal values.
        if k + 1 == len(solved.models):
            break
        after, T_s = solved.before[k + 1].nominal, joints.end - joints.start
        R_end = Rotation.from_matrix(trajectory.R[len(model.motion.nodes) - 1])
        moved = (R_end * after.attitude.inv()).as_rotvec()
        p = start[3:] + T_s * momentum[3:]
        p_offset = offset[3:] + T_s * L_offset[3:] + now.p_Wcm + T_s * now.v_Wcm - after.p_Wcm
        start = np.vstack([turn @ T, p])
        offset = np.concatenate([turn @ o + moved, p_offset])
        L_offset = L_offset + np.concatenate([now.L - after.L, now.v_Wcm - after.v_Wcm])
        first, first_offset = last, first_offset + now.bias[0] - after.bias[0]
        constant_offset = constant_offset + now.bias[1] - after.bias[1]
        head = T[place[:, -ORDER:].ravel()]
        joints_before = joints
    return np.vstack(rows), np.concatenate(rest), g["psi"], g["bodies"], samples


@pytest.fixture(scope="module")
def dense_solution(solved):
    """Return information, solution, gain by the bodies' errors and χ² of the dense problem."""
    A, b, psi, bodies, own = dense(solved)
    scale = np.linalg.norm(A, axis=0)
    Q, R = np.linalg.qr(A[:, : bodies.start] / scale[: bodies.start])
    inverse = np.linalg.inv(R)
    x = inverse @ (Q.T @ b) / scale[: bodies.start]
    gain = -(inverse @ (Q.T @ A[:, bodies]))[psi] / scale[psi, None]
    spread = inverse[psi] / scale[psi, None]
    residual = b - A[:, : bodies.start] @ x
    return np.linalg.inv(spread @ spread.T), x[psi], gain, residual @ residual - own


def whitened(matrix, sigma):
    return matrix * sigma * sigma[:, None]


def test_information_about_the_target(solved, dense_solution):
    """With all else eliminated, that of the dense problem; to 1e-5 in every combination."""
    information, _, _, _ = dense_solution
    found = solved.fits[-1].state.psi_information()
    root = np.linalg.inv(np.linalg.cholesky(information))
    np.testing.assert_allclose(root @ found @ root.T, np.eye(10), rtol=0, atol=1e-5)


def test_estimate_of_the_target(solved, dense_solution):
    information, step, _, _ = dense_solution
    state = solved.fits[-1].state
    error = best_psi(state) - (solved.before[0].nominal.psi + step)
    assert np.sqrt(error @ information @ error) < 1e-4  # σ
    assert np.sqrt(step @ information @ step) > 1.0  # the step itself is no rounding error


def test_chi_squared_of_all_blocks(solved, dense_solution):
    """The smallest residual sum of squares, with the bodies' errors at zero, is that of the sum."""
    _, _, _, smallest = dense_solution
    bare = replace(solved.solver, known_bodies=None)
    assert bare.consider_count == 0
    state, total, freedom = solved.before[0], 0.0, 0
    state = replace(state, by_bodies=np.zeros((len(state.root), 0)), bodies=np.zeros((0, 1)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_equations, "CURVED", np.inf)
        for block in solved.blocks:
            fit = bare.solve(state, block_model(bare, state, block))
            total, freedom, state = total + fit.chi_squared, freedom + fit.freedom, fit.state
    assert total == pytest.approx(smallest, rel=1e-4)
    readings = sum(3 * len(block.samples[name]) for block in solved.blocks for name in fit.times)
    # Every unknown has a prior; the joints' derivatives at a start are known from two sides.
    assert freedom == readings + len(solved.blocks) * ORDER * bare.joint_count
    assert chi2.ppf(1e-4, freedom) < total < chi2.isf(1e-4, freedom)


def test_what_uncertain_bodies_add_to_the_covariance(solved, dense_solution):
    """Consider covariance: the change of the estimate by each error, at one σ, squared."""
    _, _, gain, _ = dense_solution
    expected = gain @ gain.T
    sigma = 1 / np.sqrt(np.diag(expected))
    found = solved.fits[-1].state.psi_consider()
    np.testing.assert_allclose(whitened(found, sigma), whitened(expected, sigma), atol=1e-4)
    information, _, _, _ = dense_solution
    assert (np.diag(expected) > 1 / np.diag(information)).any()


@pytest.mark.parametrize("misfit", [1.0, 4.0])
def test_errors_of_the_bodies_are_estimated_with_their_prior(solved, misfit):
    """Estimate, covariance and χ² are those of the dense problem, with the noise that is found."""
    A, b, psi, bodies, own = dense(solved)
    prior = np.eye(A.shape[1])[bodies]
    scale = np.linalg.norm(A, axis=0)
    rows = np.vstack([A / np.sqrt(misfit), prior]) / scale
    Q, R = np.linalg.qr(rows)
    rest = np.concatenate([b / np.sqrt(misfit), np.zeros(len(prior))])
    inverse = np.linalg.inv(R)
    step = (inverse @ (Q.T @ rest) / scale)[psi]
    spread = inverse[psi] / scale[psi, None]
    expected = spread @ spread.T
    state = solved.fits[-1].state.with_estimated_bodies(misfit)
    noise = np.linalg.inv(state.psi_information())
    sigma = 1 / np.sqrt(np.diag(expected))
    found = misfit * noise + state.psi_consider()
    np.testing.assert_allclose(whitened(found, sigma), whitened(expected, sigma), atol=1e-4)
    error = best_psi(state) - (solved.before[0].nominal.psi + step)
    assert np.abs(error * sigma).max() < 1e-3
    if misfit == 1:
        smallest = np.sum((rest - Q @ (Q.T @ rest)) ** 2) - own
        total = sum(fit.chi_squared for fit in solved.fits)
        assert total == pytest.approx(smallest, rel=1e-4)


def test_the_equations_of_psi_contain_the_bodies_errors(solved):
    """χ² at the nominal ψ, at its minimum over all else, is that of the dense problem."""
    A, b, psi, bodies, _ = dense(solved)
    prior = np.eye(A.shape[1])[bodies]
    rows, rest = np.vstack([A, prior]), np.concatenate([b, np.zeros(len(prior))])
    costs = []
    for part in (rows, np.delete(rows, psi, axis=1)):
        Q, _ = np.linalg.qr(part / np.linalg.norm(part, axis=0))
        costs.append(float(np.sum((rest - Q @ (Q.T @ rest)) ** 2)))
    free, held = costs
    state = solved.fits[-1].state
    assert held - free > 5
    assert state.psi_misfit() == pytest.approx(held - free, rel=1e-3)
    scaled = rows / np.linalg.norm(rows, axis=0)
    scale = np.linalg.norm(rows, axis=0)[psi]
    inverse = np.linalg.inv(np.linalg.qr(scaled).R)[psi] / scale[:, None]
    R, z = state.psi_equations()
    sigma = np.sqrt(np.diag(inverse @ inverse.T))
    found = np.linalg.inv(R.T @ R)
    np.testing.assert_allclose(
        whitened(found, 1 / sigma), whitened(inverse @ inverse.T, 1 / sigma), atol=1e-4
    )
    error = np.linalg.solve(R, z) - (best_psi(state.with_estimated_bodies()) - state.nominal.psi)
    assert np.abs(error / sigma).max() < 1e-3


@pytest.mark.parametrize("misfit", [1.0, 4.0])
def test_the_bodies_errors_are_estimated_alike_about_other_values(solved, misfit):
    """About errors p0 the prior of the rest p' = p − p0 is N(−p0, 1), and z_p becomes z_p − R p0.

    What remains is linear in p', so that the best target does not depend on p0.
    """
    state = solved.fits[-1].state
    c = len(state.bodies)
    moved = np.random.default_rng(3).normal(size=c)
    rows, rest = state.bodies[:, :c], state.bodies[:, c] - state.bodies[:, :c] @ moved
    about = replace(
        state,
        rest=state.rest - state.by_bodies @ moved,
        bodies=np.column_stack([rows, rest]),
        errors=moved,
    )
    np.testing.assert_allclose(about.best_errors()[0], state.best_errors()[0], atol=1e-9)
    best = [best_psi(each.with_estimated_bodies(misfit, 0.01)) for each in (state, about)]
    sigma = np.sqrt(np.diag(np.linalg.inv(state.psi_information()) + state.psi_consider()))
    assert np.abs((best[1] - best[0]) / sigma).max() < 1e-6
    assert np.abs((about.rest - state.rest)[-10:]).max() > 1


def test_number_of_linearizations_does_not_change_the_solution(solved):
    """The equations belong to the nominal values of the state, also if the iteration is cut."""
    found = []
    for most, curved in ((1, np.inf), (1, -1.0), (2, -1.0), (5, -1.0)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(block_equations, "CURVED", curved)
            patch.setattr(blocks, "MOST_ITERATIONS", most)
            found.append(solved.solver.solve(solved.before[0], solved.models[0]).state)
    best = [solution_of(state) for state in found]
    for values in best[:-1]:
        assert np.linalg.norm(found[-1].root @ (values - best[-1])) < 0.1  # σ of all together


def test_a_fast_walk_of_the_bias_ends_at_its_last_node(tmp_path, skewed_target):
    """The state's bias is that at the end of the block, also after a second linearization."""
    suite = coarse_suite(gyro=Gyro(20.0, 0.005, 1.0, 300.0))
    case = make_case(tmp_path, skewed_target, suite, duration=1.0)
    solver = case.solver()
    samples = add_noise(suite, case.samples, 2)
    _, (part,), state = begun(case, solver, samples, (-1e-7, 1.0))
    place, found = solver.places["bias"], []
    for curved in (np.inf, -1.0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(block_equations, "CURVED", curved)
            end = solver.solve(state, block_model(solver, state, part)).state
        found.append(solution_of(end)[place])
    root = np.linalg.inv(end.root)[place]
    sigma = np.sqrt(np.diag(root @ root.T))
    np.testing.assert_allclose(found[1] / sigma, found[0] / sigma, atol=0.05)
    expected = SensorNoise(suite, 2).gyro_bias(21)[-1]
    assert np.abs((found[0] - expected) / sigma).max() < 4


def solution_of(state):
    """Return the values of all quantities (n,) that solve a state's equations."""
    now = state.nominal
    nominal = [now.attitude.as_rotvec(), now.p_Wcm, now.L, now.v_Wcm, now.bias.ravel()]
    nominal = np.concatenate([*nominal, state.track.mean.T.ravel(), now.psi])
    return nominal + np.linalg.solve(state.root, state.rest)


def test_an_unknown_change_adds_its_covariance(solved):
    """To the quantity itself; the estimate remains, also with the bodies' share."""
    solver, state = solved.solver, solved.fits[0].state
    sigmas = {"L": 0.3, "attitude": 1e-4, "bias": 2e-6, "v_Wcm": 0.0}
    loose = solver.loosened(state, sigmas)
    added = np.zeros(len(state.root))
    for name, sigma in sigmas.items():
        added[solver.places[name]] = sigma**2
    inverse = np.linalg.inv(state.root)
    covariance = inverse @ inverse.T + np.diag(added)
    after = np.linalg.inv(loose.root)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        after @ after.T / sigma / sigma[:, None], covariance / sigma / sigma[:, None], atol=1e-7
    )
    np.testing.assert_allclose(after @ loose.rest / sigma, inverse @ state.rest / sigma, atol=1e-7)
    gain, expected = after @ loose.by_bodies, inverse @ state.by_bodies
    np.testing.assert_allclose(gain / sigma[:, None], expected / sigma[:, None], atol=1e-6)


def test_a_settled_state_is_the_same_knowledge(solved):
    """About other nominal values: the same information and solution, the rest is that of ψ."""
    solver, fit = solved.solver, solved.fits[0]
    state, plausible = fit.state, solved.prior.plausible
    moved = solver.settled(state, plausible)
    np.testing.assert_array_equal(moved.root, state.root)
    size = np.abs(state.rest).max()
    joints = solver.places["joints"]
    np.testing.assert_allclose(moved.rest[joints.stop :], solver.settled(moved).rest[joints.stop :])
    assert np.abs(best_psi(moved) - best_psi(state)).max() < 1e-9 * size
    moved_on = solver.settled(moved, plausible)
    np.testing.assert_allclose(moved_on.nominal.psi, moved.nominal.psi, rtol=1e-9)
    assert moved.psi_misfit() <= state.psi_misfit() * (1 + 1e-9)


def test_only_well_known_combinations_of_the_target_are_moved():
    """σ below 2 % of the plausible size; the other entries are the best for the moved ones."""
    rng = np.random.default_rng(7)
    plausible = np.geomspace(1.0, 30.0, 10)
    U, V = (np.linalg.qr(rng.normal(size=(10, 10)))[0] for _ in range(2))
    sigmas = np.array([1e-3, 1e-3, 0.01, 0.015, 0.019, 0.021, 0.03, 0.3, 3.0, 30.0])
    corner = np.linalg.qr(U @ np.diag(1 / sigmas) @ V.T / plausible)[1]
    R = np.triu(rng.normal(size=(14, 14)) + 3 * np.eye(14))
    R[4:, 4:] = corner
    z = rng.normal(size=14)
    x = block_state.solution(R, z, plausible)
    right = np.linalg.svd(corner * plausible)
    in_axes = right[2] @ (x[4:] / plausible)
    full = right[2] @ (np.linalg.solve(corner, z[4:]) / plausible)
    np.testing.assert_allclose(in_axes[:5], full[:5], rtol=1e-9)
    np.testing.assert_allclose(in_axes[5:], 0, atol=1e-12)
    np.testing.assert_allclose((R @ x - z)[:4], 0, atol=1e-9)
    for count in (10, 12):
        held = block_state.solution(R, z, None, held=count)
        np.testing.assert_array_equal(held[-count:], 0)
        np.testing.assert_allclose((R @ held - z)[:-count], 0, atol=1e-9)


def test_the_best_constants_for_a_target_minimize_the_squares(solved):
    """Compared with the least squares of all equations at that ψ."""
    rng = np.random.default_rng(11)
    R, z = np.triu(rng.normal(size=(16, 16)) + 4 * np.eye(16)), rng.normal(size=16)
    nominal = replace(solved.fits[0].state.nominal, constants=rng.normal(size=3))
    state = replace(solved.fits[0].state, nominal=nominal, root=R, rest=z)
    step = rng.normal(size=10)
    least, *_ = np.linalg.lstsq(R[:, :6], z - R[:, 6:] @ step, rcond=None)
    np.testing.assert_allclose(
        state.best_constants(nominal.psi + step), nominal.constants + least[3:], rtol=1e-9
    )


@pytest.mark.parametrize(
    ("walks", "free"), [({}, 0), ({"acceleration_walk": 1e-6}, 3), ({"torque_walk": 1e-4}, 6)]
)
def test_a_force_that_walks_is_never_held(walks, free, tmp_path, skewed_target):
    """A constant delay and ψ keep their nominal values; so do forces that do not walk."""
    suite = rich_suite()
    suite.disturbances = Disturbances(acceleration=1e-5, torque=1e-3, **walks)
    suite.attitude = replace(suite.attitude, delay_ms=20.0)
    solver = make_case(tmp_path, skewed_target, suite, duration=1.0).solver()
    assert solver.held_count == 10
    about = replace(solver, is_about_constants=True)
    first = about.places["psi"].stop - about.held_count
    assert first == about.places["acceleration"].start + free


def test_samples_of_weight_zero_are_as_if_they_were_absent(solved):
    """The same information, solution and χ², whatever the samples' values."""
    solver, state, block = solved.solver, solved.before[1], solved.blocks[1]
    model = block_model(solver, state, block)
    gyro = block.samples.gyro
    keep = np.arange(len(gyro)) % 3 > 0
    fewer = replace(block, samples=block.samples.updated({"gyro": gyro.where(keep)}))
    bad = gyro.value + np.where(keep, 0.0, 1e-3)[:, None]
    spoiled = replace(block, samples=block.samples.updated({"gyro": replace(gyro, value=bad)}))
    expected = solver.solve(state, block_model(solver, state, fewer))
    weights = [
        keep if name == "gyro" else np.ones(len(s.samples)) for name, s in model.sensors.items()
    ]
    weights = np.concatenate(weights).astype(float)
    found = solver.solve(state, block_model(solver, state, spoiled), weights=weights)
    np.testing.assert_allclose(
        found.state.root, expected.state.root, rtol=0, atol=1e-6 * np.abs(expected.state.root).max()
    )
    assert found.freedom == expected.freedom
    assert found.chi_squared == pytest.approx(expected.chi_squared, rel=1e-6)
    np.testing.assert_allclose(best_psi(found.state), best_psi(expected.state), rtol=1e-6)


def test_chi_squared_over_seeds(tmp_path, skewed_target):
    """χ² of each block is that of its degrees of freedom: its mean over seeds and blocks."""
    suite = coarse_suite(gyro=Gyro(20.0, 0.005, 1.0, 5.0))
    case = make_case(tmp_path, skewed_target, suite, duration=3.0)
    total, freedom, largest = 0.0, 0, 0.0
    for seed in range(10):
        samples = add_noise(suite, case.samples, seed)
        solver = case.solver()
        _, parts, state = begun(case, solver, samples, (-1e-7, 1.0, 2.0, 3.0))
        for part in parts:
            fit = solver.solve(state, block_model(solver, state, part))
            state = fit.state
            if part is parts[0]:
                continue  # its χ² is that of the prior, too
            assert fit.is_likely
            total, freedom = total + fit.chi_squared, freedom + fit.freedom
            largest = max(largest, fit.chi_squared / chi2.isf(1e-3, fit.freedom))
    low, high = chi2.ppf([1e-3, 1 - 1e-3], freedom)
    assert low < total < high
    assert largest < 1.2
