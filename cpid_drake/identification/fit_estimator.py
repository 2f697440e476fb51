"""The trajectory fit and the recursive fit as estimators."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.estimation.block_state import BlockState
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.recursive_fit import RecursiveFit
from cpid_drake.estimation.recursive_state import RecursiveState
from cpid_drake.estimation.trajectory_fit import (
    Residuals,
    fit_trajectory,
    pass_about,
)
from cpid_drake.estimation.whiteness import least_white, whiteness
from cpid_drake.identification.fit_results import identification_at, nothing_known
from cpid_drake.identification.fit_setup import estimator_of
from cpid_drake.identification.problem import LARGEST_NOISE, MOST_UNEXPLAINED, Estimator, Problem
from cpid_drake.identification.result import (
    Identification,
    ResidualSeries,
)
from cpid_drake.identification.seen_noise import (
    SeenNoise,
    residual_factors,
    with_larger_noise,
    with_seen_noise,
)
from cpid_drake.sensing.sensors import SENSORS

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    pass

NOT_CONVERGED = "the trajectory fit did not converge: its result is not the best fit"
"""The warning if the fit stopped before it converged."""

MOST_DISTANT = 10.0
"""Largest distance of the best errors of the known bodies from those about which the recursive fit
is linear; see `BlockState.best_errors`."""

NOT_LINEAR = (
    "the errors of the known bodies are other ones than those about which the recursive fit is "
    "linear; use the trajectory fit"
)
"""The doubt about a recursive fit that began with wrong errors of the known bodies."""

NOT_STARTED = (
    "the target was not known well enough before the end to solve the blocks one after the other; "
    "the result is a fit of all samples together"
)
"""The warning of the recursive fit if it ends with a fit of its window."""


def estimate_by_fit(problem: Problem) -> Identification:
    """Fit the target to all samples of the sensors by maximum likelihood.

    Raises:
        InputError: too few samples.

    """
    seen = with_seen_noise(problem)
    problem = seen.problem
    estimator = estimator_of(problem, seen.sensors)
    fit = fit_trajectory(estimator, problem.stream)
    if fit.known is None:
        return nothing_known(estimator, fit.recursive, TRAJECTORY_FIT.name)
    warnings = list(seen.warnings)
    if not fit.converged:
        warnings.append(NOT_CONVERGED)
    found = _of_residuals(estimator, fit.known, fit.recursive, fit.residuals)
    if not problem.known_bodies:
        found = _repeated(seen, found, fit.known.nominal)
    return replace(
        found,
        converged=fit.converged,
        warnings=(*warnings, *found.warnings),
        doubts=(*seen.doubts, *found.doubts),
    )


def _repeated(seen: SeenNoise, found: Identification, about: TrajectoryState) -> Identification:
    """Return the fit with the noise that its residuals show, if they show more than assumed."""
    tests = {name: whiteness(series.neighbours) for name, series in found.residuals.items()}
    factors = residual_factors(tests)
    if not factors:
        return found
    if found.misfit > LARGEST_NOISE or found.unexplained > MOST_UNEXPLAINED:
        return _widened(found)  # no noise, and the gate doubts it
    again = with_larger_noise(seen.problem, seen.sensors, factors)
    estimator = estimator_of(again.problem, again.sensors)
    changes = found.momentum_changes
    has_faults = bool(changes is not None and changes.count) or bool(found.rejected)
    try:
        if has_faults:  # with larger noise there may be none
            fit = fit_trajectory(estimator, again.problem.stream)
            if fit.known is None or not fit.converged:
                return _widened(found)
            known, state = fit.known, fit.recursive
        else:
            known, state = pass_about(
                estimator, again.problem.stream, about.psi, Residuals(), 1.0, about.constants
            )
    except (InputError, np.linalg.LinAlgError):
        return _widened(found)
    repeated = identification_at(estimator, known, state, TRAJECTORY_FIT.name)
    parts = [f"the {SENSORS[name].label} {factor:.2g} times" for name, factor in factors.items()]
    text = (
        f"residuals are larger than the noise, or correlated from sample to sample "
        f"({found.whiteness.lag_one if found.whiteness else 0:+.2f}): {', '.join(parts)} the given "
        "σ was assumed, which makes the intervals wider"
    )
    return replace(
        found,
        solution=repeated.solution,
        momentum_changes=repeated.momentum_changes,
        momentum_estimate=repeated.momentum_estimate,
        warnings=(*(repeated if has_faults else found).warnings, text),
    )


def fit_about(problem: Problem, psi: NDArray[np.float64], misfit: float) -> Identification:
    """Return what the samples tell about a target near ψ, in the form of an identification.

    All blocks are linearized about ψ, as those of the other logs of the same target.

    Args:
        problem: the problem, with the sensors.
        psi: (10,) relative unknowns of the target.
        misfit: size of the residuals relative to the assumed noise.

    Raises:
        InputError: too few samples.

    """
    seen = with_seen_noise(problem)
    estimator, residuals = estimator_of(seen.problem, seen.sensors), Residuals()
    known, state = pass_about(estimator, problem.stream, psi, residuals, misfit**2)
    about = known.nominal.constants
    if not estimator.solver.constants.agree(np.zeros_like(about), about):
        residuals = Residuals()
        known, state = pass_about(estimator, problem.stream, psi, residuals, misfit**2, about)
    found = _of_residuals(estimator, known, state, residuals)
    return found if problem.known_bodies else _widened(found)


def _of_residuals(
    estimator: RecursiveFit,
    known: BlockState,
    state: RecursiveState,
    residuals: Residuals,
) -> Identification:
    """Return the identification of a trajectory fit with its residuals."""
    series = {}
    for name, selection in residuals.selections.items():
        kept, every = selection.samples(), selection.every
        if kept is not None:
            beginning = residuals.beginning(name) if every > 1 else None
            series[name] = ResidualSeries(kept.time, kept.value, "σ", every, beginning)
    found = identification_at(estimator, known, state, TRAJECTORY_FIT.name)
    white = least_white(whiteness(rest.neighbours) for rest in series.values())
    return replace(found, residuals=series, whiteness=white)


def estimate_recursively(problem: Problem) -> Identification:
    """Run the recursive fit over all samples, in order of time.

    Raises:
        InputError: too few samples.

    """
    seen = with_seen_noise(problem)
    problem = seen.problem
    estimator = estimator_of(problem, seen.sensors)
    state = estimator.run(problem.stream)
    found = identification_of_state(estimator, state)
    warnings = [*seen.warnings, *found.warnings]
    if state.initializing:
        warnings.append(NOT_STARTED)
    found = replace(
        found,
        whiteness=least_white(sums.whiteness for sums in state.lags.values()),
        warnings=tuple(warnings),
        doubts=(*seen.doubts, *found.doubts),
    )
    # Errors of the known bodies cause correlated residuals, and are in the covariance already.
    return found if problem.known_bodies else _widened(found)


def _widened(found: Identification) -> Identification:
    """Return the identification with wider intervals if residuals are correlated in time.

    Residuals that are much smaller than the assumed noise do not matter.
    """
    white = found.whiteness
    if white is None or white.is_white or white.is_negligible:
        return found
    text = f"residuals are correlated from sample to sample ({white.lag_one:+.2f})"
    if white.correlation_time > 1.05:
        text += (
            f"; the intervals are wider by a factor of {np.sqrt(white.correlation_time):.2g}, as "
            f"if {white.correlation_time:.2g} samples were one"
        )
    wider = replace(found.solution, covariance=white.correlation_time * found.solution.covariance)
    return replace(found, solution=wider, warnings=(*found.warnings, text))


def identification_of_state(estimator: RecursiveFit, state: RecursiveState) -> Identification:
    """Return the current estimate of the recursive fit."""
    if state.known is None:
        return nothing_known(estimator, state, RECURSIVE_FIT.name)
    found = identification_at(estimator, state.known, state, RECURSIVE_FIT.name)
    _, distance = state.known.best_errors()
    return replace(found, doubts=(NOT_LINEAR, *found.doubts)) if distance > MOST_DISTANT else found


def needs_of_fit(family: RowFamily | None, momentum: TotalMomentum) -> tuple[tuple[str, ...], ...]:
    """Return the sensors that the fit needs: at least one sensor of each entry."""
    return (("encoders",), ("attitude",))


RECURSIVE_FIT = Estimator(
    name="recursive_fit",
    label="recursive fit (maximum likelihood, online)",
    good_for="an estimate online from noisy sensors; finds firings of thrusters",
    estimate=estimate_recursively,
    needs=needs_of_fit,
    estimate_about=fit_about,
    streams=True,
    uses_added_sensors=True,
    uses_thrust=True,
    estimates_errors=True,
    uses_known_bodies=True,
    reports=8,
)

TRAJECTORY_FIT = Estimator(
    name="trajectory_fit",
    label="trajectory fit (maximum likelihood)",
    good_for="the best estimate from noisy sensors, after the motion; finds firings of thrusters",
    estimate=estimate_by_fit,
    needs=needs_of_fit,
    estimate_about=fit_about,
    streams=True,
    prefers_sensors=True,
    uses_added_sensors=True,
    uses_thrust=True,
    estimates_errors=True,
    uses_known_bodies=True,
)
