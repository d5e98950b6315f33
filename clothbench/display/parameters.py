"""The page's table of fitted parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite
from typing import Any

from clothbench.display.html import below, group, interval, table, text, unit
from clothbench.display.names import model_name

Rows = Sequence[dict[str, Any]]


def parameters(rows: Rows, fitted: Rows) -> str:
    """One table per model: a line per cell, a column for every parameter that one of its cells has, headed by its name
    where another one has the same symbol; then what the symbols mean.
    """
    keys = {r["key"] for r in rows}
    cells = group([p for p in fitted if p["key"] in keys], lambda p: p["key"])
    about = {r["key"]: r for r in rows if r["key"] in cells}
    if not cells:
        return '<p class="soft">Nothing was fitted.</p>'
    out: list[str] = []
    meanings: dict[tuple[str, str, str, str], None] = {}  # each once, in order
    for model, mine in sorted(group(list(about.values()), model_name).items()):
        lines = sorted(mine, key=lambda r: (r["case"], r["optimizer"], r["seed"], r["key"]))
        columns = {p["name"]: p for r in lines for p in cells[r["key"]]}
        body = [_line(r, {p["name"]: p for p in cells[r["key"]]}, list(columns)) for r in lines]
        symbols = Counter(p["symbol"] for p in columns.values())
        heads = (p["symbol"] if symbols[p["symbol"]] == 1 else p["name"] for p in columns.values())
        named = (f"{head} [{unit(p)}]" for head, p in zip(heads, columns.values(), strict=True))
        head = ["case", "optimizer", "seed", *named, "cell"]
        out.append(f"<h3>{text(model)}</h3>" + table(head, body, numeric=set(range(2, len(head) - 1))))
        meanings.update({(p["symbol"], p["name"], unit(p), p["meaning"]): None for p in columns.values()})
    terms = (
        f"<dt>{text(symbol)}</dt><dd>{text(name)} [{text(measured)}]: {text(meaning)}</dd>"
        for symbol, name, measured, meaning in meanings
    )
    return "".join(out) + f"<dl>{''.join(terms)}</dl>"


def _line(row: dict[str, Any], values: dict[str, dict[str, Any]], columns: Sequence[str]) -> list[str]:
    """One cell; where it has no such parameter there is a dash."""
    names = [text(row["case"]), text(row["optimizer"]), text(row["seed"])]
    found = [fitted_value(values[name]) if name in values else "–" for name in columns]
    return [*names, *found, f"<code>{text(row['key'][:8])}</code>"]


def condition_said(found: Sequence[float]) -> str:
    """How freely the parameters of one fit, or of several, move together; "" where no condition is known."""
    if not found:
        return ""
    ends = [f"{end:.2g}" if isfinite(end) else "infinite" for end in (min(found), max(found))]
    fits = "fits" if len(found) > 1 else "fit"
    return (
        f"Condition of the {fits}: {' … '.join(dict.fromkeys(ends))}; above a thousand some of the parameters move "
        "together freely."
    )


def fitted_value(p: dict[str, Any]) -> str:
    """Value above its interval, in a table; marked on its bound, where the bound chose it and not the data."""
    value = f"{p['value']:.4g}" if p["value"] is not None else "none"
    mark = '<span class="pill note" title="the bound chose this value">▲ at its bound</span> ' if p["at_bound"] else ""
    truth = f"true: {p['truth']:.3g}" if p.get("truth") is not None else ""
    return mark + value + below(interval(p, ".3g")) + below(truth)
