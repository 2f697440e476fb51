"""From a model file to a known spacecraft, and from an estimate back to a model file."""
