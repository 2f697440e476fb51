"""Outputs: files that are written whole, and the rule that protects files which exist already."""
