"""What the recursive fit and the trajectory fit know, as identifications."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.block_state import BlockState, solution
from cpid_drake.estimation.blocks import BlockSolver, with_bodies
from cpid_drake.estimation.least_squares import solution_of_information
from cpid_drake.estimation.recursive_fit import RecursiveFit, referred
from cpid_drake.estimation.recursive_state import RecursiveState
from cpid_drake.estimation.window_minimum import best_psi
from cpid_drake.identification.effects import (
    agreement_with_declared,
    estimated_effects,
    larger_than_declared,
    shared_errors,
)
from cpid_drake.identification.result import Identification, MomentumChanges, MomentumEstimate

MOST_BRIDGED = 3.0
"""Length of unexplained pieces above which the result has a warning [s]."""


def nothing_known(estimator: RecursiveFit, state: RecursiveState, name: str) -> Identification:
    """Return the identification before anything is known of the target; see `identification_at`."""
    prior = estimator.prior
    information = np.diag(prior.psi_sigma**-2.0) if prior.is_guess else np.zeros((10, 10))
    return Identification(
        relative_parameterization(estimator.solver.tree.mass),
        solution_of_information(prior.psi, information, prior.plausible),
        0,
        name,
        sensors=estimator.solver.suite,
        momentum_changes=MomentumChanges(*state.all_changes),
        warnings=tuple(_warnings(state)),
    )


def identification_at(
    estimator: RecursiveFit, known: BlockState, state: RecursiveState, name: str
) -> Identification:
    """Return what is known at the end of a block as an identification.

    Args:
        estimator: the recursive fit.
        known: what is known at the end of the last block.
        state: the numbers of samples and of changes of momentum.
        name: name of the estimator.

    """
    prior, solver = estimator.prior.as_wide_as(state.prior), estimator.nominal
    about = with_bodies(solver, known.errors)
    curvature = 0.0 if solver.known_bodies is None else solver.known_bodies.curvature
    _, bodies = known.estimated_errors(state.misfit, curvature)
    known = known.with_estimated_bodies(state.misfit, curvature)
    information = known.psi_information()
    if not prior.is_guess:
        information = information - np.diag(prior.psi_sigma**-2.0)
    consider = known.psi_consider() if solver.consider_count else None
    psi, shared = best_psi(known, prior), shared_errors(solver, known, bodies)
    if about is not solver:  # refer ψ to the mass of the nominal spacecraft
        by_nominal, psi = _by_referred(psi, about, solver)
        information = by_nominal.T @ information @ by_nominal
        back = np.linalg.inv(by_nominal)
        consider = None if consider is None else back @ consider @ back.T
        shared = None if shared is None else back @ shared
    found = solution_of_information(
        psi,
        information / state.misfit,
        prior.plausible,
        consider=consider,
        residual_sum=state.chi_squared,
        row_count=state.freedom,
    )
    left_out = state.all_left_out
    effects = estimated_effects(solver, known, prior.plausible, state.misfit)
    declared = agreement_with_declared(solver, known, prior.plausible, state.misfit)
    steady = tuple(each for each in effects if not solver.constants.errors[each.name].walk)
    return Identification(
        relative_parameterization(solver.tree.mass),
        found,
        sum(state.processed.get(n, 0) - left_out.get(n, 0) for n in solver.suite.present()),
        name,
        sensors=solver.suite,
        rejected=left_out,
        momentum_changes=MomentumChanges(*state.all_changes),
        warnings=tuple(_warnings(state)),
        momentum=prior.momentum.name,
        misfit=float(np.sqrt(state.misfit)),
        momentum_estimate=_momentum_of(estimator, known, state),
        unexplained=state.bridged_share(known.time),
        effects=effects,
        doubts=larger_than_declared(declared, steady),
        shared=shared,
    )


def _by_referred(
    psi: NDArray[np.float64], solver: BlockSolver, other: BlockSolver
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ∂ψ/∂ψ' (10, 10) and ψ' (10,), relative to the mass of another solver's bodies."""
    one, two = (relative_parameterization(each.tree.mass) for each in (solver, other))
    new = referred(psi, solver, other)
    return np.asarray(np.linalg.solve(one.jacobian(psi), two.jacobian(new))), new


def _momentum_of(
    estimator: RecursiveFit, known: BlockState, state: RecursiveState
) -> MomentumEstimate | None:
    """Return the estimate of an unknown L at the start, and of v_WScm if positions are measured.

    It is None if the external forces change the momentum in an unknown way, or thrusters change it.
    """
    solver, prior = estimator.solver, estimator.prior
    errors = solver.constants.errors
    is_conserved = not (state.has_thrust or any(error.walk for error in errors.values()))
    if not (prior.momentum.is_unknown and is_conserved):
        return None
    change = solution(known.root, known.rest, prior.plausible)
    inverse = np.linalg.inv(known.root)
    gain = inverse @ known.by_bodies
    covariance = state.misfit * inverse @ inverse.T + gain @ gain.T
    L, v = solver.places["L"], solver.places["v_Wcm"]
    places = np.r_[L, v] if "position" in solver.suite.present() else np.r_[L]
    conserved = np.arange(len(places))
    if solver.tree.normal_B is not None:  # on a table
        conserved = np.array([2, 3, 4][: len(places) // 2])
    at_start = np.eye(len(known.root))
    value = {"L": known.nominal.L, "v_Wcm": known.nominal.v_Wcm}
    for force, name in (("torque", "L"), ("acceleration", "v_Wcm")):
        nominal = solver.constants.value(known.nominal.constants, force)
        if nominal is not None:
            elapsed = known.time - state.start
            share = elapsed * errors[force].sigma
            at_start[solver.places[name], solver.places[force]] = -share * np.eye(3)
            value[name] = value[name] - elapsed * nominal
    by = at_start[places[conserved]]
    both = np.concatenate([value["L"], value["v_Wcm"]])[conserved]
    return MomentumEstimate(both + by @ change, by @ covariance @ by.T)


def _warnings(state: RecursiveState) -> Iterator[str]:
    if state.unfinished:
        until = "nothing is known yet"
        if state.known is not None:
            until = f"the estimate is that of the samples up to {state.known.time:.4g} s"
        times = "once" if state.unfinished == 1 else f"{state.unfinished} times"
        yield (
            f"{times}, the fit of all samples so far needed more work than one update may do, and "
            f"was given up: {until}"
        )
    if state.misfit > 1:
        yield (
            f"the fit misses the samples by {np.sqrt(state.misfit):.2g} times the sensors' noise: "
            "the noise is larger than given, the momentum is not zero, or the spacecraft differs "
            "from its model; the intervals are wider by that factor, which may not be enough"
        )
    changes, last = state.all_changes
    if changes:
        times = "once" if changes == 1 else f"{changes} times"
        yield (
            f"the momentum changed {times}, last at {last:.3f} s; it was estimated "
            "again from then on"
        )
    if state.bridged_time > MOST_BRIDGED:
        yield (
            f"nothing explains {state.bridged_time:.3g} s of the log, whose samples of the base "
            "were not used: forces acted, a sensor failed, or the spacecraft differs from its model"
        )
