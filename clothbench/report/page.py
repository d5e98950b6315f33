"""The page: one self-contained HTML file over a results folder, with tables and figures; works offline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clothbench.core.files import whole_file
from clothbench.display.failures import failures, places
from clothbench.display.html import pill, table, text
from clothbench.display.names import recording_of
from clothbench.display.page import whole_page
from clothbench.display.section import Section
from clothbench.engine.store import Store
from clothbench.engine.study import Results, Study, results_by_study
from clothbench.plugins.discovery import catalogue

Rows = Sequence[dict[str, Any]]
PAGE = "report.html"
MACHINE = ("cpu", "cores", "threads", "platform", "python", "numpy", "numba", "clothbench")
HINT = """<p>There are no results here yet. Run the default benchmark, which needs nothing else:</p>
<p><code>clothbench run +suite=static_dynamic</code></p>
<p>and then <code>clothbench report</code> again.</p>"""
MORE = """<footer>See a fit beside its recording in Rerun: <code>clothbench view CELL</code>. The same numbers as data:
<code>clothbench leaderboard --json</code>, or the Parquet files in <code>cells</code>.</footer>"""


def write_page(folder: Path, first: Sequence[Section] = ()) -> Path:
    """Write FOLDER/report.html from the store in that folder, whole or not at all; returns its path. first: what stands
    below the heading before anything else.
    """
    page = Path(folder) / PAGE
    with whole_file(page) as part:
        part.write_text(page_html(Store(folder), first), encoding="utf-8")
    return page


def page_html(store: Store, first: Sequence[Section] = ()) -> str:
    """The whole page as text: what was run, what failed, then the sections of each study."""
    found, left_out = results_by_study(store, catalogue())
    rows = [row for _, results in found for row in results.rows]
    if not rows:
        return whole_page(title(rows), [Section(heading(found)), *first, Section(HINT)])
    notes = "".join(f"<p>{text(line)}</p>" for line in left_out)
    sections = [Section(heading(found)), *first, Section(failure_list(rows) + notes)]
    for study, results in found:
        sections += study.sections(results)
    return whole_page(title(rows), [*sections, Section(what_was_run(rows) + machines(rows)), Section(MORE)])


def title(rows: Rows) -> str:
    return text(", ".join(sorted({r["suite"] for r in rows})) or "no results")


def heading(found: Sequence[tuple[Study, Results]]) -> str:
    """What was run, when and on which machine, in two lines."""
    rows = [row for _, results in found for row in results.rows]
    kinds = dict.fromkeys(study.against for study, _ in found) or {"recordings": None}
    top = f"<h1>Cloth models against {' and '.join(kinds)}: {title(rows)}</h1>"
    if not rows:
        return top
    finished = [r["finished"] for r in rows]
    where = sorted({f"{r['cpu']}, {r['cores']} cores" for r in rows})
    versions = text(", ".join(sorted({f"clothbench {r['clothbench']}" for r in rows})))
    on = where[0] if len(where) == 1 else f"{len(where)} machines"
    when = f"finished {span(min(finished), max(finished))} UTC"
    return f"{top}<p class='soft'>{versions} · {when} · {text(on)}</p>"


def what_was_run(rows: Rows) -> str:
    """How much was run, and how much of it failed, in a line."""
    cells = {r["key"] for r in rows}
    skipped = cells - {r["key"] for r in rows if r["status"] != "skipped"}  # a cell that has any number is none
    bad = {r["key"] for r in failures(rows) if r["status"] != "skipped"}
    recording = recording_of(rows)
    counts = [
        (len(cells), "cells"), (len(cells - bad - skipped), "finished well"), (len(bad), "failed"),
        (len(skipped), "skipped"), (len({(r["suite"], r["case"]) for r in rows}), "cases"),
        (len({recording(r) for r in rows if r["recording"]}), "recordings"),
        (len({r["model"] for r in rows}), "models"), (len({r["optimizer"] for r in rows} - {None}), "optimizers"),
    ]  # fmt: skip
    said = ", ".join(f"{n} {word if n != 1 else word.removesuffix('s')}" for n, word in counts if n)
    return f"<h2>What was run</h2><p>{said}.</p>"


def failure_list(rows: Rows) -> str:
    """Every cell that did not end well, with its reason, before anything else."""
    if not (bad := failures(rows)):
        return ""
    items = []
    for r, place in zip(bad, places(bad), strict=True):
        where, reason = " · ".join(filter(None, (r["suite"], place))), text(r["reason"] or "no reason given")
        items.append(f"<li>{pill(r)} {text(where)}: {reason}</li>")
    word = "1 cell has" if len(bad) == 1 else f"{len(bad)} cells have"
    return f'<div class="failures" role="note"><b>{word} no complete result</b><ul>{"".join(items)}</ul></div>'


def machines(rows: Rows) -> str:
    """Each machine and set of versions that results come from, with how many cells; then the plugins."""
    cells = list({r["key"]: r for r in rows}.values())
    body = []
    for kind in sorted({tuple(r[n] for n in MACHINE) for r in cells}, key=str):
        ends = [r["finished"] for r in cells if tuple(r[n] for n in MACHINE) == kind]
        body.append([*map(text, kind), span(min(ends), max(ends)), text(len(ends))])
    plugins = sorted({p for r in cells for p in (r["plugins"] or "").split("; ") if p})
    listed = "".join(f"<li>{text(p)}</li>" for p in plugins)
    shown = table([*MACHINE, "finished (UTC)", "cells"], body, numeric={1, 2, 9})
    folded = f"<details><summary>{len(plugins)} plugins and their versions</summary><ul>{listed}</ul></details>"
    return f"<h3>Machines and versions</h3>{shown}{folded}"


def span(first: str, last: str) -> str:
    """ "2026-01-31 09:29 to 09:30" from two ISO stamps."""
    a, b = (stamp[:16].replace("T", " ") for stamp in (first, last))
    return text(a if a == b else f"{a} to {b[11:] if a[:10] == b[:10] else b}")
