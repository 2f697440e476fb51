"""A fit with the momenta of its most probable model, and what parts of its logs say at its values.

A body that is not as declared, or a joint that slips, is taken up by the unknowns of half a log as
by those of all of it, but by others: no residual shows it, but the target of the first halves.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.checks import Check, halves_check

_CAUSE = "a joint or the grasp slips, or a body, a clock or a force is not as modelled"


@dataclass(frozen=True, eq=False)
class ChosenFit:
    """A fit, and the momenta that its most probable model holds.

    Attributes:
        fit: the fit.
        held: values of unknowns that are held, less those of the fit.

    """

    fit: Fit
    held: Values

    def given(self, gaussian: Gaussian) -> Gaussian:
        """Return a distribution of unknowns about the fit's values, with those that are held."""
        return gaussian.condition({n: v for n, v in self.held.items() if n in gaussian.places})

    def swept(
        self, model: Model, values: Values, parts: Iterable[tuple[LogState, Rolled, Values]]
    ) -> Gaussian:
        """Return what priors and parts of logs, each at its own values, say with what is held."""
        total = prior_of(model, self.fit.logs, values)
        for part in parts:
            total = total.add(sweep(model, *part, forward_only=True).gaussian)
        return self.given(total)

    def part_checks(self) -> tuple[Check, ...]:
        """Return the check of the first halves of all logs; none if a log is too short."""
        fit, ends = self.fit, []
        for log in fit.logs:
            middle = (log.blocks[0].start + log.blocks[-1].end) / 2
            ends.append(sum(block.end <= middle for block in log.blocks))
            if not 0 < ends[-1] < len(log.blocks):
                return ()
        halves = (
            (log.part(0, k), rolled.part(0, k), self._values_at(log, k))
            for log, rolled, k in zip(fit.logs, fit.rolled, ends, strict=True)
        )
        psi, beginning = fit.values[PSI], self.swept(fit.model, fit.values, halves)
        first = known_target(fit.model, psi, beginning).known
        whole = self.given(fit.gaussian).marginal([PSI]).moved(-psi)
        return (halves_check(first, whole, _CAUSE),)

    def _values_at(self, log: LogState, k: int) -> Values:
        """Return the values at the end of the first k blocks of a log."""
        values, later = dict(self.fit.values), np.sum(log.walks[k:], axis=0)
        for unknown in self.fit.model.of_log(log.name).walking:
            step, later = np.split(later, [unknown.size])
            values[unknown.key(log.name)] = values[unknown.key(log.name)] - step
        return values
