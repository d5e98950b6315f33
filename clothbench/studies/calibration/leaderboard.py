"""The page's tables of fits: the leaderboard of each suite, and the fitted parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothbench.display.html import below, group, pill, table, text, unit
from clothbench.display.plotly import model_name

Rows = Sequence[dict[str, Any]]
SPLITS = ("fit", "held_out")


def leaderboard(rows: Rows) -> str:
    """Per case and metric, the cells from the lowest held-out error up; then single recordings, folded."""
    head = [
        "model",
        "optimizer",
        "seed",
        "fit error",
        "held-out error",
        "noise floor",
        "effort",
        "status",
        "cell",
    ]
    body: list[list[str]] = []
    for (case, metric), mine in sorted(group(rows, lambda r: (r["case"], r["metric"] or "")).items()):
        body.append([f"{text(case)} · {text(metric)}"])
        cells = sorted(group(mine, lambda r: r["key"]).values(), key=_rank)
        body += [_cell_row(cell, best=n == 0 and len(cells) > 1) for n, cell in enumerate(cells)]
    return table(head, body, numeric={2, 3, 4, 5, 6}) + single_recordings([r for r in rows if r["recording"]])


def _cell_row(cell: Rows, best: bool) -> list[str]:
    row = cell[0]
    totals = {r["split"]: r for r in cell if not r["recording"]}
    floors = [r for r in totals.values() if r["floor"] is not None]
    worst = next((r for r in cell if r["status"] != "ok"), row)
    names = [text(model_name(row)), text(row["optimizer"]), text(row["seed"])]
    errors = [error(totals.get(split), best) for split in SPLITS]
    effort = f"{row['evaluations']} evaluations" + below(f"{row['wall_s'] or 0.0:.1f} s")
    status = pill(worst) + below(text(worst["reason"]))
    return [
        *names,
        *errors,
        floor(floors[-1]) if floors else "",
        effort,
        status,
        f"<code>{text(row['key'][:8])}</code>",
    ]


def _rank(cell: Rows) -> tuple[bool, float, str]:
    """Sort key of one cell's rows: held-out error, else fit error, else last."""
    totals = {r["split"]: r["value"] for r in cell if not r["recording"]}
    value = totals.get("held_out", totals.get("fit"))
    return value is None, value or 0.0, cell[0]["key"]


def single_recordings(rows: Rows) -> str:
    """The errors that the means are made of, folded away."""
    if not rows:
        return ""
    body = []
    for r in rows:
        names = [
            r["case"],
            r["metric"],
            model_name(r),
            r["optimizer"],
            r["recording"],
            (r["split"] or "").replace("_", " "),
        ]
        body.append([*map(text, names), error(r), floor(r), pill(r)])
    head = ["case", "metric", "model", "optimizer", "recording", "split", "error", "noise floor", "status"]
    shown = table(head, body, numeric={6, 7})
    return f"<details><summary>{len(rows)} errors of single recordings</summary>{shown}</details>"


def parameters(rows: Rows, fitted: Rows) -> str:
    """One table per model: a line per cell, a column per parameter; then what the symbols mean."""
    keys = {r["key"] for r in rows}
    cells = group([p for p in fitted if p["key"] in keys], lambda p: p["key"])
    about = {r["key"]: r for r in rows if r["key"] in cells}
    if not cells:
        return '<p class="soft">Nothing was fitted.</p>'
    out, meanings = [], {}
    for model, mine in sorted(group(list(about.values()), model_name).items()):
        first = cells[mine[0]["key"]]
        head = [f"{p['symbol']} [{unit(p)}]" for p in first]
        lines = sorted(mine, key=lambda r: (r["case"], r["optimizer"], r["seed"], r["key"]))
        body = [_parameter_row(r, cells[r["key"]]) for r in lines]
        head = ["case", "optimizer", "seed", *head, "cell"]
        out.append(f"<h3>{text(model)}</h3>" + table(head, body, numeric=set(range(2, len(head) - 1))))
        meanings.update({p["symbol"]: p for p in first})
    terms = (
        f"<dt>{text(s)}</dt><dd>{text(p['name'])} [{text(unit(p))}]: {text(p['meaning'])}</dd>"
        for s, p in meanings.items()
    )
    return "".join(out) + f"<dl>{''.join(terms)}</dl>"


def _parameter_row(row: dict[str, Any], values: Rows) -> list[str]:
    names = [text(row["case"]), text(row["optimizer"]), text(row["seed"])]
    return [*names, *map(_parameter, values), f"<code>{text(row['key'][:8])}</code>"]


def _parameter(p: dict[str, Any]) -> str:
    """Value above its interval; marked on its bound, where the bound chose it and not the data."""
    value = f"{p['value']:.4g}" if p["value"] is not None else "none"
    mark = '<span class="pill note" title="the bound chose this value">▲ at its bound</span> ' if p["at_bound"] else ""
    truth = f"true: {p['truth']:.3g}" if p.get("truth") is not None else ""
    return mark + value + below(interval(p, ".3g")) + below(truth)


def error(row: dict[str, Any] | None, best: bool = False) -> str:
    """ "3.68 mm", below it the interval; a status where there is no number."""
    if row is None or row["value"] is None:
        return "–" if row is None else pill(row)
    value = f"{row['value']:.2f} {text(row['unit'])}"
    return (f"<b>{value}</b>" if best else value) + below(interval(row, ".2f"))


def floor(row: dict[str, Any]) -> str:
    return f"{row['floor']:.2f} {text(row['unit'])}" if row["floor"] is not None else ""


def interval(row: dict[str, Any], digits: str) -> str:
    if row["low"] is None or row["high"] is None:
        return ""
    return f"{row['low']:{digits}} … {row['high']:{digits}}"
