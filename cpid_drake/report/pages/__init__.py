"""Complete reports: the sections that they contain, and their order."""
