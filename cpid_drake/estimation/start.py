"""Where a fit starts: least squares on what the thrust does to the momenta.

At some instants of every block, the angular momentum H about the system's centre of mass and the
velocity V of this centre are linear in the target's ψ. In W they are

    H = L + ∫ R (τ + (a − ρ) × f),      V = V₀ + ∫ R f / m,

with a constant L of each log, and the declared thrust. The motion is that of splines through the
samples of gyro, or attitude, and position. The rows of a log with thrust, or with open ends of
blocks, are changes over about half a second, so that errors and sudden changes do not add up. Each
part of a log between gaps has its own L and V₀.
Source: Ning et al. 2016, Eqs. 6 and 9, in the relative form (design, 3.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_lsq_spline
from scipy.sparse import eye_array
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.plane import NORMAL_W, tilt
from cpid_drake.dynamics.rotations import angular_velocity, rotate, skew
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.actuators import thrust_log
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.likelihood.thrust import Push, inverse_mass
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model, Unknown
from cpid_drake.logs.log import Samples, concatenated_samples, without_flips
from cpid_drake.logs.splines import DEGREE, in_gap, knots_of

_INSTANTS = 10  # in a block; splines have half as many pieces


@dataclass(frozen=True, eq=False)
class SeenMotion:
    """What the samples of a log show of its motion, at M instants.

    Attributes:
        time: (M,) [s].
        R: (M, 3, 3) attitudes R_WB.
        w: (M, 3) angular velocity w_WB_B.
        p, v: (M, 3) position and velocity of B's origin in W; NaN where nothing shows them.
        q: (M, J) joint positions.
        dynamics: of the spacecraft's bodies.

    """

    time: Array
    R: Array
    w: Array
    p: Array
    v: Array
    q: Array
    dynamics: BodyDynamics


def start_of(
    model: Model, logs: Sequence[LogState], values: Values | None = None
) -> tuple[Values, list[LogState]]:
    """Return values of all unknowns, and the logs with a start.

    Args:
        model: the unknowns.
        logs: without a start.
        values: which stay if a log has a past.

    """
    parts = [[(part, _motion(model, part)) for part in _parts(log)] for log in logs]
    if values is None or not any(log.past for log in logs):
        psi = _balanced(model, [part for each in parts for part in each])
        values = model.start([log.name for log in logs]) | {PSI: psi}
    values, psi = dict(values), values[PSI]
    started = []
    for log, own in zip(logs, parts, strict=True):
        of_parts = [_states(model, *part, _momentum(part[1], psi), psi) for part in own]
        states = tuple(chain.from_iterable(of_parts))
        first = states[0]
        if log.past is None:
            values[f"{MOMENTUM}|{log.name}"] = np.concatenate([first.L, first.v_Wcm])
        started.append(log.with_each(start=states))
    return values, started


def state_of(model: Model, log: LogState, psi: Array) -> TrajectoryState:
    """Return the state at the start of a log without gaps, for a target ψ (10,)."""
    motion = _motion(model, log)
    return _states(model, log, motion, _momentum(motion, psi), psi)[0]


def _parts(log: LogState) -> list[LogState]:
    """Return the parts of a log between gaps, if attitudes are seen soon behind them."""
    begins = (
        k
        for k, link in enumerate(log.links, 1)
        if link.gap and k < len(log.blocks) and len(log.blocks[k].samples.attitude)
    )
    return [log.part(first, end) for first, end in pairwise([0, *begins, len(log.blocks)])]


def _balanced(model: Model, parts: Sequence[tuple[LogState, SeenMotion]]) -> Array:
    """Return ψ (10,) from all rows and the priors."""
    psi = model.unknown(PSI).mean
    gaussian = Gaussian.of_rows({PSI: 10}, np.zeros((10, 11)))
    for row in model.rows:
        gaussian = gaussian.add(row.moved(psi))
    for k, (log, motion) in enumerate(parts):
        L = Unknown(f"L|{k}", 3, np.zeros(3), np.full(3, model.L_sigma), "log")
        gaussian = gaussian.add(L.prior)
        for rows in _rows(model, log, motion, psi):
            left = rows[:, :-1] @ np.linalg.lstsq(rows[:, :-1], rows[:, -1])[0] - rows[:, -1]
            noise = max(np.sqrt(np.mean(left**2)), 1e-9 * model.L_sigma)
            gaussian = gaussian.add(Gaussian.of_rows({PSI: 10, L.name: 3}, rows / noise))
    return model.cone.start(gaussian.marginal([PSI]).moved(-psi))


def _momentum(motion: SeenMotion, psi: Array) -> Array:
    """Return the angular momentum (M, 3) in W."""
    dynamics = motion.dynamics
    L = rotate(dynamics.inertia(psi), motion.w) + dynamics.momentum_at_rest(psi)
    return rotate(motion.R, L)


def _states(
    model: Model, log: LogState, motion: SeenMotion, L: Array, psi: Array
) -> tuple[TrajectoryState, ...]:
    """Return the states at the start of all blocks, as their own samples show them.

    Without thrust and open ends, momenta are those of the whole log. A block without samples has
    the state of the instant before it.
    """
    dynamics, R, w = motion.dynamics, motion.R, motion.w
    com = dynamics.com(psi)
    p = motion.p + rotate(R, com)
    is_seen = np.isfinite(p).all(axis=1)
    if is_seen.any():
        p = np.column_stack([np.interp(motion.time, motion.time[is_seen], x[is_seen]) for x in p.T])
    p = np.nan_to_num(p)
    v = motion.v + rotate(R, np.cross(w, com) + dynamics.com_rate(psi))
    L, v = (np.where(np.isfinite(each).any(axis=0), each, 0.0) for each in (L, v))
    if not _changes(log):
        L, v = (np.broadcast_to(np.nanmean(each, axis=0), each.shape) for each in (L, v))
    v = np.nan_to_num(v)
    states = list[TrajectoryState]()
    for k, block in enumerate(log.blocks):
        first = min(int(np.searchsorted(motion.time, block.start)), len(motion.time) - 1)
        if first and motion.time[first] > block.end:
            first -= 1
        time, attitude = motion.time[first], Rotation.from_matrix(R[first])
        place = p[first] + (block.start - time) * v[first]
        attitudes = block.samples.attitude
        if k == 0 and len(attitudes):
            time, attitude = (
                attitudes.time[0],
                Rotation.from_quat(attitudes.value[0], scalar_first=True),
            )
        attitude = attitude * Rotation.from_rotvec((block.start - time) * w[first])
        turning, moving = L[first], v[first]
        if model.tree.normal_B is not None:
            q_WB = attitude.as_quat(scalar_first=True)
            attitude = Rotation.from_rotvec(tilt(q_WB[None], model.tree.normal_B)[0]) * attitude
            turning = turning * NORMAL_W
            in_plane = np.array([1.0, 1.0, 0.0])
            place, moving = place * in_plane + p[0] * NORMAL_W, moving * in_plane
        states.append(TrajectoryState(psi, attitude, place, moving, turning))
    return tuple(states)


def _rows(model: Model, log: LogState, motion: SeenMotion, psi: Array) -> list[Array]:
    """Return rows [A | b] of H, and of V if the momenta change, for a change of ψ and for L."""
    dynamics, R, w = motion.dynamics, motion.R, motion.w
    turn, turn_by_psi, push = _pushed(model, log, motion, psi)
    one = np.broadcast_to(np.eye(3), (len(R), 3, 3))
    b = _momentum(motion, psi) - turn
    by_psi = R @ dynamics.regressor(w) - turn_by_psi
    turning = np.concatenate([by_psi, -one, -b[..., None]], axis=2)
    if not _changes(log):
        return [(turning if model.tree.normal_B is None else turning[:, 2:]).reshape(-1, 14)]
    # V: that of B's origin, and of the centre of mass against it.
    com, rate = dynamics.com_regressor(), dynamics.com_rate_regressor()
    V_by = np.zeros((len(R), 3, 10))
    V_by[:, :, :4] = R @ (skew(w) @ com + rate)
    V_by[:, :, 0] += push / dynamics.mass**2
    inverse = inverse_mass(dynamics.mass, float(psi[0]))
    moved = np.cross(w, dynamics.com(psi)) + dynamics.com_rate(psi)
    V = motion.v + rotate(R, moved) - inverse * push
    moving = np.concatenate([V_by, 0 * one, -V[..., None]], axis=2)
    moving = moving[np.isfinite(motion.v).all(axis=1)]
    if model.tree.normal_B is not None:
        turning, moving = turning[:, 2:], moving[:, :2]
    lag = _INSTANTS // 2
    usable = (each for each in (turning, moving) if len(each) > lag)
    return [(each[lag:] - each[:-lag]).reshape(-1, 14) for each in usable]


def _changes(log: LogState) -> bool:
    """Return whether the momenta of a log may change."""
    return log.has_thrust or bool(log.open)


def _motion(model: Model, log: LogState) -> SeenMotion:
    """Return what the samples of a log show of its motion; an instant at rest if nothing."""
    normal_B, count = model.tree.normal_B, _INSTANTS // 2 * len(log.blocks)
    attitude, gyro, position = (
        concatenated_samples([block.samples[name] for block in log.blocks])
        for name in ("attitude", "gyro", "position")
    )
    attitude = replace(attitude, value=without_flips(attitude.value))
    t = np.concatenate([np.linspace(b.start, b.end, _INSTANTS + 2)[1:-1] for b in log.blocks])
    is_covered, q_WB, rate = _smoothed(attitude, t, count)
    t, w = t[is_covered], angular_velocity(q_WB, rate)
    if not len(t):
        t, q_WB, w = attitude.time[:1], attitude.value[:1], np.zeros((1, 3))
    is_covered, of_gyro, _ = _smoothed(gyro, t, count)
    w[is_covered] = of_gyro
    if normal_B is not None:
        w = (w @ normal_B)[:, None] * normal_B
    p, v = np.full((2, len(t), 3), np.nan)
    is_covered, *place = _smoothed(position, t, count)
    p[is_covered], v[is_covered] = place
    block = np.searchsorted([block.end for block in log.blocks], t)
    joints = [state.joints.evaluate(t[block == k]) for k, state in enumerate(log.states)]
    q, qdot = np.moveaxis(np.concatenate(joints), 1, 0)
    R = Rotation.from_quat(q_WB, scalar_first=True).as_matrix()
    return SeenMotion(t, R, w, p, v, q, BodyDynamics.at(model.tree, q, qdot))


def _smoothed(
    samples: Samples, times: Array, pieces: int
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Return which times are among samples, and values and rates of a spline there."""
    time, value = samples.time, samples.value
    if len(samples) < 2 * (DEGREE + 1):
        return np.zeros(len(times), bool), value[:0], value[:0]
    knots = knots_of(time, min(pieces, len(samples) // 4))
    spline = make_lsq_spline(time, value, knots, DEGREE)
    is_covered = (times >= time[0]) & (times <= time[-1]) & ~in_gap(time, times)
    return is_covered, spline(times[is_covered]), spline(times[is_covered], 1)


def _pushed(
    model: Model, log: LogState, motion: SeenMotion, psi: Array
) -> tuple[Array, Array, Array]:
    """Return what declared thrust has added to H (M, 3), and its derivative by ψ (M, 3, 10).

    And the impulse (M, 3), all since the first instant.
    """
    model = model.of_log(log.name)
    constants, count = model.constants, len(motion.time)
    given = thrust_log(log.thrust, model.suite.thrusters, constants, np.zeros(constants.size))
    if given is None:
        return np.zeros((count, 3)), np.zeros((count, 3, 10)), np.zeros((count, 3))
    size = np.diff(_integral(given.samples, motion.time), axis=0)  # (M − 1, V)
    _, capture = forward_kinematics(model.tree, motion.q, np.zeros_like(motion.q))
    push = Push(
        given.actuators,
        size,
        motion.time[1:],
        lambda at: eye_array(len(at), format="csr"),
        lambda at: (capture.R_WC[1:], capture.p_WC[1:]),
    )
    R, com = motion.R[1:], motion.dynamics.com(psi)[1:]
    force = push.force(R)
    by_psi = np.zeros((count - 1, 3, 10))
    by_psi[..., :4] = skew(force) @ R @ motion.dynamics.com_regressor()[1:]
    return _summed(push.torque(R, com)), _summed(by_psi), _summed(force)


def _integral(samples: Samples, times: Array) -> Array:
    """Return the integrals (M, n) of samples that hold until the next, from their start."""
    time, value = samples.time, samples.value
    whole = np.cumsum(np.diff(time)[:, None] * value[:-1], axis=0)
    whole = np.concatenate([np.zeros((1, value.shape[1])), whole])
    k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, None)
    return np.asarray(whole[k] + np.maximum(times - time[k], 0.0)[:, None] * value[k])


def _summed(values: Array) -> Array:
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
