"""Recordings on disk: one codec, and the kinds that it reads and writes."""
