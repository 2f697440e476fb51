"""One target from several logs and a prior: the sum of their Gaussians, and whether they agree."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.estimation.gaussian import Gaussian, solution_of
from cpid_drake.estimation.least_squares import KNOWN, LeastSquaresSolution
from cpid_drake.estimation.likelihood.priors import (
    FASTEST_DRIFT,
    FASTEST_TUMBLE,
    plausible_psi,
    psi_scale,
)
from cpid_drake.estimation.rows_fit import TARGET
from cpid_drake.estimation.whiteness import least_white
from cpid_drake.identification.agreement import with_agreement
from cpid_drake.identification.result import Check
from cpid_drake.identification.solved import SolvedIdentification
from cpid_drake.identification.target_prior import TargetPrior

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.spacecraft.spacecraft import Spacecraft

_MOST_ROUNDS = 10  # of linearizing a prior about the joint estimate


@dataclass(frozen=True, eq=False)
class Part:
    """One log: its name in messages, its estimate alone, and its Gaussian of the target."""

    name: str
    found: SolvedIdentification
    target: Gaussian


def combined(
    spacecraft: "Spacecraft", logs: Sequence[Part], prior: TargetPrior | None = None
) -> SolvedIdentification:
    """Return the estimate of one target from all logs and the prior, and whether they agree.

    Raises:
        InputError: the prior determines combinations of other unknowns.

    """
    form = logs[0].found.parameterization
    nominal, scale = plausible(spacecraft, form)
    total = reduce(Gaussian.add, (log.target for log in logs))
    count = sum(log.found.solution.row_count for log in logs)
    found, told = _summed(logs), None
    if prior is None:
        solution = solution_of(total, nominal, scale, row_count=count)
        found = replace(found, solution=solution)
    else:
        told, solution, converged = _with_prior(prior, form, total, nominal, scale, count)
        found = replace(found, solution=solution, converged=converged)
    found = replace(
        found,
        warnings=tuple(_of_each(logs, "warnings")),
        checks=tuple(Check("one log", text) for text in _of_each(logs, "failures")),
    )
    return with_agreement(
        found,
        Gaussian({TARGET: slice(0, 10)}, np.zeros((10, 10)), np.zeros(10)),
        {log.name: log.target for log in logs},
        TARGET,
        lambda gaussian: solution_of(gaussian.marginal([TARGET]), nominal, scale),
        {log.name: (log.found.sample_count, log.found.failures) for log in logs},
        None if prior is None or told is None else (prior, told),
    )


def plausible(
    spacecraft: "Spacecraft", form: Parameterization
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a plausible target's unknowns (10,), and their plausible sizes."""
    still = np.zeros((1, len(spacecraft.joint_names)))
    known = relative_dynamics(spacecraft.tree, still, still)
    psi = plausible_psi(known.mass, known.I_K[0])
    size = psi_scale(known.mass, known.I_K[0])
    if form.name == "relative":
        return psi, size
    inertia = np.full(3, psi[4])
    x = form.from_parameters(np.concatenate([psi[:1], np.zeros(3), inertia, np.zeros(3)]))
    if form.name == "standard":
        return x, 2 * size
    # 1/m of a light target has no plausible size.
    radius = size[1] / size[0]
    return x, 1e6 * np.concatenate([[1 / known.mass], 3 * [radius], 6 * [known.mass * radius**2]])


def momentum_sigma(spacecraft: "Spacecraft") -> NDArray[np.float64]:
    """Return σ (6,) of an unknown momentum [L; P] of a spacecraft."""
    still = np.zeros((1, len(spacecraft.joint_names)))
    known = relative_dynamics(spacecraft.tree, still, still)
    turning = FASTEST_TUMBLE * float(np.trace(known.I_K[0])) / 3
    return np.repeat([turning, FASTEST_DRIFT * known.mass], 3)


def _with_prior(
    prior: TargetPrior,
    form: Parameterization,
    logs: Gaussian,
    nominal: NDArray[np.float64],
    scale: NDArray[np.float64],
    count: int,
) -> tuple[Gaussian, LeastSquaresSolution, bool]:
    """Return the prior about the joint estimate, this estimate, and whether it converged."""
    x = prior.moved(form, nominal)
    for _ in range(_MOST_ROUNDS):
        told = prior.gaussian(TARGET, form, x, scale)
        # What only the prior determines is determined, however vague the prior is.
        largest = max(KNOWN, 1.5 / float(told.singular_parts(scale)[1].min()))
        total = logs.add(told)
        solution = solution_of(total, x, scale, largest=largest, row_count=count)
        step, x = solution.values - x, solution.values
        if np.linalg.norm(total.R @ step) < 0.01:
            return told, solution, True
    return told, solution, False


def _summed(logs: Sequence[Part]) -> SolvedIdentification:
    """Return an identification with the counts of all logs; of several, without what is of one."""
    found = [log.found for log in logs]
    if len(found) == 1:
        return found[0]
    return replace(
        found[0],
        sample_count=sum(each.sample_count for each in found),
        whiteness=least_white(each.whiteness for each in found if each.whiteness),
        residuals={},
        momentum=max((each.momentum for each in found), key=("zero", "known", "unknown").index),
        misfit=1.0,
        momentum_estimate=None,
    )


def _of_each(logs: Sequence[Part], what: str) -> list[str]:
    """Return failed checks or warnings of each log, with its name unless all have the same."""
    told = [(log.name, text) for log in logs for text in getattr(log.found, what)]
    number = Counter(text for _, text in told)
    return list(
        dict.fromkeys(
            text
            if len(logs) == 1 or (what == "warnings" and number[text] == len(logs))
            else f"{name}: {text}"
            for name, text in told
        )
    )
