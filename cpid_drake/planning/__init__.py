"""Joint motions that determine the target well: criteria, limits, search."""
