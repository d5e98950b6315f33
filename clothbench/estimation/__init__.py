"""Trials, searches and intervals: what every study that fits something shares."""
