"""Rigid-body dynamics in plain NumPy: inertia, kinematics, momentum and momentum rows."""
