"""Drake LeafSystems: thin wrappers of the NumPy code, with all state in the Context."""
