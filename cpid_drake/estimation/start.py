"""Where a fit starts: iterated least squares on what the thrust does to the momenta.

At about ten instants of every block, the angular momentum H about the system's centre of mass and
the velocity V of this centre are linear in the target's ψ. In W they are

    H = L + ∫ R (τ + (a − ρ) × f),      V = V₀ + ∫ R f / m,

with a constant L of each log, and the thrust. The motion is that of gyro, or attitude, and
position. The rows of a log with thrust are changes over about half a second, so that errors of the
thrust do not add up; its effects are linear in ψ and in its errors to first order (see
`likelihood.thrust`): Gauss-Newton from declared values.
Source: Ning et al. 2016, Eqs. 6 and 9, in the relative form (design, 3.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import eye_array
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.plane import NORMAL_W, tilt
from cpid_drake.dynamics.rotations import exponentials, rotate, skew
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.actuators import thrust_log
from cpid_drake.estimation.likelihood.constants import THRUSTERS, VALVE_DELAY
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.likelihood.thrust import Push, inverse_mass
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model, undetermined
from cpid_drake.logs.log import Samples

_INSTANTS = 10  # in a block
_DEGREE = 5  # of the polynomials through the samples of a block
_FEWEST = 4  # samples of a block for a polynomial
_CLOSE = 1.0  # fall of χ² with which a pass is the last one: the fit starts within a σ
_PASSES = 8  # the noise of the rows is that of their residuals at the values of the pass before


@dataclass(frozen=True, eq=False)
class SeenMotion:
    """What the samples of a log show of its motion, at M instants.

    Attributes:
        time: (M,) [s].
        R: (M, 3, 3) attitudes R_WB.
        w: (M, 3) angular velocity w_WB_B.
        p, v: (M, 3) position and velocity of B's origin in W; NaN where nothing shows them.
        q: (M, J) joint positions.
        dynamics: of the known bodies.

    """

    time: NDArray[np.float64]
    R: NDArray[np.float64]
    w: NDArray[np.float64]
    p: NDArray[np.float64]
    v: NDArray[np.float64]
    q: NDArray[np.float64]
    dynamics: BodyDynamics


def start_of(
    model: Model, logs: Sequence[LogState], values: Values | None = None
) -> tuple[Values, list[LogState]]:
    """Return values of all unknowns, and the logs with a start.

    A log with thrust aims at what the samples of every block show.

    Args:
        model: the unknowns.
        logs: the logs.
        values: given values of unknowns of the hardware and of the target; default: their means.

    """
    given = values or {}
    motions = [_motion(model, log) for log in logs]
    found = _balanced(model, logs, motions)
    values = model.start([log.name for log in logs]) | found | given
    try:
        for motion in motions:
            motion.dynamics.mobility(values[PSI])
    except InputError:  # the system could not turn about every axis
        values = values | {PSI: model.unknown(PSI).mean}
    started = []
    for log, motion in zip(logs, motions, strict=True):
        L = _momentum(motion, found[PSI])  # as the samples show, whatever target is given
        states = _states(model, log, motion, L, values[PSI])
        first = states[0]
        values[f"{MOMENTUM}|{log.name}"] = np.concatenate([first.L, first.v_Wcm])
        started.append(replace(log, start=first, aims=states))
    return values, started


def _balanced(
    model: Model, logs: Sequence[LogState], motions: Sequence[SeenMotion]
) -> dict[str, NDArray[np.float64]]:
    """Return ψ and the errors of each log's thrust, from all rows and the priors."""
    table = {name: model.unknown(name) for name in (PSI, *model.constants.of_thrust)}
    L = [f"L|{log.name}" for log in logs]
    sizes = {name: unknown.size for name, unknown in table.items()}
    of_L = np.full(3 * len(logs), model.L_sigma)
    sigma = np.concatenate([*(unknown.sigma for unknown in table.values()), of_L])
    mean = np.concatenate([*(u.mean for u in table.values()), np.zeros(3 * len(logs))])
    x, n = mean.copy(), sum(sizes.values())
    columns = np.repeat(list(sizes), list(sizes.values()))
    has_no_scale = np.isin(columns, [PSI, f"{THRUSTERS}.{VALVE_DELAY}"])
    without_forces = np.flatnonzero(np.append(columns == PSI, np.ones(4, bool)))
    found = Gaussian.of_rows({}, np.zeros((0, 1)))
    for _ in range(_PASSES):
        rows = np.column_stack([np.diag(1 / sigma), (mean - x) / sigma])
        found = prior = Gaussian.of_rows(sizes | dict.fromkeys(L, 3), rows)
        # Without forces and inertia nothing is left: the noise is that with the declared forces.
        declared = np.where(has_no_scale, x[:n], mean[:n])
        for k, (log, motion) in enumerate(zip(logs, motions, strict=True)):
            own = x[n + 3 * k :][:3]
            both = (_rows(model, log, motion, each, own) for each in (x[:n], declared))
            for rows, at_declared in zip(*both, strict=True):
                noise = _spread(at_declared[:, without_forces], prior.marginal([PSI, L[k]]))
                noise = max(noise, 1e-9 * model.L_sigma)
                found = found.add(Gaussian.of_rows({**sizes, L[k]: 3}, rows / noise))
        step = found.solve(held={PSI: undetermined(model, x[:10], found)[0]})
        x, fall = x + step, found.cost(0 * step) - found.cost(step)
        if fall < _CLOSE:
            break
    return {u.key(log.name): x[found.places[n]] for log in logs for n, u in table.items()}


def _spread(rows: NDArray[np.float64], prior: Gaussian) -> float:
    """Return the root mean square of what rows [A | b] and a prior leave of b."""
    noise = float(np.sqrt(np.mean(rows[:, -1] ** 2))) if len(rows) else 0.0
    for _ in range(4 if noise else 0):
        step = prior.add(Gaussian.of_rows(prior.sizes, rows / noise)).solve()
        noise = float(np.sqrt(np.mean((rows[:, :-1] @ step - rows[:, -1]) ** 2))) + 1e-12
    return noise


def _momentum(motion: SeenMotion, psi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angular momentum (M, 3) in W."""
    dynamics = motion.dynamics
    L = rotate(dynamics.inertia(psi), motion.w) + dynamics.momentum_at_rest(psi)
    return rotate(motion.R, L)


def _states(
    model: Model,
    log: LogState,
    motion: SeenMotion,
    L: NDArray[np.float64],
    psi: NDArray[np.float64],
) -> dict[int, TrajectoryState]:
    """Return the states at the start of blocks as their own samples show them, by block.

    Of a log without thrust, that at its start; momenta are those of the whole log.
    """
    dynamics, R, w = motion.dynamics, motion.R, motion.w
    com = dynamics.com(psi)
    p = np.nan_to_num(motion.p + rotate(R, com))
    v = motion.v + rotate(R, np.cross(w, com) + dynamics.com_rate(psi))
    v = np.where(np.isfinite(v).any(axis=0), v, 0.0)
    if not log.has_thrust:
        L, v = (np.broadcast_to(np.nanmean(each, axis=0), each.shape) for each in (L, v))
    v = np.nan_to_num(v)
    states = {}
    for k, block in enumerate(log.blocks if log.has_thrust else log.blocks[:1]):
        first = int(np.searchsorted(motion.time, block.start))
        if k and (first == len(motion.time) or motion.time[first] > block.end):
            continue
        time, attitude = motion.time[first], Rotation.from_matrix(R[first])
        place = p[first] + (block.start - time) * v[first]
        seen = block.samples.attitude
        if k == 0 and len(seen):
            time, attitude = seen.time[0], Rotation.from_quat(seen.value[0], scalar_first=True)
        attitude = attitude * Rotation.from_rotvec((block.start - time) * w[first])
        turning = L[first]
        if model.tree.normal_B is not None:
            q_WB = attitude.as_quat(scalar_first=True)
            attitude = Rotation.from_rotvec(tilt(q_WB[None], model.tree.normal_B)[0]) * attitude
            turning = turning * NORMAL_W
        states[k] = TrajectoryState(psi, attitude, place, v[first], turning)
    return states


def _rows(
    model: Model,
    log: LogState,
    motion: SeenMotion,
    x: NDArray[np.float64],
    L: NDArray[np.float64],
) -> list[NDArray[np.float64]]:
    """Return rows [A | b] of H, and with thrust of V, about ψ, the errors of the thrust, and L."""
    psi, dynamics, R, w = x[:10], motion.dynamics, motion.R, motion.w
    by_psi = R @ dynamics.regressor(w)
    (turn, push), (turn_by_psi, turn_by, push_by) = _pushed(model, log, motion, x)
    one = np.broadcast_to(np.eye(3), (len(R), 3, 3))
    b = _momentum(motion, psi) - turn - L
    turning = np.concatenate([by_psi - turn_by_psi, -turn_by, -one, -b[..., None]], axis=2)
    if not log.has_thrust:
        return [
            (turning if model.tree.normal_B is None else turning[:, 2:]).reshape(-1, len(x) + 4)
        ]
    # V: that of B's origin, and of the centre of mass against it.
    com, rate = dynamics.com_regressor(), dynamics.com_rate_regressor()
    V_by = np.zeros((len(R), 3, 10))
    V_by[:, :, :4] = R @ (skew(w) @ com + rate)
    V_by[:, :, 0] += push / dynamics.mass**2
    inverse = inverse_mass(dynamics.mass, float(psi[0]))
    moved = np.cross(w, dynamics.com(psi)) + dynamics.com_rate(psi)
    V = motion.v + rotate(R, moved) - inverse * push
    moving = np.concatenate([V_by, -inverse * push_by, 0 * one, -V[..., None]], axis=2)
    moving = moving[np.isfinite(motion.v).all(axis=1)]
    if model.tree.normal_B is not None:
        turning, moving = turning[:, 2:], moving[:, :2]
    lag = _INSTANTS // 2
    return [(each[lag:] - each[:-lag]).reshape(-1, len(x) + 4) for each in (turning, moving)]


def _motion(model: Model, log: LogState) -> SeenMotion:
    """Return what the samples of a log show of its motion; an instant at rest if nothing."""
    attitude: tuple[float, NDArray[np.float64]] | None = None
    times, rates, attitudes, places, joints = [], [], [], [], []
    for block, part in zip(log.blocks, log.joints, strict=True):
        t = np.linspace(block.start, block.end, _INSTANTS + 2)[1:-1]
        found = _rates(block, t, attitude)
        if found is None:
            continue
        w, R, t = found
        attitude = float(t[-1]), R[-1]
        times.append(t)
        rates.append(w)
        attitudes.append(R)
        places.append(_places(block, t))
        joints.append(part.evaluate(t))
    if not times:
        first = log.blocks[0].samples.attitude.value[:1]
        times, rates = [np.array([log.blocks[0].start])], [np.zeros((1, 3))]
        attitudes = [Rotation.from_quat(first, scalar_first=True).as_matrix()]
        places, joints = [_places(log.blocks[0], times[0])], [log.joints[0].evaluate(times[0])]
    w, q = np.concatenate(rates), np.concatenate(joints)
    normal_B = model.tree.normal_B
    if normal_B is not None:
        w = (w @ normal_B)[:, None] * normal_B
    dynamics = BodyDynamics.at(model.tree, q[:, 0], q[:, 1])
    p, v = np.moveaxis(np.concatenate(places), 1, 0)
    return SeenMotion(
        np.concatenate(times),
        np.concatenate(attitudes),
        w,
        p,
        v,
        q[:, 0],
        dynamics,
    )


def _places(block: Block, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return position and velocity (M, 2, 3) of B's origin in W at times; NaN without samples."""
    place, cheb = _enough(block, "position"), np.polynomial.chebyshev
    if place is None:
        return np.full((len(t), 2, 3), np.nan)
    middle, half = (block.start + block.end) / 2, block.length / 2
    c = cheb.chebfit((place.time - middle) / half, place.value, min(_DEGREE, len(place) - 2))
    at = (t - middle) / half
    both = cheb.chebval(at, c).T, cheb.chebval(at, cheb.chebder(c)).T / half
    return np.stack(both, axis=1)


def _rates(
    block: Block, t: NDArray[np.float64], before: tuple[float, NDArray[np.float64]] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Return ω (M, 3) in B, R_WB (M, 3, 3) and the times (M,) of a block; None without samples.

    Args:
        block: the samples.
        t: times inside the block.
        before: a time and the attitude R_WB then, which serves a block without attitude.

    """
    gyro, attitude = _enough(block, "gyro"), _enough(block, "attitude")

    def share(times: NDArray[np.float64]) -> NDArray[np.float64]:
        return 2 * (times - block.start) / block.length - 1

    cheb = np.polynomial.chebyshev
    if gyro is not None:
        if attitude is not None:
            k = len(attitude) // 2
            R = Rotation.from_quat(attitude.value[k], scalar_first=True).as_matrix()
            before = float(attitude.time[k]), R
        if before is None:
            return None
        c = cheb.chebfit(share(gyro.time), gyro.value, min(_DEGREE, len(gyro) - 2))
        grid = np.linspace(np.full(len(t), before[0]), t, 8, axis=1)
        w = cheb.chebval(np.clip(share(grid), -1, 1), c)  # (3, M, 8)
        steps = np.moveaxis((w[..., 1:] + w[..., :-1]) / 2 * np.diff(grid, axis=1), 0, -1)
        R = np.broadcast_to(before[1], (len(t), 3, 3))
        for k in range(steps.shape[1]):
            R = R @ exponentials(steps[:, k])
        return np.asarray(cheb.chebval(share(t), c).T), np.asarray(R), t
    if attitude is None:
        return None
    R = Rotation.from_quat(attitude.value, scalar_first=True)
    middle = R[len(attitude) // 2]
    turn = (middle.inv() * R).as_rotvec()
    c = cheb.chebfit(share(attitude.time), turn, min(_DEGREE, len(attitude) - 2))
    t = t[(t > attitude.time[0]) & (t < attitude.time[-1])]
    if not len(t):
        return None
    turn = cheb.chebval(share(t), c).T
    rate = cheb.chebval(share(t), cheb.chebder(c)).T * 2 / block.length
    w = rate - np.cross(turn, rate) / 2 + np.cross(turn, np.cross(turn, rate)) / 6
    return w, (middle * Rotation.from_rotvec(turn)).as_matrix(), t


def _enough(block: Block, name: str) -> Samples | None:
    """Return the samples of a sensor; None if they are few."""
    samples = block.samples[name]
    return samples if len(samples) >= _FEWEST else None


def _pushed(
    model: Model, log: LogState, motion: SeenMotion, x: NDArray[np.float64]
) -> tuple[tuple[NDArray[np.float64], ...], tuple[NDArray[np.float64], ...]]:
    """Return what the thrust has added to H and to the impulse (M, 3) since the first instant.

    And the derivatives of the first by ψ (M, 3, 10), of both by the errors (M, 3, P).
    """
    names, count = model.constants.of_thrust, len(motion.time)
    nominal = np.zeros(model.constants.size)
    for k, name in enumerate(names):
        nominal[model.constants.place(name)] = x[10 + k]
    given = thrust_log(log.thrust, model.suite.thrusters, model.constants, nominal)
    if given is None:
        zeros = np.zeros((count, 3)), np.zeros((count, 3))
        by = np.zeros((count, 3, len(names)))
        return zeros, (np.zeros((count, 3, 10)), by, by)
    value, by, t = given.samples.value, given.by.copy(), motion.time
    size = np.diff(_integral(given.samples, t), axis=0)  # (M − 1, V)
    flat = Samples(given.samples.time, by.reshape(len(by), -1))
    by_size = np.diff(_integral(flat, t), axis=0).reshape(count - 1, value.shape[1], -1)
    if given.delay >= 0:
        by_size[..., given.delay] = -np.diff(given.samples.held_at(t), axis=0)
    by_size = by_size * np.array([model.constants.errors[name].sigma for name in names])
    _, capture = forward_kinematics(model.tree, motion.q, np.zeros_like(motion.q))
    push = Push(
        given.actuators,
        size,
        t[1:],
        lambda at: eye_array(len(at), format="csr"),
        lambda at: (capture.R_WC[1:], capture.p_WC[1:]),
    )
    R, com = motion.R[1:], motion.dynamics.com(x[:10])[1:]
    torques, forces = push.torques(R, com), push.forces(R)
    force = push.force(R)
    by_com = np.zeros((count - 1, 3, 10))
    by_com[..., :4] = skew(force) @ R @ motion.dynamics.com_regressor()[1:]
    return (
        (_summed(push.torque(R, com)), _summed(force)),
        (
            _summed(by_com),
            _summed(np.einsum("mvp,mvi->mip", by_size, torques)),
            _summed(np.einsum("mvp,mvi->mip", by_size, forces)),
        ),
    )


def _integral(samples: Samples, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the integrals (M, n) of samples that hold until the next, from their start."""
    time, value = samples.time, samples.value
    whole = np.cumsum(np.diff(time)[:, None] * value[:-1], axis=0)
    whole = np.concatenate([np.zeros((1, value.shape[1])), whole])
    k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, None)
    return np.asarray(whole[k] + np.maximum(times - time[k], 0.0)[:, None] * value[k])


def _summed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
