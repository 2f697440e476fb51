"""A log: its samples, its files and their conventions, screening, noise and smoothing."""
