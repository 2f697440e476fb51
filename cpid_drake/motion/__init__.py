"""Joint motions: what the arms are commanded to do."""
