"""The width of 95 % intervals."""

from scipy.special import ndtri, stdtrit


def quantile_95(degrees_of_freedom: int | None = None) -> float:
    """Return half the width of a two-sided 95 % interval, in standard deviations.

    Args:
        degrees_of_freedom: degrees of freedom of the residuals from which the standard deviation is
            estimated (Student's t distribution); None or 0 if it is known (normal distribution).

    """
    if degrees_of_freedom is not None and degrees_of_freedom > 0:
        return float(stdtrit(degrees_of_freedom, 0.975))
    return float(ndtri(0.975))
