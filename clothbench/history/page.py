"""The page of a history: one self-contained HTML file; works offline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clothbench.core.files import whole_file
from clothbench.display.answer import Card, answer
from clothbench.display.html import table, text
from clothbench.display.names import model_name
from clothbench.display.page import whole_page
from clothbench.display.plotly import COLOURS, GREY, LEGEND, rounded
from clothbench.display.section import Section, drawing, later
from clothbench.history.entries import Entry
from clothbench.history.series import Series
from clothbench.history.show import changes_of, conclusion, interval, share, value

METHOD = """<p class="soft">A change is a step of a series' level that noise alone would bring about in one series of a
hundred (PELT with a quantile of χ² as its penalty where the intervals of the values say the noise, of F where their
scatter does, which few values tell badly; whichever noise is more) and that is more than 5&nbsp;%; or a number that was
lost, or came back. Speeds are compared within one machine, from six entries of it on. A line without an interval stands
for numbers that have none.</p>"""
DASHES = ("solid", "dash", "dot", "dashdot")


def write_page(path: Path, entries: Sequence[Entry], series: Sequence[Series]) -> Path:
    """Write the page, whole or not at all; returns its path."""
    with whole_file(path, asked=True) as part:
        part.write_text(page_html(entries, series), encoding="utf-8")
    return path


def page_html(entries: Sequence[Entry], series: Sequence[Series]) -> str:
    suites = ", ".join(sorted({one.about["suite"] for one in series}))
    first, last = entries[0], entries[-1]
    span = f"{first.date[:10]} to {last.date[:10]}, {text(first.short)} to {text(last.short)}"
    top = f"<h1>History: {text(suites)}</h1><p class='soft'>{text(len(entries))} entries, {span}</p>"
    sections = [
        Section(top + _answer(entries, series)),
        Section(f"<h2>What changed</h2>{METHOD}{_changes(entries, series)}"),
        *(_figures(entries, series, kind) for kind in ("error", "speed")),
        Section(f"<h2>Where every series stands</h2>{later(_standing(series))}"),
        Section(f"<h2>Entries</h2>{_entries(entries)}"),
    ]
    return whole_page(text(f"history of {suites}"), sections)


def _answer(entries: Sequence[Entry], series: Sequence[Series]) -> str:
    changes = changes_of(series)
    worse = [(one, c) for one, c in changes if c.verdict == "worse"]
    better = [(one, c) for one, c in changes if c.verdict == "better"]
    cards = [
        _card("for the worse", entries, worse, good=False if worse else None),
        _card("for the better", entries, better, good=True if better else None),
        Card("machines", str(len({e.machine for e in entries if e.machine})), "whose speeds can be told"),
    ]
    return answer("Did anything change?", text(conclusion(entries, series)) + ".", cards)


def _card(title: str, entries: Sequence[Entry], changes: Sequence[Any], good: bool | None) -> Card:
    if not changes:
        return Card(title, "0", "no change beyond the noise")
    one, change = changes[0]
    said = f"the last at {entries[change.entry].short}: {one.label} {share(change) or change.reason}"
    return Card(title, str(len(changes)), said, good)


def _changes(entries: Sequence[Entry], series: Sequence[Series]) -> str:
    """A line for each change, below a heading for each entry."""
    body, above = [], None
    for one, change in changes_of(series):
        entry, half = entries[change.entry], change.half
        if change.entry != above:
            body.append([f"<code>{text(entry.short)}</code> {text(entry.date[:10])} {text(entry.subject)}"])
            above = change.entry
        colour = "" if change.verdict == "worse" else " ok"
        body.append([
            f'<span class="pill{colour}">{text(change.verdict)}</span>', text(one.kind), text(one.label),
            text(value(change.before, one.unit)), text(value(change.after, one.unit) or change.reason),
            text(share(change)), text("" if half is None else f"± {half:.2g}"),
        ])  # fmt: skip
    if not body:
        return "<p>Nothing changed beyond the noise.</p>"
    head = ["verdict", "kind", "series", "before", "after", "change", "95 % interval"]
    return table(head, body, numeric={3, 4, 5, 6})


def _standing(series: Sequence[Series]) -> str:
    body = [
        [
            text(one.kind), text(one.label), text(one.about.get("machine") or ""), text(len(one.points)),
            text(value(one.points[0].value, one.unit)),
            text(value(one.points[-1].value, one.unit) or one.points[-1].reason), text(interval(one)),
            text(len(one.changes)),
        ]
        for one in series
    ]  # fmt: skip
    head = ["kind", "series", "machine", "entries", "first", "last", "95 % interval", "changes"]
    return table(head, body, numeric={3, 4, 5, 6, 7})


def _entries(entries: Sequence[Entry]) -> str:
    body = [
        [f"<code>{text(e.short)}</code>", text(e.date), text(e.subject), text(e.machine or "not stated"),
         text(len(e.rows))]
        for e in reversed(entries)
    ]  # fmt: skip
    return table(["commit", "date", "subject", "machine", "rows"], body, numeric={4})


def _figures(entries: Sequence[Entry], series: Sequence[Series], kind: str) -> Section:
    """A figure for each suite, case and metric, or for each suite and machine, with a line for each model."""
    groups: dict[tuple[Any, ...], list[Series]] = {}
    for one in series:
        if one.kind == kind:
            names = ("suite", "case", "metric") if kind == "error" else ("suite", "machine")
            groups.setdefault((*(one.about[name] for name in names), one.unit), []).append(one)
    if not groups:
        return Section("")
    html, figures = [], []
    for number, (group, mine) in enumerate(sorted(groups.items(), key=lambda item: str(item[0]))):
        caption = text(" · ".join(str(word) for word in group[:-1] if word))
        html.append(f'<figure><figcaption>{caption}</figcaption><div id="{kind}{number}"></div></figure>')
        figures.append(_figure(entries, mine, group[-1]))
    title = {"error": "Errors against commit", "speed": "Speeds against commit"}[kind]
    data = f"{kind}-figures"
    return Section(f"<h2>{title}</h2>{''.join(html)}", {data: figures}, drawing(data, kind))


def _figure(entries: Sequence[Entry], series: Sequence[Series], unit: str) -> dict[str, Any]:
    models = list(dict.fromkeys(model_name(one.about) for one in series))
    lines = []
    for one in series:
        place = models.index(model_name(one.about))
        lines += _line(entries, one, COLOURS[place % len(COLOURS)], DASHES[_dash(one, series) % len(DASHES)])
    ticks = [f"{entry.short[:7]}<br>{entry.date[5:10]}" for entry in entries]
    layout: dict[str, Any] = {
        "height": 300 + 20 * len(series), "margin": {"l": 70, "r": 20, "t": 10, "b": 60},
        **(LEGEND if len(series) > 1 else {}),
        "xaxis": {"tickvals": list(range(len(entries))), "ticktext": ticks, "range": [-0.5, len(entries) - 0.5]},
        "yaxis": {"title": {"text": unit}, "rangemode": "tozero"},
    }  # fmt: skip
    if len(entries) > 14:  # as many names as there is room for
        layout["xaxis"]["tickvals"] = list(range(0, len(entries), -(-len(entries) // 14)))
        layout["xaxis"]["ticktext"] = [ticks[k] for k in layout["xaxis"]["tickvals"]]
    return {"data": lines, "layout": layout}


def _dash(one: Series, series: Sequence[Series]) -> int:
    """Which of the lines of its model in one figure it is."""
    return [o for o in series if model_name(o.about) == model_name(one.about)].index(one)


def _line(entries: Sequence[Entry], one: Series, colour: str, dash: str) -> list[dict[str, Any]]:
    """The points with their intervals, and a mark at each change."""
    halves = [p.half or 0.0 for p in one.points]
    hover = [  # the parts are escaped and not the whole: the break between them is HTML
        text(f"{entries[p.entry].short} {one.label}")
        + "<br>"
        + text((value(p.value, one.unit) or p.reason) + (f" ± {p.half:.2g}" if p.half else ""))
        for p in one.points
    ]
    line = {
        "x": [p.entry for p in one.points], "y": [p.value for p in one.points], "mode": "lines+markers",
        "line": {"color": colour, "dash": dash}, "marker": {"color": colour}, "text": hover,
        "error_y": {"array": rounded(halves), "color": colour, "thickness": 1}, "hoverinfo": "text",
        "name": text(one.label),
    }  # fmt: skip
    marked = [c for c in one.changes if c.after is not None]
    if not marked:
        return [line]
    at = {p.entry: p.value for p in one.points}
    mark = {
        "x": [c.entry for c in marked], "y": [at[c.entry] for c in marked], "mode": "markers", "hoverinfo": "skip",
        "showlegend": False,
        "marker": {"symbol": "circle-open", "size": 15, "color": GREY, "line": {"width": 2}},
    }  # fmt: skip
    return [line, mark]
