"""What cells, models and durations are called in tables and figures."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any


def model_name(row: Mapping[str, Any]) -> str:
    """The model with its effects."""
    return row["model"] + "".join(f"+{e}" for e in (row["effects"] or "").split(",") if e)


def cell_name(row: dict[str, Any]) -> str:
    """A cell in words: case, model with its effects, optimizer, objective; the seed where it is not 0."""
    model = " + ".join([row["model"], *(e for e in (row["effects"] or "").split(",") if e)])
    seed = [f"seed {row['seed']}"] if row["seed"] else []
    return " · ".join([*filter(None, (row["case"], model, row["optimizer"], row["objective"])), *seed])


def recording_of(rows: Sequence[Mapping[str, Any]]) -> Callable[[Mapping[str, Any]], Hashable]:
    """What tells the recording of a row from others: its name and its case, as the recordings of two fabrics may have
    one name. Where each of several is fitted in turn, a case bears the name of one of them, and all are the same ones.
    """
    in_turn = {(r["suite"], r["case"]) for r in rows if r["recording"] == r["case"]}
    shared = {(r["suite"], r["recording"]) for r in rows if r["recording"] and (r["suite"], r["case"]) in in_turn}

    def place(row: Mapping[str, Any]) -> Hashable:
        known = row["suite"], row["recording"]
        return known if known in shared else (*known, row["case"])

    return place


def settings_word(told: Mapping[str, Any]) -> str:
    """Settings as rows keep them, "length=1.0 friction=0.1 meshes=9,17 …": a word each."""
    return " ".join(f"{name}={_written(value)}" for name, value in told.items())


def _written(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_written, value))
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


def differing(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Of each cell, by its key, the settings in which not all of these agree: "length=0.5, friction=0.1"."""
    words = {r["key"]: (r.get("settings") or "").split() for r in rows}
    shared = set.intersection(*map(set, words.values())) if words else set()
    return {key: ", ".join(w for w in mine if w not in shared) for key, mine in words.items()}


def duration(seconds: float) -> str:
    """ "42 s", "3 min 5 s"."""
    whole = round(seconds)
    return f"{whole} s" if whole < 60 else f"{whole // 60} min {whole % 60} s"
