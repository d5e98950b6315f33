"""Settings to cells to results: what runs every study and knows none of them by name."""
