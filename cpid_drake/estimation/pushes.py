"""What logged thrust has added since the first of some instants, to first order in the target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import eye_array

from cpid_drake.dynamics.kinematics import propagate
from cpid_drake.dynamics.relative_motion import RelativeDynamics
from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.estimation.likelihood.actuators import ThrustLog, thrust_log
from cpid_drake.estimation.likelihood.thrust import Push
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensing.measurements import THRUST, Samples


@dataclass(frozen=True, eq=False)
class Pushed:
    """What thrust has added, in W, at M instants.

    Attributes:
        L: (M, 3) angular momentum if the centre of mass were that of ψ = 0.
        L_by_psi: (M, 3, 10) its derivative by ψ.
        S: (M, 3) double integral of the force [N·s²].

    """

    L: NDArray[np.float64]
    L_by_psi: NDArray[np.float64]
    S: NDArray[np.float64]


def pushes(
    model: Model,
    log: LogState,
    times: NDArray[np.float64],
    R_WB: NDArray[np.float64],
    q: NDArray[np.float64],
    dynamics: RelativeDynamics,
) -> Pushed | None:
    """Return what the declared thrust has added since the first of M instants; None without any.

    Args:
        model, log: the log of thrust, and what its values mean.
        times: (M,) [s].
        R_WB: (M, 3, 3) attitudes.
        q: (M, J) joint positions.
        dynamics: the known bodies at these instants.

    """
    parts = [block.samples.thrust for block in log.blocks if THRUST in block.samples.samples]
    if not any(part.value.any() for part in parts):
        return None
    time, first = np.unique(np.concatenate([part.time for part in parts]), return_index=True)
    samples = Samples(time, np.concatenate([part.value for part in parts])[first])
    nominal = np.zeros(model.constants.size)
    given = thrust_log(samples, model.suite.thrusters, model.constants, nominal)
    assert given is not None
    impulses = np.diff(_integral(given, times), axis=0)  # (M − 1, V)
    still = np.zeros((len(q), 3))
    capture = propagate(model.tree, Telemetry.seen_from_base(q, np.zeros_like(q), still, still))[1]
    push = Push(
        given.actuators,
        times[1:],
        lambda at: eye_array(len(at), format="csr"),
        lambda at: (capture.R_WC[1:], capture.p_WC[1:]),
    )
    R, com = R_WB[1:], dynamics.com(np.zeros(10))[1:]
    force = np.einsum("mv,mvi->mi", impulses, push.forces(R))
    by_com = skew(force) @ R @ dynamics.com_regressor()[1:]
    L = np.einsum("mv,mvi->mi", impulses, push.torques(R, com))
    by_psi = np.concatenate([by_com, np.zeros((len(R), 3, 6))], axis=2)
    step = np.diff(times)[:, None]
    before = np.cumsum(force, axis=0) - force
    S = np.cumsum(step * (before + force / 2), axis=0)
    return Pushed(*(_from_zero(each) for each in (np.cumsum(L, 0), np.cumsum(by_psi, 0), S)))


def _integral(log: ThrustLog, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the integrals (M, V) of the actuators' forces from their first sample to times."""
    time, value = log.samples.time, log.samples.value
    whole = np.cumsum(np.diff(time)[:, None] * value[:-1], axis=0)
    whole = np.concatenate([np.zeros((1, value.shape[1])), whole])
    k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, None)
    return np.asarray(whole[k] + np.maximum(times - time[k], 0.0)[:, None] * value[k])


def _from_zero(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([np.zeros_like(values[:1]), values])
