"""The error budget: what the variance of an estimate comes from, and errors that are too large.

All unknowns besides the target are errors with a prior. If one of them were exact, the Gaussian of
all unknowns would be conditioned on it, and an entry x of the variance p of a parameter π would
lose cov(π, x)² / var(x). Shares overlap, so they do not sum to one. Of what walks this would fix
only the last value: what a kind that walks costs follows from a sweep in which it is constant, and
then conditioned on.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import FAR, quantile_95
from cpid_drake.estimation.likelihood.constants import BIAS
from cpid_drake.estimation.posterior import estimate_of
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import BODIES, MOMENTUM, PSI, Model, Unknown
from cpid_drake.files.constraints import Numbers
from cpid_drake.files.digits import significant, with_half_width
from cpid_drake.identification.checks import Check
from cpid_drake.identification.chosen_fit import ChosenFit
from cpid_drake.identification.effect_estimates import EffectEstimate, with_sensors_of
from cpid_drake.sensors.error_kinds import KINDS
from cpid_drake.sensors.sensors import Gyro
from cpid_drake.sensors.suite import SensorSuite

LEAST_SHARE = 0.01
"""Least share of a row of the budget, of any parameter."""

ALL = "all errors together"
"""Name of the row of everything that is estimated besides the target."""

_GROUPS = {
    "random walk of forces": ("acceleration", "acceleration_B"),
    "random walk of torques": ("torque", "torque_B"),
    "random walk of biases": (BIAS,),
}
"""Kinds with a random walk that look alike."""

_XYZ = ("x", "y", "z")
_STRETCHES = ("xx", "yy", "zz", "xy", "xz", "yz")


@dataclass(frozen=True, eq=False)
class BudgetRow:
    """What one error adds to the variance of an estimate.

    Attributes:
        name: of the error, in words.
        shares: (10,) share of the variance of each parameter that would go if the error were exact;
            NaN where it is not identifiable.
        unit: of the three numbers that follow; empty if they are None.
        value, sigma: the estimate and its σ; None of several errors, and of what walks.
        matters: σ to which the error must be known so that half of its share goes.

    """

    name: str
    shares: Annotated[Array, Numbers(10, unknown=True)]
    unit: str = ""
    value: float | None = None
    sigma: float | None = None
    matters: float | None = None


def error_budget(
    chosen: ChosenFit, is_known: NDArray[np.bool_], joints: Sequence[str]
) -> tuple[BudgetRow, ...]:
    """Return the budget for joints of these names, and the parameters (10,) that are known.

    The first row is that of all errors together; then, the largest shares come first.
    """
    fit = chosen.fit
    model, psi, whole = fit.model, fit.values[PSI], chosen.given(fit.posterior)
    errors = [name for name in whole.places if name != PSI]
    if not errors:
        return ()
    both = whole.marginal([PSI, *errors])
    solution, P = both.solve(), both.covariance()
    jacobian = relative_parameterization(model.mass).jacobian(psi + solution[:10])
    # var(π) = diag(J P_ψψ Jᵀ)
    total = np.diag(jacobian @ P[:10, :10] @ jacobian.T)

    def share(left: Gaussian) -> Array:
        """Return the shares that go if this is left."""
        # 1 − var(π | left) / var(π)
        own = left.marginal([PSI]).covariance()
        return np.where(is_known, 1 - np.diag(jacobian @ own @ jacobian.T) / total, np.nan)

    rows, k = list[BudgetRow](), 10
    names = [log.name for log in fit.logs]
    unknowns = model.unknowns_of(names)
    for key in errors:
        log, unknown = unknowns[key]
        walks, where = unknown.walk > 0, ""
        if unknown.hardware:
            where = with_sensors_of(unknown.hardware)
        elif unknown.scope == "log" and len(names) > 1:
            where = f" of {log}"
        for name, unit, scale in _entries(model.of_log(log), unknown, joints):
            of_target, variance = jacobian @ P[:10, k], P[k, k]
            value, sigma, prior = fit.values[key], np.sqrt(variance), unknown.sigma
            entry = k - both.places[key].start
            if not walks:
                # cov(π, x)² / (var(x) var(π)); half of it goes where 1/σ² = 1/σ_prior² + 1/σ_x²
                shares = np.where(is_known, of_target**2 / (variance * total), np.nan)
                needed = 1 / np.hypot(1 / prior[entry], 1 / sigma)
                numbers = (value[entry] + solution[k], sigma, needed)
                rows.append(
                    BudgetRow(name + where, shares, unit, *(float(scale * x) for x in numbers))
                )
            k += 1
    rows += [BudgetRow(name, share(left)) for name, left in _without_walks(chosen)]
    largest = {id(row): float(np.nanmax(row.shares, initial=0.0)) for row in rows}
    rows = [row for row in rows if largest[id(row)] >= LEAST_SHARE]
    return tuple(sorted(rows, key=lambda row: (row.name != ALL, -largest[id(row)])))


def _without_walks(chosen: ChosenFit) -> Iterator[tuple[str, Gaussian]]:
    """Yield the name of each group of errors that walk, and what is known if they were exact."""
    fit, names = chosen.fit, dict[str, set[str]]()
    if not any(log.past for log in fit.logs):  # what is behind a window cannot be swept again
        table = fit.model.unknowns_of(log.name for log in fit.logs).values()
        walking = {unknown.name for _, unknown in table if unknown.walk}
        for group, kinds in _GROUPS.items():
            if own := {name for name in walking if name.rpartition(".")[2] in kinds}:
                names[group] = own
    left = chosen.given(fit.posterior)
    for group, own in names.items():
        left = _exact(chosen, own)
        yield group, left
    if len(names) > 1:
        left = _exact(chosen, set().union(*names.values()))
    yield ALL, left.condition({name: 0.0 for name in left.places if name != PSI})


def _exact(chosen: ChosenFit, names: set[str]) -> Gaussian:
    """Return what is known if some errors that walk were exact."""
    fit, parts = chosen.fit, []
    for log, rolled in zip(fit.logs, fit.rolled, strict=True):
        walking = fit.model.of_log(log.name).walking
        keep = np.concatenate([np.full(u.size, u.name not in names) for u in walking])
        less = log.with_links(replace(link, walk=link.walk[keep]) for link in log.links)
        parts.append((less, rolled, fit.values))
    left = chosen.swept(fit.model.with_suites(partial(_steady, names=names)), fit.values, parts)
    return left.condition({name: 0.0 for name in left.places if name.partition("|")[0] in names})


def _steady(suite: SensorSuite, names: set[str]) -> SensorSuite:
    """Return sensors of which some errors do not walk."""
    steady, forces = dict[str, Any](), dict[str, Any]()
    for name in names:
        sensor, _, kind = name.rpartition(".")
        gyro = suite.present().get(sensor)
        if isinstance(gyro, Gyro):
            steady[sensor] = replace(gyro, bias_random_walk=0.0)
        elif not sensor:
            forces[f"{kind}_walk"] = 0.0
    if suite.disturbances is not None:
        steady["disturbances"] = replace(suite.disturbances, **forces)
    return replace(suite, **steady)


def _entries(
    model: Model, unknown: Unknown, joints: Sequence[str]
) -> Iterator[tuple[str, str, float]]:
    """Yield name, unit and value in this unit of one σ of each entry of an unknown."""
    if unknown.name == BODIES:
        yield from _of_bodies(model, joints)
        return
    if unknown.name == MOMENTUM:
        for k in range(6):
            name = f"momentum, {'L' if k < 3 else 'v'} {_XYZ[k % 3]}"
            yield name, "N·m·s" if k < 3 else "m/s", 1.0
        return
    error = model.constants.errors[unknown.name]
    kind = error.kind.replace("_", " ")
    owner = f" of {error.sensor}" if error.sensor else ""
    for k in range(error.size):
        place = f", {_XYZ[k]}" if error.size == 3 else f", {k + 1}" if error.size > 1 else ""
        if not KINDS[error.kind].entries:
            owner, place = f" of {joints[k]}", ""
        yield f"{kind}{owner}{place}", error.unit, error.sigma / error.scale


def _of_bodies(model: Model, joints: Sequence[str]) -> Iterator[tuple[str, str, float]]:
    """Yield the same of the errors of bodies, geometry and grasp; see `BodyUncertainty`."""
    uncertainty = model.known_bodies
    assert uncertainty is not None
    errors = list[tuple[str, str, float]]()
    for body in model.tree.bodies:
        errors.append((f"mass of {body.name}", "%", 100.0))
        errors += [(f"centre of mass of {body.name}, {axis}", "mm", 1e3) for axis in _XYZ]
        errors += [(f"inertia of {body.name}, {entry}", "%", 200.0) for entry in _STRETCHES]
    for joint in joints:
        errors += [(f"place of {joint}, {axis}", "mm", 1e3) for axis in _XYZ]
        errors += [(f"axis of {joint}, {k}", "mrad", 1e3) for k in (1, 2)]
    errors += [(f"place of the grasp, {axis}", "mm", 1e3) for axis in _XYZ]
    errors += [(f"attitude of the grasp, {axis}", "mrad", 1e3) for axis in _XYZ]
    sigmas = uncertainty.all_sigmas(model.tree.wheels, len(joints))
    for (name, unit, scale), sigma in zip(errors, sigmas, strict=True):
        if sigma > 0:
            yield name, unit, scale * float(sigma)


def size_checks(
    model: Model,
    values: Values,
    gaussian: Gaussian,
    effects: Sequence[EffectEstimate],
    joints: Sequence[str] | None,
) -> tuple[Check, ...]:
    """Return the check of errors that are beyond `FAR` of their σ; what may fail is left out.

    Args:
        model, values, gaussian: all unknowns, their values, and what is known about these values.
        effects: the constant errors.
        joints: names of the joints; None for their numbers.

    """
    sizes = {
        e.describe(): float(np.abs(e.value).max()) / e.prior_sigma
        for e in effects
        if not e.may_fail
    }
    if model.known_bodies is not None and values.get(BODIES, np.empty(0)).size:
        own, covariance = estimate_of(BODIES, values, gaussian)
        sigma = np.sqrt(np.diag(covariance))
        numbered = joints or [f"joint {k + 1}" for k in range(model.joint_count)]
        parts = zip(_of_bodies(model, numbered), own, quantile_95() * sigma, strict=True)
        (name, unit, scale), value, width = max(parts, key=lambda part: abs(part[1]))
        shown = f"{with_half_width(scale * value, scale * width)} {unit}"
        sizes[f"the {name} differs from the model by {shown}"] = float(np.abs(own).max())
    if not sizes:
        return ()
    name = max(sizes, key=lambda each: sizes[each])
    sentence = (
        f"an error is {significant(sizes[name])} times as large as its sigma: {name}; declare "
        "what the hardware can have, or look for another cause"
    )
    return (Check.of("declared sizes", sentence, sizes[name], FAR),)
