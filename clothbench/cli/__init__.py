"""The command line: one file for each command that needs more than a few lines."""

from clothbench.cli.commands import main

__all__ = ["main"]
