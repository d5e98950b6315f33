"""The page's sections on calibrations: leaderboards, figures with a menu, what was asked of the fits, parameters."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from clothbench.display.html import group, text
from clothbench.display.names import model_name
from clothbench.display.section import Section
from clothbench.engine.study import Results
from clothbench.studies.calibration.analysis_page import analysis_section
from clothbench.studies.calibration.answer import answer_section
from clothbench.studies.calibration.asked import with_settings
from clothbench.studies.calibration.budget import histories_of
from clothbench.studies.calibration.cloth_page import clips_of, cloth_section
from clothbench.studies.calibration.drapes import SPLITS
from clothbench.studies.calibration.figures import panels
from clothbench.studies.calibration.front_page import front_section
from clothbench.studies.calibration.leaderboard import leaderboard, same_in_all
from clothbench.studies.calibration.matrix import matrix_section
from clothbench.studies.calibration.parameters_page import parameter_section
from clothbench.studies.calibration.published import published_section
from clothbench.studies.calibration.schema import ANALYSIS_TABLES, DRAPES, FRAMES, PICTURES
from clothbench.studies.calibration.searches_page import searches_section
from clothbench.studies.calibration.words import headed

Rows = Sequence[dict[str, Any]]
OPENS = "A click on a picture opens it at its own size."
STEPS = f'<p class="soft">The middle frame of the first recording, step by step. {OPENS}</p>'
STEP = "what the tracker made of the middle frame"
ORDER = """<p class="soft">Mean error over the recordings of a split, low is good. From … to: its 95 % interval; of two
to four recordings the least and the largest, since so few give no interval worth the name. Floor: what noise alone
would give a perfect model on what was held out, or on what was fitted where nothing was.
Cell: by this name <code>clothbench view</code> opens it.</p>"""
FIGURES = """
<section>
<h2 id="figures">Errors, recording by recording</h2>
<div class="menu top"><label for="panel">Show</label><select id="panel"></select><div id="legend"></div></div>
<h3>Error per recording</h3>
<figure><figcaption>Mean error with its 95 % interval. Filled dots: recordings that were
fitted; open diamonds: held out. Grey line: what measurement noise alone would give
a perfect model.</figcaption>
<div id="errors"></div></figure>
<div id="convergence-block"><h3>Convergence</h3>
<figure><figcaption>Lowest error on the fit recordings so far, over evaluations: a line that is level at its right
end was searched to its end.</figcaption>
<div id="convergence"></div></figure></div>
<div id="trace-block"><h3>Error over time</h3>
<div class="menu"><label for="recording">Recording</label><select id="recording"></select></div>
<figure><figcaption>Error of the best fit in each frame; grey line: noise floor;
grey dashes: what a paper says.</figcaption>
<div id="trace"></div></figure></div>
</section>
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
function choosePanel(wanted) {
  const [now, number] = [current(), panels.findIndex(wanted)];
  if (number < 0 || panels[number] === now) return;
  byId("panel").selectedIndex = number;
  drawPanel();
}
byId("panel").addEventListener("change", () => { address.keep("case", current().case);
  address.keep("metric", current().metric);
  drawPanel();
});
byId("recording").addEventListener("change", drawTrace);
address.listen("case", (name) => choosePanel((p) => p.case === name && p.metric === current().metric));
address.listen("metric", (name) => choosePanel((p) => p.metric === name && p.case === current().case));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawPanel);
drawPanel();
"""


KINDS = {".png": "png", ".jpg": "jpeg"}


def sections(results: Results) -> list[Section]:
    """What the page shows of calibrations."""
    results = with_settings(results)
    ranked = replace(results, rows=told_by_unit(results.rows))
    analyses = analysis_section(results.rows, {name: results.table(name) for name in ANALYSIS_TABLES})
    histories, clips = histories_of(results.store, results.keys), clips_of(results)
    looks = [matrix_section(ranked, clips.cases.keys()), cloth_section(clips, results.rows)]
    if len({model_name(r) for r in results.rows}) == 1:  # nothing to compare: the cloth says more than a table
        looks.reverse()
    found = [
        answer_section(ranked, histories),
        *looks,
        pictures_of_fits(results),
        pictures_of_drapes(results),
        parameter_section(results),
        analyses,
        figures(results),
        published_section(results),
        front_section(results),
        searches_section(results),
        steps(results),
        leaderboards(ranked.rows),
    ]
    return [section for section in found if section is not None]


def told_by_unit(rows: Rows) -> list[dict[str, Any]]:
    """The rows, with the unit beside the name of a metric that some of them have in another: nothing ranks millimetres
    beside centimetres, and no mean is made of both.
    """
    known = {(r["key"], r["metric"]): r["unit"] for r in rows if r["metric"] and r["unit"]}
    units = Counter(metric for metric, _ in {(metric, unit) for (_, metric), unit in known.items()})

    def told(row: dict[str, Any], metric: str | None) -> str | None:
        unit = known.get((row["key"], metric))
        return f"{metric} [{unit}]" if unit and units[metric] > 1 else metric

    return [{**r, "metric": told(r, r["metric"]), "objective": told(r, r["objective"])} for r in rows]


def leaderboards(rows: Rows) -> Section:
    parts = []
    for suite, mine in sorted(group(rows, lambda r: r["suite"]).items()):
        same = same_in_all(mine)
        said = f'<p class="soft">In every line: {same}.</p>' if same else ""
        title = text(headed(rows)(suite, "all numbers"))
        parts.append(f'<h2 id="numbers">{title}</h2>{ORDER}{said}{leaderboard(mine)}')
    return Section("".join(parts))


def figures(results: Results) -> Section | None:
    """The figures with their menu."""
    shown = panels(results.store, results.rows)
    return Section(FIGURES, {"panels": shown}, SCRIPT) if shown else None


def steps(results: Results) -> Section | None:
    """What the trackers made of images, step by step: once for all cells that saw the same."""
    shown: dict[tuple[str, ...], str] = {}
    for key, row in sorted({r["key"]: r for r in reversed(results.rows)}.items()):
        pictures = sorted((results.store.cell(key) / PICTURES).glob("*.png"))
        if pictures:
            seen = (row["suite"], row["case"], *(p.name for p in pictures))
            shown.setdefault(seen, strip(pictures, step_called, STEP))
    if not shown:
        return None
    body = "".join(f"<h3>{text(suite)} · {text(case)}</h3>{html}" for (suite, case, *_), html in shown.items())
    return Section(f"<h2>What the tracker made of the images</h2>{STEPS}{body}")


def pictures_of_fits(results: Results) -> Section | None:
    """Frames of a video, tracked and fitted, of each cell that has some."""
    note = "Left as it was tracked, right the best fit, on frames of the first recording."
    return _pictures(results, FRAMES, "*.jpg", "Tracked and fitted", note, str, "the cloth as tracked, and as fitted")


def pictures_of_drapes(results: Results) -> Section | None:
    """Outlines of drapes, captured and simulated, of each cell that has some."""
    note = "Outlines from above: all captures in grey, the best fit from several first shapes in red; circles are the "
    note += "plate and the flat specimen."
    called, shows = drape_called(results.rows), "outlines of drapes, captured in grey, simulated in red"
    return _pictures(results, DRAPES, "*.png", "Drapes, captured and simulated", note, called, shows)


def _pictures(
    results: Results, folder: str, pattern: str, title: str, about: str, called: Callable[[str], str], shows: str
) -> Section | None:  # fmt: skip
    """The pictures that cells have in a folder, cell by cell."""
    parts = []
    for key, row in sorted({r["key"]: r for r in reversed(results.rows)}.items()):
        if pictures := sorted((results.store.cell(key) / folder).glob(pattern)):
            name = f"{text(row['case'])} · {model_name(row)} · {text(row['optimizer'])}"
            parts.append(f"<h3>{name}</h3>{strip(pictures, called, shows)}")
    return Section(f'<h2>{title}</h2><p class="soft">{about} {OPENS}</p>{"".join(parts)}') if parts else None


def strip(pictures: Sequence[Path], called: Callable[[str], str], shows: str) -> str:
    """Pictures side by side, of which each opens at its own size. called: what one is called, of its file's stem;
    shows: what all of them are of, for those who do not see them.
    """
    each = (
        f'<figure><details class="picture"><summary><img alt="{text(called(p.stem))}: {shows}" '
        f'src="data:image/{KINDS[p.suffix]};base64,{b64encode(p.read_bytes()).decode()}"></summary></details>'
        f"<figcaption>{text(called(p.stem))}</figcaption></figure>"
        for p in pictures
    )
    return f'<div class="strip">{"".join(each)}</div>'


def step_called(stem: str) -> str:
    """ "step 2: outliers" of "2 outliers"."""
    number, _, name = stem.partition(" ")
    return f"step {number}: {name}"


def drape_called(rows: Rows) -> Callable[[str], str]:
    """What the picture of a drape is called: its recording, as these rows have it, and its split."""
    known = {r["recording"].replace("/", " "): r["recording"] for r in rows if r["recording"]}

    def called(stem: str) -> str:
        _, _, rest = stem.partition(" ")
        word = next((w for w in SPLITS.values() if rest.startswith(f"{w} ")), "")
        name = rest.removeprefix(word).strip()
        return ", ".join(filter(None, (known.get(name, name), word)))

    return called
