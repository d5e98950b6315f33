"""The study `folding`: a strip lifted step by step, its stiffness estimated on the way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothbench.studies.folding.cell import SUITE_WORDS as suite_words
from clothbench.studies.folding.cell import plan, refuse_settings
from clothbench.studies.folding.page import sections
from clothbench.studies.folding.run import run
from clothbench.studies.folding.schema import TABLES as tables
from clothbench.studies.folding.tables import show

__all__ = ["against", "claims", "name", "plan", "refuse_settings", "run", "sections", "show", "suite_words", "tables"]

name = "folding"
against = "recordings"


def claims(row: Mapping[str, Any], tables: frozenset[str]) -> bool:
    return "fold" in tables
