"""What cells of one model, optimizer and metric were set otherwise, in words: read from what each of them was asked."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from clothbench.display.html import group
from clothbench.display.names import model_name
from clothbench.engine.study import Results
from clothbench.studies.calibration.schema import QUESTION

LONGEST = 60  # characters beyond which a digest is easier to read than all that differs
BY_NAME = ("bounds", "scene", "fixed", "start", "finer")  # of what a cell is told; beside the options of its plugins
SINGLE = ("tracker", "timeout", "choice")
Told = Mapping[str, Any]


def with_settings(results: Results) -> Results:
    """The results, whose rows say as "told" how their cell is set otherwise than its rivals: "ga.population 4", and ""
    where nothing differs but what has a word of its own.

    Rows of cells whose question was not kept, or that differ in more than can be read, have no such word, and keep to
    the digest of the column "settings".
    """
    out: dict[str, str] = {}
    kinds = group(results.rows, lambda r: (r["suite"], model_name(r), r["optimizer"], r["objective"]))
    for rows in kinds.values():
        cells = {r["key"]: (r["case"], r.get("budget"), r.get("settings")) for r in rows}
        first = {about: key for key, about in reversed(cells.items())}  # one of several that are set alike
        words = _words(results, first)
        out |= {key: words[first[about]] for key, about in cells.items() if words}
    return replace(results, rows=[{**r, "told": out[r["key"]]} if r["key"] in out else r for r in results.rows])


def _words(results: Results, cells: Mapping[tuple[Any, ...], str]) -> dict[str, str]:
    """What to say of each cell, by key; nothing at all where it cannot be said of every one. cells: by case, budget and
    settings, which are compared in one case, since a fabric may have bounds of its own.
    """
    cases: dict[str, list[str]] = {}
    for (case, *_), key in cells.items():
        cases.setdefault(case, []).append(key)
    if all(len(keys) == 1 for keys in cases.values()):
        return dict.fromkeys(cells.values(), "")
    asked = {
        row["key"]: _settings(row["question"]) for row in results.store.table("question", cells.values(), QUESTION)
    }
    if not asked.keys() >= set(cells.values()):
        return {}
    names = sorted(set().union(*(_differing(asked[key] for key in keys) for keys in cases.values())))
    words = {key: ", ".join(f"{name} {_said(mine.get(name), name)}" for name in names) for key, mine in asked.items()}
    several = {(case, budget, words[key]) for (case, budget, _), key in cells.items()}
    readable = max(map(len, words.values())) <= LONGEST and len(several) == len(cells)
    return words if readable else {}


def _settings(question: str) -> Told:
    """All that a cell was told of how it is run, by a name that a user would write; nothing of what is no question."""
    try:
        cell = json.loads(question)
        used = {cell["model"], cell["optimizer"], cell["metric"], cell["tracker"], *cell["effects"], *cell["report"]}
        out = {f"{of}.{name}": v for of, told in cell["options"].items() if of in used for name, v in told.items()}
        out |= {f"{of}.{name}": v for of in BY_NAME for name, v in (cell.get(of) or {}).items()}
        return out | {name: cell.get(name) for name in SINGLE}
    except (ValueError, LookupError, TypeError, AttributeError):
        return {}


def _differing(cells: Iterable[Told]) -> set[str]:
    known = list(cells)
    names = {name for told in known for name in told}
    return {n for n in names if len({json.dumps(told.get(n), sort_keys=True) for told in known}) > 1}


def _said(value: Any, name: str = "") -> str:
    """ "4", "6, 4", "0 … 0.001" of bounds, "as it is" of what was not told."""
    if value is None:
        return "as it is"
    if isinstance(value, list):
        return (" … " if name.startswith("bounds.") else ", ").join(map(_said, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
