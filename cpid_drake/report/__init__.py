"""HTML reports, figures, tables, replays and the live view."""
