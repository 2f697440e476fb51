"""Joint motions that determine the target well: criteria, limits, search."""

HIGHEST_FREQUENCY = 0.4
"""Default of the highest frequency of a planned motion [Hz]."""
