"""What `identify` says about a log, compared with the truth."""

import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake import InputError, Log, Spacecraft, identify

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Answer:
    """Exit code of `cpid identify`, what is said, errors in σ, NEES of its rank, σ of the mass."""

    code: int
    said: str
    nees: float = np.nan
    rank: int = 0
    in_sigma: Array = field(default_factory=lambda: np.full(10, np.nan))
    inside: float = np.nan
    sigma: float = np.nan
    seconds: float = 0.0
    converged: bool = False

    @property
    def worst(self) -> float:
        """Largest error of a known parameter in σ; zero without one."""
        return float(np.nanmax(np.abs(np.append(self.in_sigma, 0.0))))

    def __str__(self) -> str:
        return (
            f"exit {self.code}, NEES {self.nees:.1f} of {self.rank}, worst {self.worst:.2f} σ, "
            f"σ(m) {self.sigma:.3g} kg, {self.seconds:.0f} s; {self.said[:200]}"
        )


def answer(spacecraft: Spacecraft, log: Log, truth: Array, **options) -> Answer:
    """Identify a log with options of `identify`, and compare with the target's parameters (10,)."""
    start = time.perf_counter()
    try:
        found = identify(spacecraft, log, **options)
    except InputError as error:
        return Answer(2, str(error), seconds=time.perf_counter() - start)
    code = 4 if found.failures else 0 if found.is_complete else 3
    said = {0: "", 3: found.not_identifiable, 4: "; ".join(found.failures)}[code]
    sigma = np.sqrt(np.diag(found.covariance))
    in_sigma = (found.parameters - truth) / sigma
    known = np.isfinite(in_sigma)
    inside = (found.intervals[:, 0] <= truth) & (truth <= found.intervals[:, 1])
    share = inside[known].mean() if known.any() else np.nan
    made = Answer(code, said, np.nan, found.rank, in_sigma, share, sigma[0])
    if found.combinations is not None and found.form is not None:
        miss = found.combinations.values - found.form.from_parameters(truth)
        made = replace(made, nees=float(miss @ found.combinations.information @ miss))
    return replace(made, seconds=time.perf_counter() - start, converged=found.converged)
