"""Where a fit starts: linear least squares on the conservation of angular momentum.

At about ten instants of every block, R_WB (J ω + h) = L about the system's centre of mass is linear
in the target's ψ and in the L of each log; ω comes from the gyro or, without one, from the
attitude. A log with thrust has further rows, and other ones: see `thrust_start`.
Source: Ning et al. 2016, Eqs. 6 and 9, in the relative form (design, 3.2).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.plane import NORMAL_W, tilt
from cpid_drake.dynamics.rotations import exponentials
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block, first_sample
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.thrust_start import SeenMotion, balanced_with_thrust, seen_states
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model, undetermined
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import ANGULAR_VELOCITY, ATTITUDE, POSITION, Quantity, sensors_of

_INSTANTS = 10  # in a block
_DEGREE = 5  # of the polynomials through the samples of a block
_FEWEST = 4  # samples of a block for a polynomial
_REWEIGHTINGS = 4  # the noise of the rows comes from their own residuals


def start_of(
    model: Model, logs: Sequence[LogState], values: Values | None = None
) -> tuple[Values, list[LogState]]:
    """Return values of all unknowns, and the logs with a start.

    A log with thrust is open at the ends of its blocks: what is not yet known of the thrust adds
    up, and each block starts where its own samples show.

    Args:
        model: the unknowns.
        logs: the logs.
        values: given values of unknowns of the hardware and of the target; default: their means.

    """
    given = values or {}
    values = model.start([log.name for log in logs]) | given
    motions = [_motion(model, log) for log in logs]
    psi, momenta = _balanced(model, logs, motions)
    if any(log.has_thrust for log in logs):
        pushed, momenta = balanced_with_thrust(model, logs, motions)
        psi = pushed.pop(PSI)
        values = values | pushed | given
    psi = given.get(PSI, psi)
    if not all(_is_possible(model, log, psi) for log in logs):
        psi = model.start([""])[PSI]
    started = []
    for log, L, motion in zip(logs, momenta, motions, strict=True):
        if log.has_thrust and motion is not None:
            states = seen_states(log, motion, psi)
            state = replace(states[0], bias=log.bias[0])
            values[f"{MOMENTUM}|{log.name}"] = np.concatenate([state.L, state.v_Wcm])
            log = replace(log, start=state, aims=states)
            started.append(log.opened(model, [k - 1 for k in states if k]))
            continue
        block, joints = log.blocks[0], log.joints[0].evaluate(np.array([log.blocks[0].start]))
        dynamics = BodyDynamics.at(model.tree, joints[:, 0], joints[:, 1])
        inverse = dynamics.mobility(psi)[0]
        first = first_sample(block.samples, ATTITUDE)
        assert first is not None
        time, q_WB = first
        attitude = Rotation.from_quat(q_WB, scalar_first=True)
        w = inverse @ (attitude.inv().apply(L) - dynamics.momentum_at_rest(psi)[0])
        attitude = attitude * Rotation.from_rotvec(-(time - block.start) * w)
        normal_B = model.tree.normal_B
        if normal_B is not None:
            q_WB = attitude.as_quat(scalar_first=True)
            attitude = Rotation.from_rotvec(tilt(q_WB[None], normal_B)[0]) * attitude
            L = L * NORMAL_W
        place = first_sample(block.samples, POSITION)
        com = attitude.apply(dynamics.com(psi)[0]) + (0.0 if place is None else place[1])
        state = TrajectoryState(psi, attitude, com, np.zeros(3), L, log.bias[0])
        started.append(replace(log, start=state))
        values[f"{MOMENTUM}|{log.name}"] = np.concatenate([L, np.zeros(3)])
    return values | {PSI: psi}, started


def _is_possible(model: Model, log: LogState, psi: NDArray[np.float64]) -> bool:
    """Return whether the system can turn about every axis all the time."""
    joints = [
        part.evaluate(np.linspace(block.start, block.end, _INSTANTS))
        for block, part in zip(log.blocks, log.joints, strict=True)
    ]
    q = np.concatenate(joints)
    try:
        BodyDynamics.at(model.tree, q[:, 0], q[:, 1]).mobility(psi)
    except InputError:
        return False
    return True


def _balanced(
    model: Model, logs: Sequence[LogState], motions: Sequence[SeenMotion | None]
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Return ψ (10,) and L (3,) of each log, from all rows and the vague prior."""
    parts = [_rows(model, motion) for motion in motions]
    n = 10 + 3 * len(logs)
    A = np.zeros((sum(map(len, parts)), n + 1))
    first = 0
    for k, rows in enumerate(parts):
        block = A[first : first + len(rows)]
        block[:, :10], block[:, 10 + 3 * k : 13 + 3 * k] = rows[:, :10], rows[:, 10:13]
        block[:, -1] = rows[:, 13]
        first += len(rows)
    target = model.unknown(PSI)
    sizes = {PSI: 10} | {log.name: 3 for log in logs}
    sigma = np.concatenate([target.sigma, np.full(3 * len(logs), model.L_sigma)])
    mean = np.concatenate([target.mean, np.zeros(3 * len(logs))])
    prior = Gaussian.of_rows(sizes, np.column_stack([np.diag(1 / sigma), np.zeros(n)]))
    A[:, -1] -= A[:, :-1] @ mean
    noise, found = 0.02 * float(np.std(A[:, -1])) + 1e-12 if len(A) else 1.0, prior
    for _ in range(_REWEIGHTINGS if len(A) else 0):
        found = prior.add(Gaussian.of_rows(sizes, A / noise))
        rms = float(np.sqrt(np.mean((A[:, :-1] @ found.solve() - A[:, -1]) ** 2)))
        noise = max(rms, 1e-9 * model.L_sigma)
    x = mean + found.solve(held={PSI: undetermined(model, target.mean, found)[0]})
    return x[:10], np.split(x[10:], len(logs))


def _rows(model: Model, motion: SeenMotion | None) -> NDArray[np.float64]:
    """Return rows [Y | −Rᵀ | right side] (M, 14) about ψ and L of a log."""
    if motion is None:
        return np.empty((0, 14))
    dynamics, w, Rt = motion.dynamics, motion.w, np.swapaxes(motion.R, 1, 2)
    known = np.einsum("nij,nj->ni", dynamics.I_K, w) + dynamics.h_K
    A = np.concatenate([dynamics.regressor(w), -Rt, -known[..., None]], axis=2)
    if model.tree.normal_B is not None:
        A = np.einsum("i,nij->nj", model.tree.normal_B, A)
    return np.asarray(A.reshape(-1, 14))


def _motion(model: Model, log: LogState) -> SeenMotion | None:
    """Return what the samples of a log show of its motion; None if they show nothing."""
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
        return None
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
    place, cheb = _longest(block, POSITION), np.polynomial.chebyshev
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
    gyro, attitude = _longest(block, ANGULAR_VELOCITY), _longest(block, ATTITUDE)

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


def _longest(block: Block, quantity: Quantity) -> Samples | None:
    """Return the samples of the sensor of a quantity with most of them; None if they are few."""
    samples = [block.samples[sensor.name] for sensor in sensors_of(quantity)]
    best = max(samples, key=len, default=None)
    return best if best is not None and len(best) >= _FEWEST else None
