"""Conversion of YAML and JSON files to dataclasses, with a check of every key, type and limit."""
