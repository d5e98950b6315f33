"""Plugins: the hooks by which they arrive, their discovery, and the start of a new one."""

from clothbench.plugins.discovery import catalogue

__all__ = ["catalogue"]
