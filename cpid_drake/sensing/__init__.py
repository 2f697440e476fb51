"""Sensors: what they are, what they gave, and how samples become motion."""
