"""From data and a known spacecraft to a result."""
