"""The kinds of study, a room each: its cells, how one is run, its tables, and its sections of the page."""
