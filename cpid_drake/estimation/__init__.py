"""Estimators in plain NumPy and SciPy, independent of Drake."""
