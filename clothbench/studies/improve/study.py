"""The study `improve`: what a calibrated model lacks, found, added, and judged on recordings held out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothbench.studies.improve.page import sections
from clothbench.studies.improve.plan import SUITE_WORDS as suite_words
from clothbench.studies.improve.plan import plan, refuse_settings
from clothbench.studies.improve.run import run
from clothbench.studies.improve.schema import IMPROVE_TABLES as tables
from clothbench.studies.improve.terminal import show

__all__ = ["against", "claims", "name", "plan", "refuse_settings", "run", "sections", "show", "suite_words", "tables"]

name = "improve"
against = "what they lack"


def claims(row: Mapping[str, Any], tables: frozenset[str]) -> bool:
    return False
