"""Joint motions that determine the target well: criterion, limits, search, comparison."""
