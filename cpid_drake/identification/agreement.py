"""Whether several sources of knowledge, such as logs, priors and results, have the same target.

With a target for each source, what is known of the differences between these targets has a χ²
distribution about zero if all have the same target.
Source: Rao 1973, Linear Statistical Inference and Its Applications, ch. 4.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import improbable, quantile_95
from cpid_drake.estimation.posterior import difference
from cpid_drake.files.digits import with_half_width
from cpid_drake.identification.checks import AGREEMENT, Check
from cpid_drake.identification.result import Identification

NO_PRIOR = 1e-4
"""So small a share of the prior's inverse σ is no prior, but leaves nothing undetermined."""


@dataclass(frozen=True, eq=False)
class Sources:
    """What each source says of unknowns, of which the target is one, and what was known before.

    Attributes:
        vague: all unknowns before the samples, the target too.
        gaussians: what each source says, by its name; at least two.
        target: name of the target among the unknowns.
        plausible: (10,) plausible sizes of the target's unknowns.

    """

    vague: Gaussian
    gaussians: Mapping[str, Gaussian]
    target: str
    plausible: Array

    def others(self, name: str) -> list[str]:
        """Return the names of all sources but one."""
        return [other for other in self.gaussians if other != name]

    def together(self, *groups: Sequence[str], share: float = 1.0) -> Gaussian:
        """Return what groups of sources say, each with its own target and a share of its prior."""
        vague, target = self.vague, self.target
        total = vague.marginal(n for n in vague.places if n != target)
        own = vague.marginal([target])
        own = replace(own, R=share * own.R, z=share * own.z)
        for k, group in enumerate(groups):
            for each in (own, *(self.gaussians[name] for name in group)):
                places = {f"{n} {k}" if n == target and k else n: p for n, p in each.places.items()}
                total = total.add(replace(each, places=places))
        return total

    def difference(self, *groups: Sequence[str]) -> tuple[float, int]:
        """Return χ² of the differences between the targets of groups, and how many are known."""
        targets = [self.target, *(f"{self.target} {k}" for k in range(1, len(groups)))]
        return difference(self.together(*groups, share=NO_PRIOR), self.plausible, targets)

    def check(self, sentence: str, *groups: Sequence[str]) -> Check:
        """Return the check that groups have the same target.

        The probability of so large a χ² is put behind the sentence. Without a combination of the
        parameters in common, the check passes, and has no statistic.
        """
        chi_squared, freedom = self.difference(*groups)
        if not freedom:
            return Check(AGREEMENT, "", passed=True)
        sentence += f" (probability {max(float(chdtrc(freedom, chi_squared)), 1e-99):.1g})"
        return Check.of(AGREEMENT, sentence, chi_squared, improbable(freedom))

    def checks_of_each(self) -> dict[str, Check]:
        """Return the check of each source against all others."""
        sentence = "it differs from the others"
        return {name: self.check(sentence, [name], self.others(name)) for name in self.gaussians}


def most_different(checks: Mapping[str, Check]) -> str:
    """Return the source that differs most from the others, from the check of each."""
    return max(checks, key=lambda n: (checks[n].statistic or 0.0) / (checks[n].limit or 1.0))


def largest_difference(one: Identification, other: Identification) -> str:
    """Return the parameter in which two estimates differ most, in words; empty without any."""
    values = np.array([one.parameters, other.parameters])
    sigmas = np.sqrt([np.diag(one.covariance), np.diag(other.covariance)])
    # |π₁ − π₂| / √(var₁ + var₂)
    ratio = np.abs(values[0] - values[1]) / np.hypot(*sigmas)
    if not np.isfinite(ratio).any():
        return ""
    i, wide = int(np.nanargmax(ratio)), quantile_95() * sigmas
    return (
        f", most in {PARAMETER_NAMES[i]}: {with_half_width(values[0, i], wide[0, i])} "
        f"against {with_half_width(values[1, i], wide[1, i])}"
    )
