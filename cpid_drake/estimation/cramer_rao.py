"""The Cramér-Rao bound: how well any unbiased estimator can know a target from a motion.

It is the inverse of Fisher's information of the samples about all unknowns, at the true ones.
Source: Kay 1993, Fundamentals of Statistical Signal Processing, vol. I, ch. 3.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.parameters import determined_parameters
from cpid_drake.estimation.posterior import target_estimate
from cpid_drake.estimation.sweep import EXACT, sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.logs.log import Log
from cpid_drake.sensors.suite import SensorSuite


def cramer_rao_bound(
    tree: KinematicTree,
    psi: Array,
    measurements: Iterable[Log] | Log,
    sensors: SensorSuite,
    *,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
) -> Array:
    """Return the Cramér-Rao bound (10, 10) on the covariance of the parameters π.

    Rows and columns of parameters that the measurements do not determine are NaN. Attitude and
    position at the start, gyro bias, an unknown momentum and all errors of the joint motion are
    estimated as well. The bound holds for unbiased estimators.

    Args:
        tree: the spacecraft's bodies.
        psi: (10,) relative unknowns of the target.
        measurements: ideal samples of the sensors.
        sensors: the sensors' errors.
        momentum: the total momentum, marked as unknown if it is to be estimated; default: zero.
        known_bodies: uncertainty of the spacecraft's bodies, which are estimated too.

    Raises:
        InputError: no attitude samples, or no motion can be predicted.

    """
    logs = [measurements] if isinstance(measurements, Log) else list(measurements)
    has_thrust = any(log.has_thrust for log in logs)
    model = Model.of(tree, sensors, known_bodies, has_thrust=has_thrust)
    log = LogState.of(model, logs)
    # All unknowns besides ψ, fitted at the true ψ; the noise is as declared.
    R = np.diag(1 / (EXACT * model.plausible))
    held = Gaussian.of_rows({PSI: 10}, np.column_stack([R, R @ psi]))
    fitted = fit(replace(model, rows=(held,)), [log])
    [log], [rolled], values = fitted.logs, fitted.rolled, fitted.values
    log = log.with_processes({}).with_each(weights=({} for _ in log.blocks))
    # Information of the samples, conditioned on the momentum; without the step to where the vague
    # prior of ψ would like it to be.
    total = prior_of(model, [log], values).add(sweep(model, log, rolled, values).gaussian)
    question = Question.of(model, [log.name], momentum or TotalMomentum.zero())
    total = total.condition(question.held(values, ()))
    target = total.minus(total.solve())
    # P_π = J P_ψ Jᵀ, J = ∂π/∂ψ
    form, solution = (
        relative_parameterization(model.mass),
        target_estimate(model, values[PSI], target),
    )
    _, covariance, _ = determined_parameters(form, solution, quantile_95())
    J, P = (np.nan_to_num(x) for x in (form.jacobian(solution.estimate), solution.covariance))
    return np.where(np.isfinite(covariance), J @ P @ J.T, np.nan)
