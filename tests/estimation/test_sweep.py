"""A sweep with its eliminations is one dense least-squares problem of all unknowns at once."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import make_case
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, coarse_suite

from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.gaussian import Gaussian, indices_of
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.links import farthest
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import jumped, roll
from cpid_drake.estimation.sweep import back, sweep
from cpid_drake.estimation.target import psi_about
from cpid_drake.estimation.unknowns import MOMENTUM as MOMENTUM_OF_LOG
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.estimation.whitening import whitened
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor
from cpid_drake.sensors.suite import Disturbances

JUMP = np.repeat([1e-3, 1e-3, 1.0, 1e-3], 3)


class Vector:
    """All unknowns of a log as one vector, and the log and values for any such vector."""

    def __init__(self, model, log, values):
        self.model, self.log, self.values = model, log, values
        self.sizes = {u.key(log.name): u.size for u in model.table if u.name != MOMENTUM_OF_LOG}
        self.first = sum(self.sizes.values()) + 12
        pieces = [state.joints.size - ORDER for state in log.states]
        self.J = model.joint_count
        parts = 1 + sum(link.gap > 0 for link in log.links)
        self.joints = self.J * (sum(pieces) + ORDER * parts)
        self.walks = sum(link.walk.size for link in log.links)
        changes = roll(model, log, values).jumps
        links = enumerate(zip(log.links, changes, strict=True))
        self.changes = {k: u for k, (link, u) in links if link.is_open or link.gap}
        self.jumps = 12 * len(self.changes)
        self.forces = sum(state.forces.size for state in log.states)
        self.size = self.first + self.joints + self.walks + self.jumps
        self.size += self.forces

    def at(self, x):
        """Return the log and the values after a change x of all unknowns."""
        log, values, at = self.log, dict(self.values), 0
        for name, size in self.sizes.items():
            values[name] = values[name] + x[at : at + size]
            at += size
        pose, at = x[at : at + 12], at + 12
        state = log.starts[0]
        start = replace(
            state,
            attitude=Rotation.from_rotvec(pose[:3]) * state.attitude,
            p_Wcm=state.p_Wcm + pose[3:6],
            L=state.L + pose[6:9],
            v_Wcm=state.v_Wcm + pose[9:12],
        )
        values[f"{MOMENTUM_OF_LOG}|{log.name}"] = np.concatenate([start.L, start.v_Wcm])
        c = x[at : at + self.joints].reshape(-1, self.J)
        at, row, joints = at + self.joints, 0, []
        for state in log.states:
            part = state.joints
            step = c[row : row + part.size]
            joints.append(replace(part, coefficients=part.coefficients + step))
            row += part.size - (0 if state.link and state.link.gap else ORDER)
        steps = x[at : at + self.walks].reshape(len(log.links), -1)
        links = [replace(link, walk=link.walk + u) for link, u in zip(log.links, steps)]
        at += self.walks
        jumps = {
            k: u + x[at + 12 * i : at + 12 * i + 12]
            for i, (k, u) in enumerate(self.changes.items())
        }
        ends = np.cumsum([state.forces.size for state in log.states])[:-1]
        steps = np.split(x[self.size - self.forces :], ends)
        forces = [state.forces + step for state, step in zip(log.states, steps)]
        starts = [start, *log.starts[1:]]
        log = log.with_each(forces=forces, start=starts, joints=joints).with_links(links)
        return continued(self.model, log, values, jumps), values


def continued(model, log, values, jumps):
    """Return the log in which each block starts where the one before ends, after given jumps."""
    for k in range(len(log.blocks) - 1):
        end = jumped(log.starts[k + 1], -roll(model, log, values).jumps[k])
        starts = list(log.starts)
        starts[k + 1] = jumped(end, jumps.get(k, np.zeros(12)))
        log = log.with_each(start=starts)
    return log


def residuals(model, log, values):
    """Return all rows at given values: readings, joints, random walks, changes, and priors."""
    rolled = roll(model, log, values)
    parts = [
        whitened(log, k, name, rest).ravel()
        for k, block in enumerate(rolled.residuals)
        for name, rest in block.items()
    ]
    parts += [state.joints.rest.ravel() for state in log.states]
    walking = [u for u in model.table if u.walk]
    declared, gyro = model.suite.disturbances, model.suite.gyro
    shares = {"gyro.bias": gyro.bias_growth / gyro.bias_sigma}
    if declared is not None:
        shares["torque"] = declared.torque_walk / declared.torque
    sigma = np.concatenate([np.full(u.size, shares[u.name]) for u in walking])
    lengths = np.diff([block.start for block in log.blocks])
    walks = [link.walk for link in log.links]
    parts += [w / sigma / np.sqrt(length) for w, length in zip(walks, lengths)]
    parts += [rolled.jumps[k] / farthest(model) for k in log.open]
    for u in model.table:
        value = values[u.key(log.name)]
        if u.walk:  # the prior is that of the first value
            places = np.cumsum([0, *(w.size for w in walking)])
            k = walking.index(u)
            value = value - sum(w[places[k] : places[k + 1]] for w in walks)
        parts.append((value - u.mean) / sigma_of(model, u))
    return np.concatenate(parts)


def dense(model, log, values):
    """Return the Gauss-Newton step and the covariance of all unknowns, by central differences."""
    vector = Vector(model, log, values)
    sigma = np.abs(
        np.concatenate(
            [
                np.ones(n) if name != PSI else 10 * model.plausible
                for name, n in vector.sizes.items()
            ]
        )
    )
    step = 1e-4 * np.concatenate(
        [sigma, np.full(12, 0.1), np.full(vector.size - vector.first, 1e-2)]
    )
    columns = []
    for k, h in enumerate(step):
        x = h * np.eye(vector.size)[k]
        ahead, behind = (residuals(model, *vector.at(s * x)) for s in (1, -1))
        columns.append((behind - ahead) / (2 * h))
    A, b = np.column_stack(columns), residuals(model, log, values)
    scale = np.linalg.norm(A, axis=0)
    inverse = np.linalg.pinv(A / scale, rcond=1e-14) / scale[:, None]
    return inverse @ b, inverse @ inverse.T, b @ b


def sigma_of(model, unknown):
    """Return a prior's σ of an unknown; that of the target is vague."""
    return 1e3 * model.plausible if unknown.name == PSI else unknown.sigma


def swept_with_priors(model, log, values):
    rolled = roll(model, log, values)
    swept = sweep(model, log, rolled, values)
    rows = [(u.key(log.name), u) for u in model.table if not u.walk]
    sizes = {name: u.size for name, u in rows}
    R = np.diag(np.concatenate([1 / sigma_of(model, u) for _, u in rows]))
    z = np.concatenate([(u.mean - values[name]) / sigma_of(model, u) for name, u in rows])
    return swept, swept.gaussian.add(Gaussian.of_rows(sizes, np.column_stack([R, z])))


SUITES = {
    "plain": coarse_suite(gyro=Gyro(20.0, 0.005, 1.0, 5.0)),
    "gap": coarse_suite(gyro=Gyro(20.0, 0.005, 1.0, 50.0)),
    "errors": coarse_suite(
        gyro=Gyro(20.0, 0.005, 1.0, 5.0, scale_ppm=300.0, delay_ms=2.0),
        attitude=AttitudeSensor(5.0, 5.0, 40.0, np.array([0.0, 0.6, 0.8]), mounting_arcsec=60.0),
        encoders=JointSensor(20.0, 1e-5, zero_mrad=1.0),
        disturbances=Disturbances(
            acceleration=1e-4,
            torque=0.02,
            torque_walk=0.01,
            wheel=0.02,
            compliance_urad=3.0,
            translational_compliance_um=10.0,
        ),
    ),
    "white": coarse_suite(
        gyro=Gyro(20.0, 0.005, 1.0, 5.0),
        disturbances=Disturbances(acceleration_noise=1e-3, torque_noise=1e-2),
    ),
}


@pytest.fixture(
    scope="module",
    params=[
        "errors",
        "thrust",
        "gap",
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("bodies", "link")),
    ],
)
def problem(request, tmp_path_factory, skewed_target):
    """A turned base: two blocks of 0.8 s and 1.2 s, at values that are not the best ones."""
    suite = SUITES.get(request.param, SUITES["plain"])
    case = make_case(tmp_path_factory.mktemp("craft"), skewed_target, suite, MOMENTUM, 3.0)
    bodies = BodyUncertainty(mass=0.01, com=0.002) if request.param == "bodies" else None
    model, samples = Model(case.craft.tree, suite, bodies), add_noise(suite, case.samples, 1)
    second = 2.1 if request.param == "gap" else 1.8
    blocks = [case.block(a, b, samples) for a, b in ((0.999, 1.8), (second, 3.0))]
    log = LogState.of_blocks(model, blocks)
    jumps = {0: 0.3 * JUMP} if request.param == "link" else {}
    start = case.state(0.999)
    momentum = {f"{MOMENTUM_OF_LOG}|{log.name}": np.concatenate([start.L, start.v_Wcm])}
    values = model.start([log.name]) | {PSI: 1.02 * start.psi} | momentum
    turned = Rotation.from_rotvec([1e-3, -2e-3, 1.5e-3]) * start.attitude
    starts = replace(start, attitude=turned), case.state(second)
    log = log.with_each(start=starts).opened(jumps)
    rng = np.random.default_rng(2)
    for u in model.table:
        if u.name not in (PSI, MOMENTUM_OF_LOG):
            values[u.key(log.name)] = values[u.key(log.name)] + 0.3 * rng.normal(size=u.size)
    links = [replace(each, walk=0.01 * rng.normal(size=each.walk.shape)) for each in log.links]
    forces = [0.3 * rng.normal(size=state.forces.shape) for state in log.states]
    log = log.with_each(forces=forces).with_links(links)
    return model, continued(model, log, values, jumps), values


def test_a_sweep_is_one_dense_problem(problem):
    """Mean and covariance of the target, the hardware and the log; and the predicted χ²."""
    model, log, values = problem
    step, covariance, cost = dense(model, log, values)
    _, total = swept_with_priors(model, log, values)
    n = sum(u.size for u in model.table if u.name != MOMENTUM_OF_LOG)
    names = [u.key(log.name) for u in model.table]
    found, P = total.solve()[indices_of(total.places, names)], total.covariance()
    P = P[np.ix_(indices_of(total.places, names), indices_of(total.places, names))]
    dense_places = np.r_[np.arange(n), n + 6 : n + 12]  # L and v at the start are the momentum
    sigma = np.sqrt(np.diag(covariance)[dense_places])
    np.testing.assert_allclose(np.sqrt(np.diag(P)), sigma, rtol=2e-3)
    assert np.abs((found - step[dense_places]) / sigma).max() < 2e-2 * max(
        1.0, np.abs(step[dense_places] / sigma).max()
    )
    assert roll(model, log, values).cost(model, log) <= cost * (1 + 1e-9)


def test_the_way_back_finds_all_other_unknowns(problem):
    """After a step, the χ² of the full problem falls to what the linear problem predicts."""
    model, log, values = problem
    swept, total = swept_with_priors(model, log, values)
    before = np.sum(residuals(model, log, values) ** 2)
    step = total.solve()
    parts = {name: step[place] for name, place in total.places.items()}
    moved = back(model, log, swept, parts)
    after = {name: value + parts[name] for name, value in values.items()}
    rolled = roll(model, moved, after)
    jumps = {k: rolled.jumps[k] for k in log.open}
    found = np.sum(residuals(model, continued(model, moved, after, jumps), after) ** 2)
    predicted = total.cost(step)
    assert predicted < found + 1
    assert found - predicted < 0.02 * (before - predicted)


@pytest.mark.parametrize("mass", [0.9, 1.0, 1.3])
def test_the_targets_coordinates_do_not_depend_on_the_known_mass(mass, skewed_target):
    """ψ about another mass is that of the same target; its derivative is that of differences."""
    from cpid_drake.dynamics.parameterizations import relative_parameterization

    nominal = 430.0
    x = relative_parameterization(nominal).from_parameters(skewed_target.to_vector())
    psi, by_x = psi_about(x, nominal, mass * nominal)
    expected = relative_parameterization(mass * nominal).from_parameters(skewed_target.to_vector())
    np.testing.assert_allclose(psi, expected, rtol=1e-12)
    for k in range(10):
        h = 1e-6 * np.eye(10)[k]
        change = [psi_about(x + s * h, nominal, mass * nominal)[0] for s in (1, -1)]
        np.testing.assert_allclose(by_x[:, k], (change[0] - change[1]) / 2e-6, atol=1e-7)
