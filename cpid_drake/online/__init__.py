"""Identification of samples as they arrive."""
