"""Checks by kind and name, for plugins that are installed and listed."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.plugins.discovery import KINDS, catalogue
from clothbench.testing.rules import Outcome, rule_name


def check_plugin(kind: str, name: str, *, only: Iterable[str] | None = None, **options: Any) -> tuple[Outcome, ...]:
    """Check the installed plugin `name` of a kind ("models", "effects", …), as its own check does.

    options: what that check takes besides `only`.
    """
    module = _module(kind)
    make = catalogue().load(kind, name)
    return getattr(module, f"check_{kind[:-1]}")(make, only=only, **options)


def rule_names(kind: str) -> list[str]:
    """The rules for a kind of plugin, in the order in which they are checked."""
    return [rule_name(rule) for rule in _module(kind).RULES]


def _module(kind: str):
    if kind not in KINDS:
        raise ClothbenchError(f"no kind of plugin {kind!r}; there are: {', '.join(KINDS)}")
    return importlib.import_module(f"clothbench.testing.{kind}")
