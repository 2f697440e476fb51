"""The estimate of one parameter."""

from dataclasses import dataclass
from math import isfinite

from cpid_drake.files.digits import decimals_of, significant, with_half_width


@dataclass(frozen=True, repr=False)
class ParameterEstimate:
    """The estimate of one of the ten parameters, rounded to its interval where it is printed.

    Attributes:
        name: such as "m", "cx" or "Ixx".
        value: the estimate; NaN if it is not identifiable.
        sigma: its σ; NaN if it is not identifiable.
        interval: ends of the 95 % interval, as far as a rigid body can have it. A parameter that is
            not identifiable may have bounds; an end without a bound is NaN.
        unit: of all numbers.
        checks_passed: whether no check of the identification failed; else do not use the estimate.

    """

    name: str
    value: float
    sigma: float
    interval: tuple[float, float]
    unit: str
    checks_passed: bool

    def __repr__(self) -> str:
        unit, spread = f" {self.unit}", self.shown_interval()
        parts = [
            f"{self.name} "
            + (f"= {self.shown()}{unit}" if self.is_identifiable else "not identifiable")
        ]
        if isfinite(self.sigma):
            parts.append(f"σ {significant(self.sigma)}{unit}")
        if spread:
            parts.append((f"95 % in {spread}" if spread.startswith("[") else spread) + unit)
        return ", ".join(parts) + ("" if self.checks_passed else "; a check failed")

    @property
    def is_identifiable(self) -> bool:
        """Whether the samples determine the parameter."""
        return isfinite(self.value)

    @property
    def decimals(self) -> int:
        """Number of decimals that the interval gives a meaning; a single bound has three digits."""
        return decimals_of(*self.interval)

    def shown(self) -> str:
        """Return the estimate, or that it is not identifiable."""
        return f"{self.value:.{self.decimals}f}" if self.is_identifiable else "not identifiable"

    def shown_interval(self) -> str:
        """Return the interval in words: both ends, one bound, or nothing."""
        low, high = (f"{x:.{self.decimals}f}" if isfinite(x) else "" for x in self.interval)
        if low and high:
            return f"[{low}, {high}]"
        return f"above {low}" if low else f"below {high}" if high else ""

    def in_words(self) -> str:
        """Return the estimate with its interval and unit, such as "8.495 ± 0.017 kg"."""
        (low, high), spread = self.interval, self.shown_interval()
        half = (high - low) / 2
        if self.is_identifiable and abs((high + low) / 2 - self.value) <= 0.05 * half:
            return f"{with_half_width(self.value, half)} {self.unit}"
        shown = ", ".join(filter(None, (self.shown(), spread)))
        return f"{shown} {self.unit}" if self.is_identifiable or spread else shown
