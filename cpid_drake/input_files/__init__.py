"""YAML and JSON files into dataclasses, with every key, type and limit checked."""
