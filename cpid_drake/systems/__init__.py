"""Drake LeafSystems: thin shells on the NumPy code, with all state in the Context."""
