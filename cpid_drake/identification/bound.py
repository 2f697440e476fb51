"""The Cramér-Rao bound on the target's parameters."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.fit import fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.estimate import at_momentum, solution_of
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.suite import SensorSuite

_HELD = 1e-9
"""σ of a target that is held while the rest is fitted, in plausible sizes."""


def cramer_rao_bound(
    tree: KinematicTree,
    psi: NDArray[np.float64],
    measurements: Iterable[Measurements] | Measurements,
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
) -> NDArray[np.float64]:
    """Return the Cramér-Rao bound (10, 10) on the covariance of the parameters π.

    Rows and columns of parameters that the measurements do not determine are NaN. Attitude and
    position at the start, gyro bias, an unknown momentum and all errors of the joint motion are
    estimated as well. The bound holds for unbiased estimators.

    Args:
        tree: the known bodies.
        psi: (10,) relative unknowns of the target.
        measurements: ideal samples of the sensors, or a stream of them.
        sensors: the sensors' errors.
        momentum: the total momentum, marked as unknown if it is to be estimated; default: zero.
        known_bodies: uncertainty of the known bodies, which are estimated too.

    Raises:
        InputError: no attitude samples, or no motion can be predicted.

    """
    model = Model(tree, sensors, known_bodies)
    log = LogState.of(model, measurements)
    R = np.diag(1 / (_HELD * model.plausible))
    held = Gaussian.of_rows({PSI: 10}, np.column_stack([R, R @ psi]))
    found = fit(model, [log], rows=[held], values={PSI: np.asarray(psi)})
    [log], [rolled], values = found.logs, found.rolled, found.values
    log = replace(log, noise={}, weights=tuple({} for _ in log.blocks))  # as declared
    total = prior_of(model, [log], values, ()).add(sweep(model, log, rolled, values).gaussian)
    known = at_momentum(total, values, momentum or TotalMomentum.zero(), log.name)
    known = known.moved(known.solve())  # the vague prior prefers another target than the true one
    parameterization = relative_parameterization(model.mass)
    solution = solution_of(model, values, known)
    return SolvedIdentification(
        parameterization, solution, sample_count=0, estimator="trajectory_fit"
    ).covariance
