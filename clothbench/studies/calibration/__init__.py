"""Parameters fitted to recordings, and what is asked of such a fit."""
