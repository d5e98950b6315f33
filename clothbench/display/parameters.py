"""The page's table of fitted parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothbench.display.html import below, group, interval, table, text, unit
from clothbench.display.names import model_name

Rows = Sequence[dict[str, Any]]


def parameters(rows: Rows, fitted: Rows) -> str:
    """One table per model: a line per cell, a column for every parameter that one of its cells has; then what the
    symbols mean.
    """
    keys = {r["key"] for r in rows}
    cells = group([p for p in fitted if p["key"] in keys], lambda p: p["key"])
    about = {r["key"]: r for r in rows if r["key"] in cells}
    if not cells:
        return '<p class="soft">Nothing was fitted.</p>'
    out, meanings = [], {}
    for model, mine in sorted(group(list(about.values()), model_name).items()):
        lines = sorted(mine, key=lambda r: (r["case"], r["optimizer"], r["seed"], r["key"]))
        columns = {p["name"]: p for r in lines for p in cells[r["key"]]}
        body = [_line(r, {p["name"]: p for p in cells[r["key"]]}, list(columns)) for r in lines]
        head = ["case", "optimizer", "seed", *(f"{p['symbol']} [{unit(p)}]" for p in columns.values()), "cell"]
        out.append(f"<h3>{text(model)}</h3>" + table(head, body, numeric=set(range(2, len(head) - 1))))
        meanings.update({p["symbol"]: p for p in columns.values()})
    terms = (
        f"<dt>{text(s)}</dt><dd>{text(p['name'])} [{text(unit(p))}]: {text(p['meaning'])}</dd>"
        for s, p in meanings.items()
    )
    return "".join(out) + f"<dl>{''.join(terms)}</dl>"


def _line(row: dict[str, Any], values: dict[str, dict[str, Any]], columns: Sequence[str]) -> list[str]:
    """One cell; where it has no such parameter there is a dash."""
    names = [text(row["case"]), text(row["optimizer"]), text(row["seed"])]
    found = [_parameter(values[name]) if name in values else "–" for name in columns]
    return [*names, *found, f"<code>{text(row['key'][:8])}</code>"]


def _parameter(p: dict[str, Any]) -> str:
    """Value above its interval; marked on its bound, where the bound chose it and not the data."""
    value = f"{p['value']:.4g}" if p["value"] is not None else "none"
    mark = '<span class="pill note" title="the bound chose this value">▲ at its bound</span> ' if p["at_bound"] else ""
    truth = f"true: {p['truth']:.3g}" if p.get("truth") is not None else ""
    return mark + value + below(interval(p, ".3g")) + below(truth)
