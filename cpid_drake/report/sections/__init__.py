"""The sections of reports: one module for each, with a function that returns a `page.Section`."""
