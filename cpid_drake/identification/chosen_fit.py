"""A fit with the momenta of its most probable model, and what parts of its logs say at its values.

A body that is not as declared, or a joint that slips, is taken up by the unknowns of half a log as
by those of all of it, but by others: no residual shows it, but the target of the first halves.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.evidence import NAMED, ModelComparison, Question
from cpid_drake.estimation.fit import Fit, prior_of
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import improbable
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import difference, target_estimate, without
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.identification.checks import Check

ROUGH = 2.0
"""Factor to which residuals of rows in different units show the σ of an estimate."""

_BENDS = 0.1
"""What the rest hardly improves, to this share, is rounding and bends of the equations."""

_CAUSE = "a joint or the grasp slips, or a body, a clock or a force is not as modelled"


@dataclass(frozen=True, eq=False)
class ChosenFit:
    """A fit, and the momenta that its most probable model holds.

    Attributes:
        fit: the fit.
        question: what is asked about the momenta of its logs.
        compared: the comparison of momenta that are not as supposed. Its Gaussian is of all
            unknowns but these momenta about the fit's values, with the doubts about them.
        held: values of unknowns that are held, less those of the fit.
        probability: that the momentum of a log is not as given, or not zero, by log.

    """

    fit: Fit
    question: Question
    compared: ModelComparison
    held: Values
    probability: dict[str, float]

    @classmethod
    def of(cls, fit: Fit, question: Question) -> "ChosenFit":
        """Return a fit with what is held of all that is asked."""
        compared, probability = question.answer(fit.posterior, fit.values), {}
        for log in fit.logs:
            key = fit.model.unknown(MOMENTUM).key(log.name)
            probability[log.name] = compared.probability.get(key, 0.0)
        return cls(fit, question, compared, question.held(fit.values, compared.best), probability)

    @property
    def momentum(self) -> str:
        """The total momentum that is assumed; see `momentum_name`."""
        is_named = any(each >= NAMED for each in self.probability.values())
        return "unknown" if is_named else momentum_name(self.question)

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
        first = target_estimate(fit.model, psi, beginning).determined
        whole = self.given(fit.posterior).marginal([PSI]).minus(-psi)
        return (halves_check(first, whole, fit.model.sizes(psi), _CAUSE),)

    def _values_at(self, log: LogState, k: int) -> Values:
        """Return the values at the end of the first k blocks of a log."""
        values, later = dict(self.fit.values), sum(link.walk for link in log.links[k:])
        for unknown in self.fit.model.of_log(log.name).walking:
            step, later = np.split(later, [unknown.size])
            values[unknown.key(log.name)] = values[unknown.key(log.name)] - step
        return values


def momentum_name(question: Question) -> str:
    """Return the total momentum that is assumed before a fit: "zero", "unknown" or "known"."""
    if not question.supposed:
        return "unknown"
    return "known" if any(value.any() for value in question.supposed.values()) else "zero"


def halves_check(
    first: Gaussian, whole: Gaussian, plausible: Array, cause: str, freedom: int | None = None
) -> Check:
    """Return the check that the first half of the samples has the target of all of them.

    Of nested samples, that is the target of the rest (Hausman 1978, Econometrica 46).

    Args:
        first, whole: what is known of the target from the first half, and from all samples.
        plausible: (n,) sizes of the target's unknowns.
        cause: what another target means.
        freedom: degrees of freedom of the residuals, if only they show the noise. The residuals
            without the difference show it, to `ROUGH` (Chow 1960, Econometrica 28).

    """
    # χ² = (ψ₁ − ψ₂)ᵀ (P₁ + P₂)⁻¹ (ψ₁ − ψ₂), with P₂⁻¹ = P⁻¹ − P₁⁻¹ of the rest of the samples
    rest = without(first, whole, _BENDS)
    named = [
        replace(each, places={k: slice(0, len(plausible))})
        for k, each in {"first": first, "rest": rest}.items()
    ]
    statistic, count = difference(named[0].add(named[1]), plausible, ["first", "rest"])
    limit = improbable(max(count, 1))
    if freedom is not None:
        left = freedom - count
        if count < 1 or left < 1:
            return Check.of("halves", "", passed=True)
        # F of k differences, with n degrees of freedom: k F = χ²_d (n − k) / (χ² − χ²_d), χ² = n
        statistic *= left / max(freedom - statistic, 1e-12 * freedom)
        limit = ROUGH**2 * improbable(count, left)
    text = f"the first half of the samples has another target than all of them: {cause}"
    return Check.of("halves", text, statistic, limit)
