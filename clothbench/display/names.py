"""What cells, models and durations are called in tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def model_name(row: Mapping[str, Any]) -> str:
    """The model with its effects."""
    return row["model"] + "".join(f"+{e}" for e in (row["effects"] or "").split(",") if e)


def cell_name(row: dict[str, Any]) -> str:
    """A cell in words: case, model with its effects, optimizer, objective; the seed where it is not 0."""
    model = " + ".join([row["model"], *(e for e in (row["effects"] or "").split(",") if e)])
    seed = [f"seed {row['seed']}"] if row["seed"] else []
    return " · ".join([*filter(None, (row["case"], model, row["optimizer"], row["objective"])), *seed])


def duration(seconds: float) -> str:
    """ "42 s", "3 min 5 s"."""
    whole = round(seconds)
    return f"{whole} s" if whole < 60 else f"{whole // 60} min {whole % 60} s"
