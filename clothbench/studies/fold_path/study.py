"""The study `fold_path`: cloth folded in half along a gripper's path, computed or geometric."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothbench.studies.fold_path.cell import SUITE_WORDS as suite_words
from clothbench.studies.fold_path.cell import plan, refuse_settings
from clothbench.studies.fold_path.page import sections
from clothbench.studies.fold_path.run import run
from clothbench.studies.fold_path.schema import TABLES as tables
from clothbench.studies.fold_path.tables import show

__all__ = ["against", "claims", "name", "plan", "refuse_settings", "run", "sections", "show", "suite_words", "tables"]

name = "fold_path"
against = "a desk with friction"


def claims(row: Mapping[str, Any], tables: frozenset[str]) -> bool:
    return False
