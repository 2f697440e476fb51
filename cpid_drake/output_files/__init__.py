"""Outputs: figures, files that are written whole, and the rule that protects existing files."""
