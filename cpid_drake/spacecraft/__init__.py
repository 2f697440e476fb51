"""From a model file to a spacecraft, and from an estimate back to a model file."""
