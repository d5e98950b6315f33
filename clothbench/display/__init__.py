"""Pieces of tables, pages, figures and Rerun files that every study draws with."""
