"""Public data sets of measured cloth: where they are, how to check them, and how they become recordings."""
