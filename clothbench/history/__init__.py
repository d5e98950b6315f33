"""Error and speed of every model against commit: entries, series, steps, and their page."""
