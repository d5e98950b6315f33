"""Pages in a real browser: no error, no request; tables, anchors and choices work; the player shows what was filmed."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser_page import Page, started
from test_improve_page import EFFECT, rows, verdict
from test_rerun_file import small_cell

from clothbench import surface_of
from clothbench.cli.run import composed
from clothbench.display.film import read_film
from clothbench.display.html import table
from clothbench.display.page import whole_page
from clothbench.display.section import Section, later
from clothbench.engine.cells import Source
from clothbench.engine.run import run_cell
from clothbench.engine.suite import plan, where
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.kinds import read_sheet
from clothbench.report.page import write_page
from clothbench.report.watch import BESIDE, watching
from clothbench.studies.calibration.cell import CalibrationCell
from clothbench.studies.calibration.page import step_called, strip
from clothbench.studies.improve.page import page_html
from clothbench.vision.render import striped

DRAWN = 'document.querySelectorAll(".js-plotly-plot").length > 0'
READY = 'document.querySelector(".player.ready")'
HEADINGS = """return [...document.querySelectorAll("table")].flatMap((table) => {
    const count = table.tHead ? table.tHead.rows[0].cells.length : 0;
    return [...table.tBodies[0].rows].filter((row) => row.cells.length !== count && row.cells[0].colSpan !== count)
        .map((row) => row.innerText);
});"""
ANCHORS = """return [...document.querySelectorAll('a[href^="#"]')]
    .map((link) => decodeURIComponent(link.hash.slice(1).split("?")[0]))
    .filter((id) => !document.getElementById(id));"""


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    yield from started(tmp_path_factory.mktemp("chromium"))


@pytest.fixture
def page(chromium: Any) -> Callable[..., Page]:
    return Page(chromium).open


@pytest.fixture(scope="module")
def swings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of two models by one optimizer on nodes without a video, and one cell that could not be set up."""
    folder, cell = tmp_path_factory.mktemp("runs"), small_cell(tmp_path_factory.mktemp("recordings"))
    for model in ("mass_spring", "mass_spring_verlet"):
        assert run_cell(dataclasses.replace(cell, model=model, options={model: {"resolution": 5}}), folder) == "ok"
    assert run_cell(dataclasses.replace(cell, options={"mass_spring": {"dt": -1.0}}), folder) == "error"
    return write_page(folder)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of one model on a swatch of linen that was filmed at rest, twice."""
    folder = tmp_path_factory.mktemp("filmed")
    run_cell(linen_cell(), folder)
    return write_page(folder)


def linen_cell() -> CalibrationCell:
    settings: dict[str, Any] = {"recordings": ["builtin:static_dynamic"], "recording": [], "suite": {}}
    found = [read_sheet(p) for p in where(settings) if p.name in ("linen-static-1.nc", "linen-static-2.nc")]
    sources = tuple(Source(r.path, r.name, r.hash, s) for r, s in zip(found, ("fit", "held_out"), strict=True))
    return CalibrationCell(
        suite="swatches", case="linen/static-1", recordings=sources, model="baraff_witkin", effects=(),
        optimizer="annealing", metric="fold", tracker="stripes", report=("node_error",), budget=4,
        scene={"spacing": 0.0375},
    )  # fmt: skip


def run_of(folder: Path, *words: str, cases: tuple[str, ...]) -> Path:
    """The page of some cells of a suite."""
    plugins = catalogue()
    cells = [cell for cell in plan(composed(words), plugins) if set(cell.cases) & set(cases)]
    for cell in cells:
        run_cell(cell, folder)
    return write_page(folder)


@pytest.fixture(scope="module")
def mechanical(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of `physical_validation`: some tests of one model, one of which it skips."""
    words = ("+suite=physical_validation", "model=[mass_spring]", "suite.meshes=[5,9]")
    cases = ("free_fall", "catenary", "swing_period", "cantilever_small")
    return run_of(tmp_path_factory.mktemp("mechanical"), *words, cases=cases)


@pytest.fixture(scope="module")
def folded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of `fold_phase_one`: two steps of one fabric."""
    words = ("+suite=fold_phase_one", "suite.fold.steps=2", "budget=30")
    return run_of(tmp_path_factory.mktemp("folded"), *words, cases=("chanel",))


@pytest.fixture(scope="module")
def improved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("improved") / "index.html"
    path.write_text(page_html(verdict("attributed", {**EFFECT, "family": "clock"}), rows()), encoding="utf-8")
    return path


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("which", ["filmed", "swings", "improved", "mechanical", "folded"])
def test_nobody_is_shut_out(page, which, dark, request):
    """Contrast, names, roles, what the keyboard reaches: by the rules of axe-core, all of the page unfolded."""
    shown = page(request.getfixturevalue(which), dark=dark)
    shown.wait("document.querySelector('.player.ready, .js-plotly-plot, [role=group]')")
    assert shown.barriers() == []


@pytest.mark.parametrize("which", ["mechanical", "folded"])
def test_a_study_of_its_own_has_no_fault(page, which, request):
    shown = page(request.getfixturevalue(which))
    shown.run('document.querySelector("figure").scrollIntoView()')
    shown.wait(DRAWN)
    assert shown.run(HEADINGS) == []
    assert shown.run(ANCHORS) == []
    assert shown.faults() == []


def test_a_product_of_models_has_no_fault(page, swings):
    shown = page(swings)
    shown.wait(READY)
    shown.run('document.getElementById("figures").scrollIntoView()')
    shown.wait(DRAWN)
    assert shown.run(HEADINGS) == []
    assert shown.run(ANCHORS) == []
    assert shown.faults() == []


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_sticks_out_on_a_phone_or_in_the_dark(page, filmed, width, dark):
    shown = page(filmed, width=width, dark=dark)
    shown.wait(READY)
    assert shown.run("return document.documentElement.scrollWidth") <= width
    assert shown.faults() == []


@pytest.mark.parametrize("which", ["swings", "improved"])
def test_no_bar_lies_over_a_heading_that_was_gone_to(page, which, request):
    """The bar with the choices had stuck over everything that came after it, to the end of the page."""
    script = """return [...document.querySelectorAll("h2[id]")].filter((heading) => {
        heading.scrollIntoView();
        const box = heading.getBoundingClientRect();
        const above = document.elementFromPoint(box.left + 10, box.top + box.height / 2);
        return above && !heading.contains(above);
    }).map((heading) => heading.textContent);"""
    shown = page(request.getfixturevalue(which))
    shown.wait("document.querySelector('.menu.top')")
    assert shown.run(script) == []
    sticks = "return getComputedStyle(document.querySelector('.menu.top')).position"
    assert shown.run(sticks) == "sticky"
    assert page(request.getfixturevalue(which), width=390).run(sticks) == "static"


def test_a_picture_opens_at_its_own_size(page, tmp_path):
    cv2.imwrite(str(tmp_path / "2 outliers.png"), np.full((520, 400, 3), 255, np.uint8))
    shown = tmp_path / "pictures.html"
    found = strip([tmp_path / "2 outliers.png"], step_called, "what the tracker made of the frame")
    shown.write_text(whole_page("pictures", [Section(f"<h1>Pictures</h1>{found}")]), encoding="utf-8")
    script = """const part = document.querySelector(".picture"), picture = part.querySelector("img");
        const before = picture.clientHeight;
        picture.click();
        const opened = [part.open, picture.clientHeight === picture.naturalHeight];
        picture.click();
        return [before, ...opened, part.open, picture.clientHeight];"""
    assert page(shown).run(script) == [190, True, True, False, 190]
    assert page(shown).barriers() == []


def test_long_names_stay_beside_their_bars_and_long_choices_on_a_phone(page, swings):
    script = """for (const head of document.querySelectorAll('.strips th[scope="row"]')) {
            head.textContent = "satin/waving-1 · annealing · by node_error · fitted to satin/waving-1, satin/waving-2";
        }
        for (const choice of document.querySelectorAll(".player select")) {
            choice.replaceChildren(new Option("satin/waving-1 of the second fabric · node_error (held out)"));
        }
        const heads = [...document.querySelectorAll('.strips th[scope="row"]')];
        return [heads.filter((head) => head.scrollWidth > head.clientWidth + 1).length,
            document.documentElement.scrollWidth];"""
    for width in (1280, 390):
        shown = page(swings, width=width)
        shown.wait(READY)
        over, wide = shown.run(script)
        assert over == 0
        assert wide <= width


def test_the_page_is_painted_before_figures_are_unpacked(page, filmed):
    shown = page(filmed)
    shown.wait(READY)
    script = 'return performance.getEntriesByName("first-contentful-paint")[0].startTime'
    when = shown.run(script)
    assert when < shown.run("return performance.now()")
    assert not shown.run('return document.querySelector("script#plotly").textContent.includes("Plotly")')


@pytest.mark.parametrize(
    "ordered",
    [
        ["fleece/static-9", "fleece/static-10", "linen/static-1", "linen/waving-1", "wool"],
        ["−1.5 mm", "2e-3 mm", "> 0.4 mm", "3.7 mm", "1,200 mm"],
    ],
)
def test_names_are_sorted_as_words_and_numbers_by_their_size(page, swings, ordered):
    shown = page(swings)
    shown.wait('document.querySelector(".tools")')
    script = f"""const texts = {json.dumps(ordered[::-1])};
        const tables = [...document.querySelectorAll("table")];
        const table = tables.find((t) => t.tHead?.innerText.includes("held out"));
        const body = table.tBodies[0], row = [...body.rows].find((r) => r.cells.length > 1);
        const rows = texts.map((text) => {{
            const made = row.cloneNode(true); made.cells[0].textContent = text; return made;
        }});
        body.replaceChildren(...rows);
        table.tHead.rows[0].cells[0].querySelector("button").click();
        return [...body.rows].map((r) => r.cells[0].textContent);"""
    assert shown.run(script) == ordered


def test_tables_are_sorted_and_taken_along(page, swings):
    shown = page(swings)
    shown.wait('document.querySelector(".tools")')
    script = """const tables = [...document.querySelectorAll("table")];
        const table = tables.find((t) => t.tHead?.innerText.includes("held out"));
        const heads = [...table.tHead.rows[0].cells], column = heads.findIndex((h) => h.innerText === "held out");
        const values = () => [...table.tBodies[0].rows].map((row) => parseFloat(row.cells[column].innerText))
            .filter(Number.isFinite);
        heads[column].querySelector("button").click();
        const up = values();
        heads[column].querySelector("button").click();
        return [up, values(), heads[column].ariaSort];"""
    up, down, said = shown.run(script)
    assert len(up) > 1
    assert up == sorted(up)
    assert down == sorted(down, reverse=True)
    assert said == "descending"
    saved = """const blobs = [], make = URL.createObjectURL;
        URL.createObjectURL = (blob) => { blobs.push(blob); return make.call(URL, blob); };
        HTMLAnchorElement.prototype.click = () => {};
        for (const name of ["CSV", "JSON"]) {
            [...document.querySelectorAll(".tools button")].find((b) => b.textContent === name).click();
        }
        return Promise.all(blobs.map((blob) => blob.text()));"""
    csv, document = shown.run(saved)
    assert csv.splitlines()[0].startswith("fit,model,parameter,")
    assert document.startswith("[")
    assert shown.faults() == []


def test_choices_are_kept_in_the_address(page, filmed):
    shown = page(filmed)
    shown.wait(READY)
    shown.run("""const choice = document.querySelector('[data-part="recording"]');
        choice.selectedIndex = 1; choice.dispatchEvent(new Event("change"));
        document.querySelector('.switch[data-metric="node_error"]').click();""")
    address = shown.run("return location.hash")
    assert "recording=linen%2Fstatic-2" in address
    again = page(filmed, address)
    again.wait(READY)
    script = """return [document.querySelector('[data-part="recording"]').value,
        document.querySelector(".metric:not([hidden])").dataset.metric];"""
    assert again.run(script) == ["linen/static-2", "node_error"]


def test_a_click_on_a_case_opens_it(page, swings):
    shown = page(swings)
    shown.wait(READY)
    shown.run('document.querySelector("table[data-heat] tbody tr td").click()')
    shown.wait('location.hash.startsWith("#cloth?case=")')
    shown.wait('Math.abs(document.getElementById("cloth").getBoundingClientRect().top) < 200')
    assert shown.faults() == []


def test_the_player_plays(page, filmed):
    shown = page(filmed)
    shown.wait(READY)
    before = shown.run("""return document.querySelector('[data-part="said"]').textContent""")
    shown.run("""document.querySelector('[data-part="play"]').click()""")
    shown.wait(f"""document.querySelector('[data-part="said"]').textContent !== {before!r}""")
    shown.run("""document.querySelector('[data-part="play"]').click()""")
    script = """const scrub = document.querySelector('[data-part="scrub"]');
        scrub.value = 0; scrub.dispatchEvent(new Event("input"));
        return document.querySelector('[data-part="said"]').textContent;"""
    said = shown.run(script)
    assert said.startswith("0.00 s · ")
    assert "px" in said
    assert "mm on average" in said
    assert shown.faults() == []


def test_the_page_draws_the_pictures_that_were_compared(page, filmed):
    """The sheet through the recording's camera, once by the page's script, once by what the metric draws with."""
    shown, film = page(filmed), read_film(next((filmed.parent / "cells").glob("*/films/0.npz")))
    shown.wait(READY)
    script = """const told = await dataOf("film-0"), take = (await dataOf("takes-0"))[0];
        const surface = sheet.surface(told.surface), points = surface.refine(sheet.places(take.position)[1], 3);
        return [...sheet.striped(told.optics, told.size, points, surface.triangle)];"""
    drawn = np.array(shown.run(script)).reshape(film.size[::-1])
    assert film.camera is not None
    assert film.projector is not None
    position = film.takes["fitted"].position[1:2]
    expected = striped(film.camera, film.projector, surface_of(film.material, 4), position)[0][0]
    assert np.abs(drawn - expected).mean() < 2e-3
    assert (np.abs(drawn - expected) > 0.02).mean() < 2e-3


def test_a_sheet_without_video_is_shown_in_space(page, swings):
    shown = page(swings)
    shown.wait(READY)
    script = """const canvas = document.querySelector('[data-part="space"]');
        const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        return [document.querySelector('[data-part="left"]').closest("figure").hidden,
            pixels.filter((_, i) => i % 4 === 3).filter(Boolean).length / (canvas.width * canvas.height)];"""
    hidden, covered = shown.run(script)
    assert hidden
    assert 0.02 < covered < 0.9


def test_the_page_of_improve_has_no_fault(page, improved):
    shown = page(improved)
    shown.wait(DRAWN)
    assert shown.run(HEADINGS) == []
    assert shown.run(ANCHORS) == []
    assert shown.faults() == []


def test_a_watched_page_loads_itself_anew_and_at_last_without_that(page, tmp_path):
    def changed(state: str) -> None:
        write_page(tmp_path, [watching(state)])
        (tmp_path / BESIDE).write_text(f'self.clothbenchState = "{state}";')

    changed("first")
    shown = page(tmp_path / "report.html")
    shown.wait('document.querySelector("[data-watched=first]")')
    changed("second")
    shown.wait('document.querySelector("[data-watched=second]")')
    assert shown.faults() == []
    write_page(tmp_path)
    (tmp_path / BESIDE).unlink()
    shown.wait('!document.querySelector("[data-watched]")')


def test_a_copy_of_a_watched_page_is_left_alone(page, tmp_path):
    """Nothing lies beside it that could tell of another state: it had loaded itself anew every second."""
    shown = page(write_page(tmp_path, [watching("first")]))
    shown.wait('!document.querySelector("[data-watched]")')
    assert shown.run("return document.querySelector('h1') !== null")


def test_candidates_can_be_read_on_a_phone(page, improved):
    """Nothing of a candidate lies beyond the window's edge, and its numbers say what they are."""
    shown = page(improved, width=390)
    shown.wait('document.querySelector(".candidates tbody td")')
    script = """const cells = [...document.querySelectorAll(".candidates tbody td")];
        const rest = (cell) => getComputedStyle(cell, "::before").content.replaceAll('"', "").trim();
        return [Math.max(...cells.map((cell) => cell.getBoundingClientRect().right)),
            document.querySelector(".candidates .scroll").scrollWidth, document.documentElement.scrollWidth,
            cells.slice(0, 7).map(rest)];"""
    right, inside, whole, words = shown.run(script)
    assert max(right, inside, whole) <= 390
    assert words == ["none", "none", "none", "p", "gain", "best in", "none"]
    assert shown.faults() == []


@pytest.mark.parametrize("which", ["swings", "filmed"])
def test_values_lie_in_their_intervals(page, which, request):
    """As the page shows them: every value of every table with an interval beside it, and every dot on its bar."""
    shown = page(request.getfixturevalue(which))
    script = """const out = [];
        for (const table of document.querySelectorAll("table")) {
            const heads = [...table.tHead.rows[0].cells].map((head) => head.textContent);
            const [value, low, high] = ["value", "low", "high"].map((name) => heads.indexOf(name));
            const wide = (head) => head.includes("from … to") || head === "95 % interval";
            const pairs = heads.flatMap((head, i) => (wide(head) ? [i] : []));
            for (const row of table.tBodies[0].rows) {
                const text = (i) => row.cells[i].textContent;
                if (low > 0 && text(low)) out.push([+text(low), +text(value), +text(high)]);
                for (const i of pairs) {
                    const ends = text(i).match(/^(\\S+) … (\\S+)/);
                    if (ends) out.push([+ends[1], +text(i - 1), +ends[2]]);
                }
            }
        }
        for (const axis of document.querySelectorAll(".axis")) {
            const [bar, dot] = [axis.querySelector("i"), axis.querySelector("b")].map((part) => part?.style);
            const [left, width] = [parseFloat(bar?.left), parseFloat(bar?.width)];
            if (bar) out.push([left - 0.2, parseFloat(dot.left), left + width + 0.2]);
        }
        return out;"""
    found = shown.run(script)
    assert len(found) > 10
    assert [one for one in found if not one[0] <= one[1] <= one[2]] == []


def test_a_long_table_comes_when_it_is_unfolded_and_has_tools(page, tmp_path):
    long = later(table(["n", "square"], [[str(n), str(n * n)] for n in range(4000)], {0, 1}))
    path = tmp_path / "long.html"
    html = whole_page("long", [Section(f"<h2>Squares</h2><details><summary>4000 squares</summary>{long}</details>")])
    assert len(html) < 80_000
    path.write_text(html, encoding="utf-8")
    shown = page(path)
    assert shown.run('return document.querySelector("table") === null')
    shown.run('document.querySelector("details").open = true')
    shown.wait('document.querySelectorAll("tbody tr").length === 4000')
    shown.wait('document.querySelector(".tools input")')
    script = """const field = document.querySelector(".tools input");
        field.value = "3481"; field.dispatchEvent(new Event("input"));
        const rows = [...document.querySelectorAll("tbody tr")];
        return rows.filter((row) => !row.hidden).map((row) => row.cells[0].textContent);"""
    assert shown.run(script) == [str(n) for n in range(4000) if "3481" in f"{n} {n * n}"]
    assert shown.faults() == []
