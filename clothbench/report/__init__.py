"""The page over a results folder, and the gate between two of them."""
