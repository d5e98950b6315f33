"""The study `speed`: how fast models step beside the installed peers, all in one run, after warm-up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothbench.studies.speed.cell import SUITE_WORDS as suite_words
from clothbench.studies.speed.cell import plan, refuse_settings
from clothbench.studies.speed.run import run
from clothbench.studies.speed.schema import TABLES as tables
from clothbench.studies.speed.tables import sections, show

__all__ = ["against", "claims", "name", "plan", "refuse_settings", "run", "sections", "show", "suite_words", "tables"]

name = "speed"
against = "each other"


def claims(row: Mapping[str, Any], tables: frozenset[str]) -> bool:
    return False
