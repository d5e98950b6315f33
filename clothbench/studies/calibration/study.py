"""The study `calibration`: parameters fitted to recordings, judged on others, with what is asked of the fits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from clothbench.studies.calibration.page import sections
from clothbench.studies.calibration.plan import plan, refuse_settings
from clothbench.studies.calibration.run import run
from clothbench.studies.calibration.schema import TABLES as tables
from clothbench.studies.calibration.settings import SUITE_WORDS as suite_words
from clothbench.studies.calibration.tables import show

__all__ = ["against", "claims", "name", "plan", "refuse_settings", "run", "sections", "show", "suite_words", "tables"]

name = "calibration"
against = "recordings"


def claims(row: Mapping[str, Any], tables: frozenset[str]) -> bool:
    return row["optimizer"] is not None and "fold" not in tables
