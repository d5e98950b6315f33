"""The page's sections on calibrations: leaderboards, figures with a menu, what was asked of the fits, parameters."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clothbench.display.html import text
from clothbench.display.names import model_name
from clothbench.display.parameters import parameters
from clothbench.display.section import Section
from clothbench.engine.study import Results
from clothbench.studies.calibration.analysis_page import analysis_section
from clothbench.studies.calibration.figures import panels
from clothbench.studies.calibration.front_page import front_section
from clothbench.studies.calibration.leaderboard import leaderboard
from clothbench.studies.calibration.published import published_section
from clothbench.studies.calibration.schema import ANALYSIS_TABLES, DRAPES, FRAMES, PICTURES
from clothbench.studies.calibration.searches_page import searches_section

Rows = Sequence[dict[str, Any]]
STEPS = '<p class="soft">The middle frame of the first recording, step by step.</p>'
ORDER = """<p class="soft">Mean error over the recordings of a split, with its 95 % interval. Within a case
and a metric the lowest held-out error comes first; where intervals overlap, that order may be chance.</p>"""
FIGURES = """
<h2 id="figures">Figures</h2>
<div class="menu top"><label for="panel">Show</label><select id="panel"></select><div id="legend"></div></div>
<h3>Error per recording</h3>
<figure><figcaption>Mean error with its 95 % interval. Filled dots: recordings that were
fitted; open diamonds: held out. Grey line: what measurement noise alone would give
a perfect model.</figcaption>
<div id="errors"></div></figure>
<div id="convergence-block"><h3>Convergence</h3>
<figure><figcaption>Lowest error on the fit recordings so far, over evaluations.</figcaption>
<div id="convergence"></div></figure></div>
<div id="trace-block"><h3>Error over time</h3>
<div class="menu"><label for="recording">Recording</label><select id="recording"></select></div>
<figure><figcaption>Error of the best fit in each frame; grey line: noise floor;
grey dashes: what a paper says.</figcaption>
<div id="trace"></div></figure></div>
"""

SCRIPT = """
const panels = JSON.parse(document.getElementById("panels").textContent);
const current = () => panels[byId("panel").selectedIndex];
function drawTrace() {
  const figure = current().traces[byId("recording").value];
  if (figure) draw("trace", figure);
}
function drawPanel() {
  const panel = current(), before = byId("recording").value, names = Object.keys(panel.traces);
  byId("legend").replaceChildren(...panel.legend.map((entry) => legendButton(entry, drawPanel)));
  draw("errors", panel.errors);
  byId("convergence-block").hidden = !panel.convergence;
  if (panel.convergence) draw("convergence", panel.convergence);
  byId("trace-block").hidden = names.length === 0;
  options(byId("recording"), names);
  if (names.includes(before)) byId("recording").value = before;
  drawTrace();
}
options(byId("panel"), panels.map((p) => p.title));
byId("panel").addEventListener("change", drawPanel);
byId("recording").addEventListener("change", drawTrace);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawPanel);
drawPanel();
"""


KINDS = {".png": "png", ".jpg": "jpeg"}


def sections(results: Results) -> list[Section]:
    """What the page shows of calibrations."""
    analyses = analysis_section(results.rows, {name: results.table(name) for name in ANALYSIS_TABLES})
    beside = published_section(results)
    found = [
        leaderboards(results.rows),
        figures(results),
        beside,
        steps(results),
        pictures_of_fits(results),
        pictures_of_drapes(results),
        front_section(results),
        searches_section(results),
        analyses,
        fits(results.rows, results.table("parameters")),
    ]
    return [section for section in found if section is not None]


def leaderboards(rows: Rows) -> Section:
    suites = sorted({r["suite"] for r in rows})
    return Section("".join(
        f"<h2>{text(s)}: leaderboard</h2>{ORDER}" + leaderboard([r for r in rows if r["suite"] == s]) for s in suites
    ))  # fmt: skip


def figures(results: Results) -> Section | None:
    """The figures with their menu."""
    shown = panels(results.store, results.rows)
    return Section(FIGURES, {"panels": shown}, SCRIPT) if shown else None


def steps(results: Results) -> Section | None:
    """What the trackers made of images, step by step: once for all cells that saw the same."""
    shown: dict[tuple[str, ...], str] = {}
    for key in sorted({r["key"] for r in results.rows}):
        row = next(r for r in results.rows if r["key"] == key)
        pictures = sorted((results.store.cell(key) / PICTURES).glob("*.png"))
        if pictures:
            shown.setdefault((row["suite"], row["case"], *(p.name for p in pictures)), strip(pictures))
    if not shown:
        return None
    body = "".join(f"<h3>{text(suite)} · {text(case)}</h3>{html}" for (suite, case, *_), html in shown.items())
    return Section(f"<h2>What the tracker made of the images</h2>{STEPS}{body}")


def pictures_of_fits(results: Results) -> Section | None:
    """Frames of a video, tracked and fitted, of each cell that has some."""
    note = "Left as it was tracked, right the best fit, on frames of the first recording."
    return _pictures(results, FRAMES, "*.jpg", "Tracked and fitted", note)


def pictures_of_drapes(results: Results) -> Section | None:
    """Outlines of drapes, captured and simulated, of each cell that has some."""
    note = "Outlines from above: all captures in grey, the best fit from several first shapes in red; circles are the "
    return _pictures(results, DRAPES, "*.png", "Drapes, captured and simulated", note + "plate and the flat specimen.")


def _pictures(results: Results, folder: str, pattern: str, title: str, about: str) -> Section | None:
    """The pictures that cells have in a folder, cell by cell."""
    parts = []
    for key in sorted({r["key"] for r in results.rows}):
        row = next(r for r in results.rows if r["key"] == key)
        if pictures := sorted((results.store.cell(key) / folder).glob(pattern)):
            name = f"{text(row['case'])} · {model_name(row)} · {text(row['optimizer'])}"
            parts.append(f"<h3>{name}</h3>{strip(pictures)}")
    return Section(f'<h2>{title}</h2><p class="soft">{about}</p>{"".join(parts)}') if parts else None


def strip(pictures: Sequence[Path]) -> str:
    """Pictures side by side, each named by its file: "2 outliers.png"."""
    each = (
        f'<figure><img alt="{text(p.stem)}" src="data:image/{KINDS[p.suffix]};base64,'
        f'{b64encode(p.read_bytes()).decode()}">'
        f"<figcaption>{text(p.stem)}</figcaption></figure>"
        for p in pictures
    )
    return f'<div class="strip">{"".join(each)}</div>'


def fits(rows: Rows, fitted: Rows) -> Section:
    """The parameters of each suite's cells."""
    suites = sorted({r["suite"] for r in rows})
    note = '<p class="soft">Best values, below them the 95 % interval.</p>'
    return Section("".join(
        f"<h2>{text(s)}: parameters</h2>{note}" + parameters([r for r in rows if r["suite"] == s], fitted)
        for s in suites
    ))  # fmt: skip
