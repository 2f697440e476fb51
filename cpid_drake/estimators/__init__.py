"""Estimators: plain NumPy and SciPy on rows A x = b; they know nothing of Drake."""
