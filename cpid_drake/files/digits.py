"""How many digits of a number are printed: those that its σ or its interval gives a meaning."""

import math


def decimals(width: float) -> int:
    """Return the number of decimals that shows an interval of this width with three digits."""
    if not (math.isfinite(width) and width > 0):
        return 6
    return min(max(2 - math.floor(math.log10(width)), 0), 11)


def decimals_of(low: float, high: float) -> int:
    """Return the number of decimals for the ends of an interval; one may be missing, NaN."""
    ends = [end for end in (low, high) if math.isfinite(end)]
    if len(ends) == 1:
        return decimals(abs(ends[0]))
    return decimals(max(ends, default=0.0) - min(ends, default=0.0))


def significant(value: float, digits: int = 2, sign: str = "") -> str:
    """Return a number with so many significant digits; without exponent from 1e-6 to 1e9.

    Args:
        value: any number.
        digits: such as 2 for 110 of 114.3, and for 0.0023 of 0.00231.
        sign: "+" to print the sign of positive numbers, too.

    """
    rounded = float(f"{value:.{digits}g}")
    if 1e-6 <= abs(rounded) < 1e-4:  # from here on, Python prints an exponent
        return f"{rounded:{sign}.{digits + 5}f}".rstrip("0")
    return f"{rounded:{sign}.9g}"


def rounded_pair(value: float, half: float) -> tuple[str, str]:
    """Return a value and the half-width of its interval, rounded to two digits of the half-width.

    Both have the same exponent, if they need one: "3.20e-06" and "0.12e-06".
    """
    if not (math.isfinite(value) and math.isfinite(half) and half > 0):
        return significant(value, 4), significant(half)
    last = int(f"{half:.1e}".partition("e")[2]) - 1
    pair = [round(each, -last) + 0.0 for each in (value, half)]
    if last >= -6:
        return f"{pair[0]:.{max(-last, 0)}f}", f"{pair[1]:.{max(-last, 0)}f}"
    power = math.floor(math.log10(max(map(abs, pair))))
    text = [f"{each / 10.0**power:.{power - last}f}e{power:+03d}" for each in pair]
    return text[0], text[1]


def with_half_width(value: float, half: float) -> str:
    """Return a value with the half-width of its interval, such as "8.495 ± 0.017"."""
    return " ± ".join(rounded_pair(value, half))
