"""The page's parameters: intervals on their axes, a line for each fit and a column for each parameter of its model."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothbench.display.html import group, table, text
from clothbench.display.names import model_name
from clothbench.display.parameters import condition_said
from clothbench.display.section import Section
from clothbench.display.templates import rendered
from clothbench.engine.study import Results
from clothbench.studies.calibration.estimates import Estimate, estimates
from clothbench.studies.calibration.ranking import way_of
from clothbench.studies.calibration.words import headed, listed, size

Rows = Sequence[dict[str, Any]]
Called = Callable[[dict[str, Any]], str]
NARROW = 1.5  # %, of the axis, below which an interval is drawn as wide as that, to be seen at all


@dataclass(frozen=True)
class Strip:
    """One estimate on its axis, places in %. kind: "sure", "outside" (determined, without the truth in it) or "grey";
    value, interval, truth: as text; said: all of it in words.
    """

    kind: str
    left: float
    width: float
    dot: float
    mark: float | None
    value: str
    interval: str
    truth: str
    sort: float | None
    said: str


def parameter_section(results: Results) -> Section:
    """A table of strips for each suite and model, then all numbers as they are."""
    found = group_by_key(estimates(results.table("parameters")))
    parts = []
    for suite, rows in sorted(group(results.rows, lambda r: r["suite"]).items()):
        mine = [r for r in {r["key"]: r for r in rows}.values() if r["key"] in found]
        named = called(rows)
        models = [
            model_table(model, some, found, named) for model, some in sorted(group(mine, model_name).items())
        ]  # fmt: skip
        sums = [e for r in mine for e in found[r["key"]]]
        parts.append(
            rendered(
                Path(__file__).parent, "parameters.html", title=headed(results.rows)(suite, "parameters"),
                models=models, truth=truth_said(sums, mine, named), numbers=numbers(mine, found, named),
                count=len(sums),
            )
        )  # fmt: skip
    return Section("".join(parts))


def group_by_key(found: Sequence[Estimate]) -> dict[str, list[Estimate]]:
    out: dict[str, list[Estimate]] = {}
    for one in found:
        out.setdefault(one.key, []).append(one)
    return out


def called(rows: Rows) -> Called:
    """What a fit is called in its model's table: its case, and what else tells it from others."""
    way, seeds = way_of(rows), len({r["seed"] for r in rows}) > 1

    def name(row: dict[str, Any]) -> str:
        _, _, more = way(row).partition(" · ")
        return " · ".join(filter(None, (row["case"], more, f"seed {row['seed']}" if seeds else "")))

    return name


def model_table(model: str, rows: Rows, found: dict[str, list[Estimate]], named: Called) -> dict[str, Any]:
    """Heads and lines of one model; a fit that lacks a parameter has an empty place below its heading. A column has one
    axis, over the ranges of all its fits.
    """
    every = [e for r in rows for e in found[r["key"]]]
    columns = [on_widest([e for e in every if e.name == name]) for name in dict.fromkeys(e.name for e in every)]
    axes = {c.name: c for c in columns}
    sure = {c.name: [e.determined for r in rows for e in found[r["key"]] if e.name == c.name] for c in columns}
    lines = []
    for row in sorted(rows, key=named):
        mine = {e.name: strip_of(e, axes[e.name]) for e in found[row["key"]]}
        lines.append((named(row), row["key"][:8], [mine.get(c.name) for c in columns]))
    heads = [
        {"one": c, "unit": "" if c.unit == "1" else c.unit, "lower": size(c.lower), "upper": size(c.upper),
         "sure": sum(sure[c.name]), "of": len(sure[c.name])} for c in columns
    ]  # fmt: skip
    conditions = [found[r["key"]][0].condition for r in rows]
    said = condition_said([c for c in conditions if c is not None])
    return {"model": model, "heads": heads, "lines": lines, "condition": said}


def on_widest(some: Sequence[Estimate]) -> Estimate:
    """The last of some estimates of a parameter, on an axis over all ranges that were searched: fabrics differ."""
    ends = [end for e in some for end in (e.lower, e.upper) if end is not None]
    if not ends:
        return some[-1]
    log = min(ends) > 0 and any(e.log for e in some)
    return dataclasses.replace(some[-1], lower=min(ends), upper=max(ends), log=log)


def strip_of(e: Estimate, axis: Estimate | None = None) -> Strip | None:
    """An estimate as it is drawn, on its own axis or another's; None where it has no value or no axis."""
    axis = axis or e
    if e.value is None or axis.lower is None or axis.upper is None:
        return None
    low, high = (100 * axis.place(e.value if end is None else end) for end in (e.low, e.high))
    widened = max(NARROW - (high - low), 0.0) / 2
    kind = "grey" if not e.determined else "outside" if e.found is False else "sure"
    interval = "" if e.low is None or e.high is None else f"{size(e.low)} … {size(e.high)}"
    truth = "" if e.truth is None else size(e.truth)
    said = f"{e.name} {size(e.value)} {e.unit if e.unit != '1' else ''}, interval {interval or 'not known'}"
    said += f", true {truth}" if truth else ""
    said += f"; not determined: {e.why_not}" if e.why_not else ""
    return Strip(
        kind, round(max(low - widened, 0.0), 1), round(min(high - low + 2 * widened, 100.0), 1),
        round(100 * axis.place(e.value), 1), None if e.truth is None else round(100 * axis.place(e.truth), 1),
        size(e.value), interval, truth, e.value, said,
    )  # fmt: skip


def truth_said(found: Sequence[Estimate], rows: Rows, named: Called) -> str:
    """How many determined intervals hold the truth, and which do not; nothing where no truth is known."""
    judged = [e for e in found if e.found is not None]
    if not judged:
        return ""
    name = {r["key"]: named(r) for r in rows}
    outside = [f"{e.name} of {name[e.key]}" for e in judged if not e.found]
    said = (
        f"The truth is known: {len(judged) - len(outside)} of {len(judged)} intervals of determined parameters hold it"
    )
    return said + (f", not those of {listed(outside, 8)}." if outside else ".")


def numbers(rows: Rows, found: dict[str, list[Estimate]], named: Called) -> str:
    """Every estimate as a line of plain numbers, to be sorted and taken along."""
    head = ["fit", "model", "parameter", "symbol", "unit", "value", "low", "high", "searched from", "to", "truth",
            "condition of the fit", "not determined", "meaning"]  # fmt: skip
    body = [
        [text(named(r)), text(model_name(r)), text(e.name), text(e.symbol), text(e.unit),
         *(exact(v) for v in (e.value, e.low, e.high, e.lower, e.upper, e.truth, e.condition)), text(e.why_not),
         text(e.meaning)]
        for r in rows for e in found[r["key"]]
    ]  # fmt: skip
    return table(head, body, numeric=set(range(5, 12)))


def exact(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
