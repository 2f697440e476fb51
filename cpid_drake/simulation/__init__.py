"""A simulated identification: YAML, dataclasses, Diagram and run files."""
