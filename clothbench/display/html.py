"""Pieces of HTML that every page is made of: tables, statuses, text."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any

Rows = Sequence[dict[str, Any]]
POWER = re.compile(r"\^(-?[0-9]+)(?![0-9]|[./][0-9])")  # a whole one, in a unit as plugins state it
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def table(head: Iterable[str], body: Sequence[Sequence[str]], numeric: set[int]) -> str:
    """An HTML table; `head` is text, cells of `body` are HTML already; a line of one cell is a heading.

    Columns whose number is in `numeric` stand to the right. A line that does not fit its heading is a fault of ours.
    """
    head, kinds = list(head), {i: ' class="n"' for i in numeric}
    top = "".join(f'<th scope="col"{kinds.get(i, "")}>{text(h)}</th>' for i, h in enumerate(head))
    lines = []
    for line in body:
        if len(line) == 1:
            lines.append(f'<tr class="group"><td colspan="{len(head)}">{line[0]}</td></tr>')
        elif len(line) != len(head):
            raise ValueError(f"a table's line has {len(line)} cells below a heading of {len(head)}")
        else:
            lines.append("<tr>" + "".join(f"<td{kinds.get(i, '')}>{c}</td>" for i, c in enumerate(line)) + "</tr>")
    inside = f"<thead><tr>{top}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return f'<div class="scroll"><table>{inside}</table></div>'


def interval(row: dict[str, Any], digits: str) -> str:
    if row["low"] is None or row["high"] is None:
        return ""
    return f"{row['low']:{digits}} … {row['high']:{digits}}"


def below(small: str) -> str:
    return f"<br><small>{small}</small>" if small else ""


def pill(row: dict[str, Any]) -> str:
    """The status as a coloured word."""
    kind = {"ok": "ok", "skipped": "note", "timeout": "note"}.get(row["status"], "")
    return f'<span class="pill {kind}">{text(row["status"])}</span>'


def unit(parameter: dict[str, Any]) -> str:
    """As figures have it, powers raised: "m⁻⁴ s²" of "m^-4 s^2"; a dash where there is none."""
    stated = str(parameter["unit"])
    return "–" if stated == "1" else POWER.sub(lambda found: found[1].translate(RAISED), stated)


def group(rows: Rows, by: Callable[[dict[str, Any]], Any]) -> dict[Any, list[dict[str, Any]]]:
    out: dict[Any, list[dict[str, Any]]] = {}
    for row in rows:
        out.setdefault(by(row), []).append(row)
    return out


def text(value: Any) -> str:
    return escape(str(value)) if value is not None else ""
