"""Where a fit of a log with thrust starts: iterated least squares on changes of both momenta.

With the motion that the samples show, the angular momentum H about the system's centre of mass and
the velocity V of this centre are linear in the target's ψ, and in W

    ΔH = Δ ∫ R (τ + (a − ρ) × f),      ΔV = Δ ∫ R f / m

over about a second, so that errors do not add up. The right sides are linear in ψ, and in the
errors of the thrust to first order (see `likelihood.thrust`): Gauss-Newton from declared values.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import eye_array
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.actuators import thrust_log
from cpid_drake.estimation.likelihood.constants import THRUSTERS, VALVE_DELAY
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.likelihood.thrust import Push, inverse_mass
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import PSI, Model, undetermined
from cpid_drake.logs.log import Samples

_LAG = 5  # instants between which momenta change
_PASSES = 8


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


def balanced_with_thrust(
    model: Model, logs: Sequence[LogState], motions: Sequence[SeenMotion | None]
) -> tuple[Values, list[NDArray[np.float64]]]:
    """Return ψ and the errors of each log's thrust, and L (3,) of each log at its first instant."""
    names = [PSI, *model.constants.of_thrust]
    table = {name: model.unknown(name) for name in names}
    sizes = {name: unknown.size for name, unknown in table.items()}
    mean = np.concatenate([unknown.mean for unknown in table.values()])
    x, seen = mean.copy(), [(log, m) for log, m in zip(logs, motions, strict=True) if m is not None]
    found = Gaussian.of_rows(sizes, np.zeros((0, len(x) + 1)))
    sigma = np.concatenate([unknown.sigma for unknown in table.values()])
    columns = np.repeat(list(table), [unknown.size for unknown in table.values()])
    has_no_scale = np.isin(columns, [PSI, f"{THRUSTERS}.{VALVE_DELAY}"])

    def rows_at(x: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        parts = [_rows(model, log, motion, x) for log, motion in seen]
        return [np.concatenate(each) for each in zip(*parts, strict=True)]

    for _ in range(_PASSES):
        found = Gaussian.of_rows(sizes, np.column_stack([np.diag(1 / sigma), (mean - x) / sigma]))
        # Without forces and inertia nothing is left: the noise is that with the declared forces.
        declared = rows_at(np.where(has_no_scale, x, mean))
        for rows, each in zip(rows_at(x), declared, strict=True):
            noise = _spread(each[:, [*range(10), -1]], found.marginal([PSI]))
            found = found.add(Gaussian.of_rows(sizes, rows / noise))
        x = x + found.solve(held={PSI: undetermined(model, x[:10], found)[0]})
    momenta = [
        np.zeros(3) if motion is None else _momenta(motion)[0][0] + _momenta(motion)[1][0] @ x[:10]
        for motion in motions
    ]
    places = found.places.items()
    return {table[n].key(log.name): x[place] for log in logs for n, place in places}, momenta


def seen_states(
    log: LogState, motion: SeenMotion, psi: NDArray[np.float64]
) -> dict[int, TrajectoryState]:
    """Return the states at the start of blocks as their own samples show them, by block."""
    H, by_psi = _momenta(motion)
    L, dynamics, R, w = H + by_psi @ psi, motion.dynamics, motion.R, motion.w
    com = dynamics.com(psi)
    p = motion.p + rotate(R, com)
    v = motion.v + rotate(R, np.cross(w, com) + dynamics.com_rate(psi))
    p, v = np.nan_to_num(p), np.nan_to_num(v)
    states = {}
    for k, block in enumerate(log.blocks):
        first = int(np.searchsorted(motion.time, block.start))
        if k and (first == len(motion.time) or motion.time[first] > block.end):
            continue
        back = block.start - motion.time[first]
        attitude = Rotation.from_matrix(R[first]) * Rotation.from_rotvec(back * w[first])
        bias, place = np.zeros((0, 3)), p[first] + back * v[first]
        states[k] = TrajectoryState(psi, attitude, place, v[first], L[first], bias)
    return states


def _spread(rows: NDArray[np.float64], prior: Gaussian) -> float:
    """Return the root mean square of what rows [A | b] and a prior leave of b; 1 without rows."""
    if not len(rows):
        return 1.0
    noise = float(np.sqrt(np.mean(rows[:, -1] ** 2))) + 1e-12
    for _ in range(4):
        step = prior.add(Gaussian.of_rows(prior.sizes, rows / noise)).solve()
        noise = float(np.sqrt(np.mean((rows[:, :-1] @ step - rows[:, -1]) ** 2))) + 1e-12
    return noise


def _momenta(motion: SeenMotion) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return H (M, 3) of the known bodies in W, and its derivative (M, 3, 10) by ψ."""
    dynamics, R, w = motion.dynamics, motion.R, motion.w
    known = np.einsum("nij,nj->ni", dynamics.I_K, w) + dynamics.h_K
    return rotate(R, known), R @ dynamics.regressor(w)


def _rows(
    model: Model, log: LogState, motion: SeenMotion, x: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rows [A | b] of ΔH and of ΔV about the present values x of ψ and the errors."""
    psi, dynamics, R = x[:10], motion.dynamics, motion.R
    H, by_psi = _momenta(motion)
    L, L_by = _pushed(model, log, motion, x)
    turning = _joined([by_psi - L_by[0], -L_by[1]], -(H + by_psi @ psi - L[0]))
    # V: that of B's origin, and of the centre of mass against it.
    com, rate = dynamics.com_regressor(), dynamics.com_rate_regressor()
    moved = np.cross(motion.w, dynamics.com(psi)) + dynamics.com_rate(psi)
    V_by = np.zeros((len(R), 3, 10))
    V_by[:, :, :4] = R @ (skew(motion.w) @ com + rate)
    V_by[:, :, 0] += L[1] / dynamics.mass**2
    inverse = inverse_mass(dynamics.mass, float(psi[0]))
    V = motion.v + rotate(R, moved) - inverse * L[1]
    moving = _joined([V_by, -inverse * L_by[2]], -V)
    moving = moving[np.isfinite(motion.v).all(axis=1)]
    if model.tree.normal_B is not None:
        turning, moving = turning[:, 2:], moving[:, :2]
    parts = ((rows[_LAG:] - rows[:-_LAG]).reshape(-1, len(x) + 1) for rows in (turning, moving))
    first, second = parts
    return first, second


def _joined(A: list[NDArray[np.float64]], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([*A, b[..., None]], axis=2)


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
        t[1:],
        lambda at: eye_array(len(at), format="csr"),
        lambda at: (capture.R_WC[1:], capture.p_WC[1:]),
    )
    R, com = motion.R[1:], motion.dynamics.com(x[:10])[1:]
    torques, forces = push.torques(R, com), push.forces(R)
    force = np.einsum("mv,mvi->mi", size, forces)
    by_com = np.zeros((count - 1, 3, 10))
    by_com[..., :4] = skew(force) @ R @ motion.dynamics.com_regressor()[1:]
    return (
        (_summed(np.einsum("mv,mvi->mi", size, torques)), _summed(force)),
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
