"""From data and a spacecraft model to a result."""
