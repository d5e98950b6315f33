"""The page: one self-contained HTML file over a results folder, with tables and figures; works offline."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clothbench.core.files import whole_file
from clothbench.display.html import pill, table, text
from clothbench.display.plotly import model_name
from clothbench.display.style import CSS, DRAWING, FIGURES, SCRIPT
from clothbench.engine.store import Store
from clothbench.studies.calibration.analysis_page import analysis_section
from clothbench.studies.calibration.figures import panels
from clothbench.studies.calibration.leaderboard import leaderboard, parameters
from clothbench.studies.calibration.schema import ANALYSIS_TABLES
from clothbench.studies.calibration.tables import failures
from clothbench.studies.folding.page import fold_section
from clothbench.studies.mechanics.page import validation_section
from clothbench.studies.mechanics.tables import is_validation

Rows = Sequence[dict[str, Any]]
MACHINE = ("cpu", "cores", "threads", "platform", "python", "numpy", "numba", "clothbench")
HINT = """<p>There are no results here yet. Run the default benchmark, which needs nothing else:</p>
<p><code>clothbench run +suite=static_dynamic</code></p>
<p>and then <code>clothbench report</code> again.</p>"""
ORDER = """<p class="soft">Mean error over the recordings of a split, with its 95 % interval. Within a case
and a metric the lowest held-out error comes first; where intervals overlap, that order may be chance.</p>"""
MORE = """<footer>See a fit beside its recording: <code>clothbench view CELL</code>. The same numbers as data:
<code>clothbench leaderboard --json</code>, or the Parquet files in <code>cells</code>.</footer>"""


def write_page(folder: Path) -> Path:
    """Write FOLDER/report.html from the store in that folder, whole or not at all; returns its path."""
    page = Path(folder) / "report.html"
    with whole_file(page) as part:
        part.write_text(document(Store(folder)), encoding="utf-8")
    return page


def document(store: Store) -> str:
    """The whole page as text: a list of sections, of which an empty one is left out."""
    rows = store.rows()
    sections = [heading(rows), HINT]
    if rows:
        tests, steps = [r for r in rows if is_validation(r)], store.table("fold")
        lifted = {s["key"] for s in steps}
        folded = [r for r in rows if r["key"] in lifted]
        found = [r for r in rows if not is_validation(r) and r["key"] not in lifted]
        drawn = figures(store, found)
        sections = [
            heading(rows),
            overview(rows),
            failure_list(rows),
            leaderboards(found),
            drawn,
            analysis_section(found, {n: store.table(n) for n in ANALYSIS_TABLES}, plotly=not drawn),
            fold_section(folded, steps, plotly=not drawn),
            validation_section(tests, store.levels({r["key"] for r in tests}), plotly=not (drawn or folded)),
        ]
        sections += [fits(found + folded, store.parameters()), machines(rows), MORE]
    return whole_page(title(rows), sections)


def whole_page(title: str, sections: Sequence[str], style: str = "") -> str:
    """A page of HTML sections without the empty ones; `title` is HTML, `style` goes behind the style sheet."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>clothbench: {title}</title><style>{CSS}{style}</style></head><body><main>\n"
        + "\n".join(s for s in sections if s)
        + "\n</main></body></html>\n"
    )


def title(rows: Rows) -> str:
    return text(", ".join(sorted({r["suite"] for r in rows})) or "no results")


def heading(rows: Rows) -> str:
    """What was run, when and on which machine, in two lines."""
    kinds = {"mechanics" if is_validation(r) else "recordings" for r in rows} or {"recordings"}
    top = f"<h1>Cloth models against {' and '.join(sorted(kinds, reverse=True))}: {title(rows)}</h1>"
    if not rows:
        return top
    finished = [r["finished"] for r in rows]
    where = sorted({f"{r['cpu']}, {r['cores']} cores" for r in rows})
    versions = ", ".join(sorted({f"clothbench {r['clothbench']}" for r in rows}))
    on = where[0] if len(where) == 1 else f"{len(where)} machines"
    when = f"finished {span(min(finished), max(finished))} UTC"
    return f"{top}<p class='soft'>{versions} · {when} · {text(on)}</p>"


def overview(rows: Rows) -> str:
    """Tiles: how much was run, and how much of it failed."""
    cells = {r["key"] for r in rows}
    skipped = {r["key"] for r in failures(rows) if r["status"] == "skipped"}
    bad = {r["key"] for r in failures(rows)} - skipped
    tiles = [(len(cells), "cells", ""), (len(cells - bad - skipped), "finished well", "")]
    tiles += [(len(bad), "failed", "bad")] if bad else []
    tiles += [(len(skipped), "skipped", "")] if skipped else []
    tiles.append((len({(r["suite"], r["case"]) for r in rows}), "cases", ""))
    tiles.append((len({(r["suite"], r["case"], r["recording"]) for r in rows if r["recording"]}), "recordings", ""))
    tiles.append((len({r["model"] if is_validation(r) else model_name(r) for r in rows}), "models", ""))
    tiles.append((len({r["optimizer"] for r in rows} - {None}), "optimizers", ""))
    shown = (
        f'<div class="tile {kind}"><b>{n}</b>{word if n != 1 else word.removesuffix("s")}</div>'
        for n, word, kind in tiles
        if n or word not in ("recordings", "optimizers")
    )
    return f'<div class="tiles">{"".join(shown)}</div>'


def failure_list(rows: Rows) -> str:
    """Every cell that did not end well, with its reason, before anything else."""
    if not (bad := failures(rows)):
        return ""
    items = []
    for r in bad:
        place = (r["suite"], r["case"], model_name(r), r["optimizer"], r["metric"], r["recording"])
        reason = text(r["reason"] or "no reason given")
        items.append(f"<li>{pill(r)} {text(' · '.join(p for p in place if p))}: {reason}</li>")
    word = "1 cell has" if len(bad) == 1 else f"{len(bad)} cells have"
    return f'<div class="failures" role="note"><b>{word} no complete result</b><ul>{"".join(items)}</ul></div>'


def leaderboards(rows: Rows) -> str:
    suites = sorted({r["suite"] for r in rows})
    return "".join(
        f"<h2>{text(s)}: leaderboard</h2>{ORDER}" + leaderboard([r for r in rows if r["suite"] == s]) for s in suites
    )


def fits(rows: Rows, fitted: Rows) -> str:
    suites = sorted({r["suite"] for r in rows})
    note = '<p class="soft">Best values, below them the 95 % interval.</p>'
    return "".join(
        f"<h2>{text(s)}: parameters</h2>{note}" + parameters([r for r in rows if r["suite"] == s], fitted)
        for s in suites
    )


def figures(store: Store, rows: Rows) -> str:
    """The figures with their menu; plotly.js stands in the page itself, once."""
    if not (shown := panels(store, rows)):
        return ""
    from plotly.offline import get_plotlyjs

    data = json.dumps(shown, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'{FIGURES}<script type="application/json" id="panels">{data}</script>\n'
        f"<script>{get_plotlyjs()}</script>\n<script>{DRAWING}{SCRIPT}</script>"
    )


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
    return f"<h2>Machines and versions</h2>{shown}{folded}"


def span(first: str, last: str) -> str:
    """ "2026-01-31 09:29 to 09:30" from two ISO stamps."""
    a, b = (stamp[:16].replace("T", " ") for stamp in (first, last))
    return text(a if a == b else f"{a} to {b[11:] if a[:10] == b[:10] else b}")
