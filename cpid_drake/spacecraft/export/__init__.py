"""A target as a model file: URDF, SDF, MJCF or Drake model directives."""
