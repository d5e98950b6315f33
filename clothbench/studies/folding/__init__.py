"""A strip lifted off a desk step by step, its stiffness estimated on the way."""
