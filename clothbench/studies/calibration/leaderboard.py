"""The page's leaderboard of each suite, and the errors of single recordings behind it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothbench.display.html import below, group, interval, pill, table, text
from clothbench.display.names import model_name

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


def error(row: dict[str, Any] | None, best: bool = False) -> str:
    """ "3.68 mm", below it the interval; a status where there is no number."""
    if row is None or row["value"] is None:
        return "–" if row is None else pill(row)
    value = f"{row['value']:.2f} {text(row['unit'])}"
    return (f"<b>{value}</b>" if best else value) + below(interval(row, ".2f"))


def floor(row: dict[str, Any]) -> str:
    return f"{row['floor']:.2f} {text(row['unit'])}" if row["floor"] is not None else ""
