"""Sensors: their errors, their samples, smoothing of samples to motion, telemetry files."""
