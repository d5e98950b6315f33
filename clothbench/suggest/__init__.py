"""Suggestions: which next experiment would tell most about what the recordings leave open."""
