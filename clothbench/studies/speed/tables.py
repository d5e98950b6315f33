"""Speeds as tables: in the terminal and on the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.html import group, text
from clothbench.display.html import table as html_table
from clothbench.display.section import Section
from clothbench.engine.study import Results
from clothbench.studies.speed.answer import answer_of, millions
from clothbench.studies.speed.bench import ASIDE, NO_PEERS, PEER_STEP, PROCESSES, ROOFLINE, Row, of_peer
from clothbench.studies.speed.timing import TOLERABLE


def show(results: Results) -> list[Any]:
    """The tables of each run below its name."""
    out: list[Any] = []
    for name, rows in runs(results):
        out += [*([escape(name)] if name else []), *speed_tables(rows)]
    return out


def runs(results: Results) -> list[tuple[str, list[Row]]]:
    """Measurements by the run that they are of, since they can be compared within it only. Its name says where and when
    it was, "" of a single one.
    """
    found = group(results.table("speeds"), lambda row: row.get("key"))
    if len(found) < 2:
        return [("", rows) for rows in found.values()] or [("", [])]
    about = {row["key"]: f"{row['cpu']}, {row['threads']} threads, {row['finished']}" for row in results.rows}
    return [(about[key], rows) for key, rows in found.items()]


def sections(results: Results) -> list[Section]:
    """What `show` prints, as one table of the page for each run."""
    return [_section(name, rows) for name, rows in runs(results)]


def _section(name: str, rows: Sequence[Row]) -> Section:
    head = ["model", "kind", "precision", "options", "step", "nodes", "threads", "batch", "million node-steps/s",
            "× real time", "peer", "× peer, per core", "error [mm]"]  # fmt: skip
    body = [[text(cell) for cell in _page_line(row)] for row in rows if row["peer"] != ROOFLINE]
    note = '<p class="soft">All in one run, after warm-up. With an error: at the longest step that keeps to it.</p>'
    note += "".join(f"<p>{text(line)}</p>" for line in _rooflines(rows))
    heading = f"<h2>Speed{text(f': {name}' if name else '')}</h2>"
    return Section(f"{answer_of(rows)}{heading}{note}" + html_table(head, body, numeric={5, 6, 7, 8, 9, 11, 12}))


def _page_line(row: Row) -> list[str]:
    error = "" if row["error_m"] is None else f"{1e3 * row['error_m']:.2g}"
    step = row["note"] if row["step_s"] is None else f"{1e3 * row['step_s']:.3g} ms"
    about = [*(row[k] for k in ("model", "kind", "precision", "options")), step]
    about += [row[k] for k in ("nodes", "threads", "batch")]
    pace = [millions(row), times_real(row)]
    ratio = "" if row["ratio"] is None else f"{row['ratio']:.2f}"
    return [*(str(a or "") for a in about), *pace, row["peer"] or "", ratio, error]


def times_real(row: Row) -> str:
    """How many times as fast as real time; "" of what finds rest, in which no time passes."""
    return "" if row["realtime_factor"] is None else f"{row['realtime_factor']:.3g}"


def _rooflines(rows: Sequence[Row]) -> list[str]:
    """The lines on what one core could do at most, each once, however many sheets were measured apart."""
    return list(dict.fromkeys(row["note"] for row in rows if row["peer"] == ROOFLINE))


def speed_tables(rows: Sequence[Row]) -> list[Any]:
    """A line for each measurement, with its ratio to each peer; then the share of separate processes."""
    equal, rows = [r for r in rows if r["error_m"] is not None], [r for r in rows if r["error_m"] is None]
    peers = list(dict.fromkeys(r["peer"] for r in rows if r["peer"] not in NO_PEERS))
    table = Table(title="speed, in million node-steps/s; × a peer: per core", title_justify="left", title_style="bold")
    for name in ("model", "how"):
        table.add_column(name, overflow="fold", min_width=9)  # where it is narrow, words give way to numbers
    beside = [f"×\n{p}" for p in peers]
    for name in ("nodes", "thr.", "batch", "million\nsteps/s", "× real\ntime", *beside):
        table.add_column(name, justify="right", no_wrap=True)
    for cells in _lines([r for r in rows if r["peer"] not in ASIDE], peers):
        table.add_row(*map(escape, cells))
    out: list[Any] = [table]
    for row in (r for r in rows if r["peer"] == PROCESSES):
        what = f"{row['model']}, {row['nodes']} nodes, {row['threads']} threads"
        out.append(f"{escape(what)}: {row['ratio']:.2f}, {escape(row['note'])}")
    out += map(escape, _rooflines(rows))
    if not equal:
        return out
    title = f"one sheet per core, longest step that errs by {1e3 * TOLERABLE:g} mm at most"
    table = Table("model", "options", title=title, title_justify="left", title_style="bold")
    for name in ("nodes", "step, ms", "error, mm", "× real time", "× fastest peer"):
        table.add_column(name, justify="right")
    for r in equal:
        ratio = "" if r["ratio"] is None else f"{r['ratio']:.1f} ({r['peer']})"
        step, error, pace = f"{1e3 * r['step_s']:.3g}", f"{1e3 * r['error_m']:.2g}", f"{r['realtime_factor']:.3g}"
        table.add_row(*map(escape, (r["model"], r["note"] or "", str(r["nodes"]), step, error, pace, ratio)))
    return [*out, table]


def _lines(rows: Sequence[Row], peers: Sequence[str]) -> Iterator[list[str]]:
    """The cells of the table: rows that differ in their peer alone share a line."""
    together: dict[tuple, dict[str, str]] = {}
    about: dict[tuple, Row] = {}
    for row in rows:
        key = tuple(v for k, v in row.items() if k not in ("peer", "ratio"))
        about[key] = row
        together.setdefault(key, {})[row["peer"]] = f"{row['ratio']:.1f}" if row["ratio"] is not None else ""
    for key, row in about.items():
        step = PEER_STEP if of_peer(row) else row["note"]
        how = ", ".join(filter(None, (row["kind"], row["precision"], row["options"], step)))
        counts = (row["nodes"], row["threads"], row["batch"])
        speed = (millions(row), times_real(row))
        yield [row["model"], how, *(str(c or "") for c in counts), *speed, *(together[key].get(p, "") for p in peers)]
