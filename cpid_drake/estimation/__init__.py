"""Estimators in plain NumPy and SciPy; they know nothing of Drake."""
