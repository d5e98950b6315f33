"""The page's section on models against mechanics: a table of errors, the figures, and every test's numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothbench.display.html import group, pill, table, text
from clothbench.display.section import Section
from clothbench.engine.study import Results
from clothbench.studies.mechanics.answer import answer_of
from clothbench.studies.mechanics.checks import CHECKS
from clothbench.studies.mechanics.figures import colours, error_figures, validation_figures
from clothbench.studies.mechanics.tables import called, finest, observed_orders, relative_error

Rows = Sequence[dict[str, Any]]
INTRO = """<p class="soft">Textbook cloth in scenes whose answer is known; nothing is fitted. Error of the value on
the finest mesh over its reference, which mechanics gives; of energy_drift, what is lost or gained within ten seconds;
of the convergence tests, the observed order itself.</p>"""
SCRIPT = """
const tests = JSON.parse(document.getElementById("tests").textContent);
function drawTests() {
  byId("test-legend").replaceChildren(...tests.legend.map((entry) => legendButton(entry, drawTests)));
  tests.figures.forEach((figure, n) => draw("test-" + n, figure));
  if (byId("test-error")) draw("test-errors", tests.errors[byId("test-error").value]);
}
if (byId("test-error")) {
  byId("test-error").replaceChildren(...Object.keys(tests.errors).map((n) => new Option(n, n)));
  byId("test-error").addEventListener("change", drawTests);
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawTests);
drawTests();
"""


def sections(results: Results) -> list[Section]:
    """Everything about models against mechanics."""
    rows, levels = results.rows, results.table("validation")
    body = numbers(rows, levels)
    drawn = told_apart(rows, levels)
    shown = validation_figures(drawn)
    return [_drawn(body, shown, error_figures(drawn), drawn) if shown else Section(body)]


def told_apart(rows: Rows, levels: Rows) -> list[dict[str, Any]]:
    """The levels to draw: of the cells that the tables of errors show, each with what they call its model there."""
    suites, names = group(rows, lambda r: r["suite"]), dict[str, str]()
    for suite, mine in suites.items():
        name = called(mine)
        names |= {r["key"]: name(r) + (f", {suite}" if len(suites) > 1 else "") for r in finest(mine, levels)}
    return [{**v, "model": names[v["key"]]} for v in levels if v["key"] in names]


def numbers(rows: Rows, levels: Rows) -> str:
    """The answer of each suite, then its numbers."""
    suites = sorted(group(rows, lambda r: r["suite"]).items())
    found = [answer_of(suite, mine, levels) for suite, mine in suites]
    for suite, mine in suites:
        shown = errors(mine, levels) + tests(mine, levels)
        found.append(f"<h2>{text(suite)}: models against references</h2>{INTRO}{shown}")
    return "".join(found)


def errors(rows: Rows, levels: Rows = ()) -> str:
    """Model × test, the error in %; rows of one suite. A model that is set in several ways has a column for each."""
    cases, name = list(dict.fromkeys(r["case"] for r in sorted(rows, key=_rank))), called(rows)
    models = sorted(set(map(name, rows)))
    at = {(name(r), r["case"]): r for r in finest(rows, levels)}
    body = [[text(case), *(_error(at.get((model, case))) for model in models)] for case in cases]
    return table(["test", *models], body, numeric=set(range(1, len(models) + 1)))


def _rank(row: dict[str, Any]) -> tuple[int, str]:
    names = [check.name for check in CHECKS]
    name = row["case"].split(":")[0]
    return names.index(name) if name in names else len(names), ""


def _error(row: dict[str, Any] | None) -> str:
    if row is None:
        return "–"
    error = relative_error(row)
    if error is None:
        return f'<span title="{text(row["reason"])}">{pill(row)}</span>'
    if row["metric"] == "order":
        return f"{row['value']:.2f} <small>(2)</small>"
    late = "" if row["status"] == "ok" else f' <span title="{text(row["reason"])}">{pill(row)}</span>'
    return f"{error:+.3g} %{late}"  # late: not of the finest mesh


def tests(rows: Rows, levels: Rows) -> str:
    """Each row with what it is compared with; folded, for there are many."""
    orders, name = observed_orders(levels), called(rows, meshes=True)
    about = {check.name: check.summary for check in CHECKS}
    head = ["test", "model", "value", "reference", "unit", "order", "status", "what is compared"]
    body = []
    for r in sorted(rows, key=lambda r: (*_rank(r), r["case"], name(r))):
        numbers = ["" if r[n] is None else f"{r[n]:.6g}" for n in ("value", "reference")]
        order = orders.get(r["key"])
        note = text(about.get(r["case"].split(":")[0], ""))
        note += f"<br><small>{text(r['reason'])}</small>" if r["reason"] else ""
        body.append([text(r["case"]), text(name(r)), *numbers, text(r["unit"]),
                     "" if order is None else f"{order:.2f}", pill(r), note])  # fmt: skip
    shown = table(head, body, numeric={2, 3, 5})
    return f"<details><summary>{len(rows)} values beside their references</summary>{shown}</details>"


def _drawn(body: str, shown: list[dict[str, Any]], over_mesh: dict[str, Any], levels: Rows) -> Section:
    parts = [body, '<div class="menu"><div id="test-legend"></div></div>']
    for n, one in enumerate(shown):
        parts.append(f"<h3>{text(one['title'])}</h3><figure><figcaption>{text(one['caption'])}</figcaption>")
        parts.append(f'<div id="test-{n}"></div></figure>')
    if over_mesh:
        parts.append(
            '<h3>Error over the mesh</h3><div class="menu"><label for="test-error">Test</label>'
            '<select id="test-error"></select></div><figure><figcaption>Absolute error against the reference; dotted: '
            'second order.</figcaption><div id="test-errors"></div></figure>'
        )
    legend = [[name, colour, "solid"] for name, colour in colours(levels).items()]
    content = {"legend": legend, "figures": [one["figure"] for one in shown], "errors": over_mesh}
    return Section("\n".join(parts), {"tests": content}, SCRIPT)
