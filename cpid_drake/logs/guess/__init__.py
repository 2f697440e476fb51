"""Guesses the map of a log's columns: names, values, joints, then units and conventions."""
