"""Techniques that identify a captured target, side by side on the same motion and noise."""
