"""The present estimate of the recursive fit as an identification."""

from dataclasses import replace

from cpid_drake.estimation.recursive_fit import RecursiveFit
from cpid_drake.estimation.recursive_state import RecursiveState
from cpid_drake.identification.fit_results import identification_at, nothing_known
from cpid_drake.identification.result import Identification

MOST_DISTANT = 10.0
"""Largest distance of the best errors of the known bodies from those about which the recursive fit
is linear; see `BlockState.best_errors`."""

NOT_LINEAR = (
    "the errors of the known bodies are other ones than those about which the recursive fit is "
    "linear; use the trajectory fit"
)
"""The doubt about a recursive fit that began with wrong errors of the known bodies."""


def identification_of_state(estimator: RecursiveFit, state: RecursiveState) -> Identification:
    """Return the current estimate of the recursive fit."""
    if state.known is None:
        return nothing_known(estimator, state, "recursive_fit")
    found = identification_at(estimator, state.known, state, "recursive_fit")
    _, distance = state.known.best_errors()
    return replace(found, doubts=(NOT_LINEAR, *found.doubts)) if distance > MOST_DISTANT else found
