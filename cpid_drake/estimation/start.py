"""Where a fit starts: least squares on the momentum rows of each log's smoothed motion.

The angular momentum H about the system's centre of mass and the velocity V of this centre are
linear in the target's ψ, see `dynamics.rows.conserved`. In W, with the declared thrust, they are

    H = L + ∫ R (τ + (a − ρ) × f),      V = V₀ + ∫ R f / m,

with constants L and V₀ of each part of a log between gaps, which the rows lose with their mean. In
a log with thrust, or with open ends of blocks, they lose them as changes over about half a second,
so that errors and sudden changes do not add up. The motion is that of splines through the samples
of gyro, or attitude, and position.
Source: Ning et al. 2016, Eqs. 6 and 9, in the relative form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import eye_array
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.momentum import MomentumSamples, momentum_samples
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.plane import NORMAL_W, levelled
from cpid_drake.dynamics.rotations import angular_velocity, rotate, skew
from cpid_drake.dynamics.rows import conserved
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.actuators import thrust_log
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.likelihood.thrust import Push, inverse_mass
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Samples, concatenated_samples, without_flips
from cpid_drake.logs.splines import DEGREE, in_gap, regression_spline

_INSTANTS = 10  # in a block
_PIECES = 2  # in a block, at least: with too few, a fast motion looks like noise


@dataclass(frozen=True, eq=False)
class PartRows:
    """The momentum rows of one part of a log between gaps, at M instants.

    Attributes:
        model: the unknowns, with the sensors of the log.
        log: the part.
        motion: the smoothed motion; position and velocity are zero where nothing shows them.
        is_placed: (M,) whether position samples show them.
        samples: the momentum samples of the motion.
        rows: (3, M, 3, 11) see `conserved`.

    """

    model: Model
    log: LogState
    motion: Motion
    is_placed: NDArray[np.bool_]
    samples: MomentumSamples
    rows: Array

    @classmethod
    def of(cls, model: Model, log: LogState) -> "PartRows":
        """Return the rows of a part of a log."""
        motion, is_placed = _smoothed_motion(model, log)
        samples = momentum_samples(model.tree, motion)
        model = model.of_log(log.name)
        return cls(model, log, motion, is_placed, samples, conserved(samples))

    @property
    def changes(self) -> bool:
        """Whether the momenta may change."""
        return self.log.has_thrust or bool(self.log.open)

    def values(self, psi: Array) -> tuple[Array, Array, Array]:
        """Return H, V and the place of the centre of mass, (M, 3) each in W, of a target ψ (10,).

        Where no position samples show the last two, they are those between the instants beside;
        zeros if none do.
        """
        H, *values = self.rows @ np.append(psi, -1.0)
        time, placed = self.motion.time, self.is_placed
        for value in values:
            for column in value.T:
                column[:] = np.interp(time, time[placed], column[placed]) if placed.any() else 0.0
        return H, values[0], values[1]

    def equations(self, psi: Array) -> list[Array]:
        """Return rows [A | b] (…, 11) of H, and of V, for a change of ψ (10,)."""
        # H(ψ) − ∫ torque = L and V(ψ) − ∫ force / m = V₀, to first order in a change of ψ
        equations = self.rows[:2].copy()
        equations[..., 10] = -self.rows[:2] @ np.append(psi, -1.0)
        H, V = equations - self._pushed(psi)
        if self.model.tree.normal_B is not None:
            H, V = H[:, 2:], V[:, :2]
        lag = _INSTANTS // 2 if self.changes else 0
        # L and V₀ cancel
        return [
            (rows[lag:] - rows[:-lag] if lag else rows - rows.mean(axis=0)).reshape(-1, 11)
            for rows in (H, V[self.is_placed])
            if len(rows) > lag
        ]

    def _pushed(self, psi: Array) -> Array:
        """Return [derivative by ψ | −] (2, M, 3, 11) of what declared thrust has added to H, V."""
        log, model, motion, samples = self.log, self.model, self.motion, self.samples
        constants, thrusters = model.constants, model.suite.thrusters
        pushed = np.zeros((2, *self.rows.shape[1:]))
        thrust = thrust_log(log.thrust, thrusters, constants, np.zeros(constants.size))
        if thrust is None:
            return pushed
        size = np.diff(_integral(thrust.samples, motion.time), axis=0)  # (M − 1, V)
        R, R_WC, place = (each[1:] for each in (motion.R_WB, samples.motion.R_WC, self.rows[2]))
        R_BW = np.swapaxes(R, -1, -2)
        p_BC = rotate(R_BW, (samples.motion.p_WC - motion.p_WB)[1:])
        com = rotate(R_BW, place @ np.append(psi, -1.0) - motion.p_WB[1:])
        push = Push(
            thrust.actuators,
            size,
            motion.time[1:],
            lambda at: eye_array(len(at), format="csr"),
            lambda at: (R_BW @ R_WC, p_BC),
        )
        force = push.force(R)
        # ∂((a − ρ) × f) = f × ∂ρ
        pushed[0, 1:, :, :10] = skew(force) @ place[..., :10]
        pushed[0, 1:, :, 10] = -push.torque(R, com)
        # ∂(f / m) = −f ∂μ / m_k²
        pushed[1, 1:, :, 0] = -force / samples.mass**2
        pushed[1, 1:, :, 10] = -force * inverse_mass(samples.mass, float(psi[0]))
        return np.cumsum(pushed, axis=1)


def start_of(
    model: Model, logs: Sequence[LogState], values: Values | None = None
) -> tuple[Values, list[LogState]]:
    """Return values of all unknowns, and the logs with a start.

    Args:
        model: the unknowns.
        logs: without a start.
        values: which stay if a log has a past.

    """
    parts = [[PartRows.of(model, part) for part in _parts(log)] for log in logs]
    if values is None or not any(log.past for log in logs):
        psi = _balanced(model, [part for each in parts for part in each])
        values = model.start([log.name for log in logs]) | {PSI: psi}
    values, psi = dict(values), values[PSI]
    started = []
    for log, of_log in zip(logs, parts, strict=True):
        states = tuple(chain.from_iterable(_states(part, psi) for part in of_log))
        if log.past is None:
            values[f"{MOMENTUM}|{log.name}"] = np.concatenate([states[0].L, states[0].v_Wcm])
        started.append(log.with_each(start=states))
    return values, started


def state_of(model: Model, log: LogState, psi: Array) -> TrajectoryState:
    """Return the state at the start of a log without gaps, for a target ψ (10,).

    Raises:
        InputError: no attitude samples.

    """
    return _states(PartRows.of(model, log), psi)[0]


def _parts(log: LogState) -> list[LogState]:
    """Return the parts of a log between gaps, if attitudes are seen soon behind them."""
    begins = (
        k
        for k, link in enumerate(log.links, 1)
        if link.gap and k < len(log.blocks) and len(log.blocks[k].samples.attitude)
    )
    return [log.part(first, end) for first, end in pairwise([0, *begins, len(log.blocks)])]


def _balanced(model: Model, parts: Sequence[PartRows]) -> Array:
    """Return ψ (10,) from all rows and the priors."""
    psi = model.unknown(PSI).mean
    gaussian = Gaussian.of_rows({PSI: 10}, np.zeros((10, 11)))
    for row in model.rows:
        gaussian = gaussian.add(row.minus(psi))
    for rows in chain.from_iterable(part.equations(psi) for part in parts):
        left = rows[:, :-1] @ np.linalg.lstsq(rows[:, :-1], rows[:, -1])[0] - rows[:, -1]
        noise = max(np.sqrt(np.mean(left**2)), 1e-9 * model.L_sigma)
        gaussian = gaussian.add(Gaussian.of_rows({PSI: 10}, rows / noise))
    return model.cone.start(gaussian.marginal([PSI]).minus(-psi))


def _states(part: PartRows, psi: Array) -> tuple[TrajectoryState, ...]:
    """Return the states at the start of all blocks, as their own samples show them.

    Without thrust and open ends, momenta are those of the whole part. A block without samples has
    the state of the instant before it.
    """
    motion, blocks, normal_B = part.motion, part.log.blocks, part.model.tree.normal_B
    start, end = np.array([(block.start, block.end) for block in blocks]).T
    first = np.minimum(np.searchsorted(motion.time, start), len(motion) - 1)
    first = np.maximum(first - (motion.time[first] > end), 0)
    time, q_WB = motion.time[first], motion.quaternion_WB[first]
    L, v, p = part.values(psi)
    if not part.changes:
        L, v = (np.broadcast_to(each.mean(axis=0), each.shape) for each in (L, v))
    L, v, p = L[first], v[first], p[first]
    if normal_B is not None:
        L, v = L * NORMAL_W, v * (1 - NORMAL_W)
        p[:, 2] = p[0, 2]
    p += (start - time)[:, None] * v
    attitudes, w_WB = blocks[0].samples.attitude, motion.w_WB[first]
    if len(attitudes):
        time[0], q_WB[0] = attitudes.time[0], attitudes.value[0]
    turn = Rotation.from_rotvec((start - time)[:, None] * w_WB)
    q_WB = (turn * Rotation.from_quat(q_WB, scalar_first=True)).as_quat(scalar_first=True)
    if normal_B is not None:
        q_WB = levelled(q_WB, normal_B)
    attitude = Rotation.from_quat(q_WB, scalar_first=True)
    return tuple(map(partial(TrajectoryState, psi), attitude, p, v, L))


def _smoothed_motion(model: Model, log: LogState) -> tuple[Motion, NDArray[np.bool_]]:
    """Return the motion that the samples of a log show, and where they show the position.

    An instant at rest if they are too few.

    Raises:
        InputError: no attitude samples.

    """
    normal_B, least = model.tree.normal_B, _PIECES * len(log.blocks)
    attitude, gyro, position = (
        concatenated_samples([block.samples[name] for block in log.blocks])
        for name in ("attitude", "gyro", "position")
    )
    if not len(attitude):
        raise InputError("no attitude samples: none to start from")
    attitude = replace(attitude, value=without_flips(attitude.value))
    t = np.concatenate([np.linspace(b.start, b.end, _INSTANTS + 2)[1:-1] for b in log.blocks])
    is_covered, q_WB, rate = _smoothed(attitude, t, least)
    t, w = t[is_covered], angular_velocity(q_WB, rate)
    if not len(t):
        t, q_WB, w = attitude.time[:1], attitude.value[:1], np.zeros((1, 3))
    is_covered, of_gyro, _ = _smoothed(gyro, t, least)
    w[is_covered] = of_gyro
    if normal_B is not None:
        w = (w @ normal_B)[:, None] * normal_B
    p, v = np.zeros((2, len(t), 3))
    is_placed, *place = _smoothed(position, t, least)
    p[is_placed], v[is_placed] = place
    block = np.searchsorted([block.end for block in log.blocks], t)
    joints = [state.joints.evaluate(t[block == k]) for k, state in enumerate(log.states)]
    q, qdot = np.moveaxis(np.concatenate(joints), 1, 0)
    attitude_WB = Rotation.from_quat(q_WB, scalar_first=True)
    motion = Motion(
        log.blocks[0].samples.joint_names,
        t,
        quaternion_WB=attitude_WB.as_quat(scalar_first=True),
        p_WB=p,
        w_WB=attitude_WB.apply(w),
        v_WB=v,
        q=q,
        qdot=qdot,
    )
    return motion, is_placed


def _smoothed(samples: Samples, times: Array, least: int) -> tuple[NDArray[np.bool_], Array, Array]:
    """Return which times are among samples, and values and rates of a spline there.

    It has at least so many pieces, if there are four times as many samples.
    """
    time, value = samples.time, samples.value
    if len(samples) < 2 * (DEGREE + 1):
        return np.zeros(len(times), bool), value[:0], value[:0]
    spline = regression_spline(samples, min(least, len(samples) // 4))
    is_covered = (times >= time[0]) & (times <= time[-1]) & ~in_gap(time, times)
    return is_covered, spline(times[is_covered]), spline(times[is_covered], 1)


def _integral(samples: Samples, times: Array) -> Array:
    """Return the integrals (M, n) of samples that hold until the next, from their start."""
    time = np.append(samples.time, max(samples.time[-1], times[-1]) + 1.0)
    whole = np.cumsum(np.diff(time)[:, None] * samples.value, axis=0)
    columns = [np.interp(times, time, np.append(0.0, column)) for column in whole.T]
    return np.stack(columns, axis=1)
