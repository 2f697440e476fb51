"""Whole reports: which sections, in which order."""
