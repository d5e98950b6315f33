"""The study `mechanics`: models in scenes whose answer is known, mesh by mesh; nothing is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothbench.studies.mechanics.cell import SUITE_WORDS as suite_words
from clothbench.studies.mechanics.cell import plan, refuse_settings
from clothbench.studies.mechanics.page import sections
from clothbench.studies.mechanics.run import run
from clothbench.studies.mechanics.schema import TABLES as tables
from clothbench.studies.mechanics.tables import show

__all__ = ["against", "claims", "name", "plan", "refuse_settings", "run", "sections", "show", "suite_words", "tables"]

name = "mechanics"
against = "mechanics"


def claims(row: Mapping[str, Any], tables: frozenset[str]) -> bool:
    return row["optimizer"] is None
