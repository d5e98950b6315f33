"""What others simulated, handed in as files, and checked here: every score is computed again from the positions."""
