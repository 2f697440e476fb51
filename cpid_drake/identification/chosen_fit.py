"""A fit with the momenta of its most probable model, and what parts of its logs say at its values.

A body that is not as declared, or a joint that slips, is taken up by the unknowns of half a log as
by those of all of it, but by others: no residual shows it, but the target of the first halves.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtri

from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import known_target
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.checks import IMPROBABLE, Check

ROUGH = 2.0
"""Factor to which residuals of rows in different units show the σ of an estimate."""

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


def halves_check(
    first: Gaussian,
    whole: Gaussian,
    cause: str,
    *,
    rests: float | None = None,
    freedom: int = 0,
) -> Check:
    """Return the check that the first half of the samples has the target of all of them.

    Of nested samples, the difference of two estimates has the difference of their covariances as
    covariance (Hausman 1978, Econometrica 46). What the rest hardly improves is left out.

    Args:
        first, whole: what is known of the target from the first half, and from all samples.
        cause: what another target means.
        rests: sum of squares of the residuals of all samples, if only they show the noise; the
            Gaussians then have errors of any size. The residuals without the difference show the
            noise, to `ROUGH` (Chow 1960, Econometrica 28).
        freedom: degrees of freedom of these residuals.

    """
    scale = np.linalg.norm(whole.R, axis=0)
    scale[scale == 0] = 1.0
    by_whole = first.R @ (np.linalg.pinv(whole.R / scale) / scale[:, None])
    U, ratio, _ = np.linalg.svd(by_whole)  # of σ after and before
    seen = ratio**2 < 0.99  # less is rounding and bends of the equations
    change = (U.T @ (first.z - first.R @ whole.solve()))[seen]
    statistic, count = float(np.sum(change**2 / (1 - ratio[seen] ** 2))), int(seen.sum())
    limit = float(chdtri(max(count, 1), IMPROBABLE))
    if rests is not None:
        left = freedom - count
        if count < 1 or left < 1:
            return Check.of("halves", "", passed=True)
        statistic *= left / max(rests - statistic, 1e-12 * rests, 1e-300)
        limit = ROUGH**2 * count * float(fdtri(count, left, 1 - IMPROBABLE))
    text = f"the first half of the samples has another target than all of them: {cause}"
    return Check.of("halves", text, statistic, limit)
