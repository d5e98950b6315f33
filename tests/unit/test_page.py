"""The page: self-contained, from the store alone, with failures in plain sight and text escaped."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from rich.console import Console
from test_rerun_file import small_cell

from clothbench.display.failures import failures, places
from clothbench.display.html import table, unit
from clothbench.display.parameters import parameters
from clothbench.display.plotly import log_axis, thinned
from clothbench.engine.run import run_cell
from clothbench.engine.store import Store
from clothbench.report.page import failure_list, what_was_run, write_page
from clothbench.studies.calibration.figure_data import best_so_far
from clothbench.studies.calibration.leaderboard import leaderboard
from clothbench.studies.calibration.page import drape_called, step_called, strip
from clothbench.studies.calibration.tables import error_table

VOID = {"meta", "br", "input"}


class Checker(HTMLParser):
    """Collects text, addresses and scripts, and sees to it that tags are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.scripts = 0

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        self.addresses += [known[name] for name in ("src", "href") if name in known]
        self.ids += [known["id"]] if "id" in known else []
        self.scripts += tag == "script"
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def checked(page: Path) -> tuple[str, Checker]:
    text = page.read_text(encoding="utf-8")
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    assert [a for a in checker.addresses if not a.startswith("#")] == []
    anchors = {unquote(a[1:].partition("?")[0]) for a in checker.addresses}
    assert anchors <= set(checker.ids)
    assert len(set(checker.ids)) == len(checker.ids)
    return text, checker


def panels(text: str) -> list[dict]:
    return json.loads(re.search(r'id="panels">(.*?)</script>', text, re.DOTALL)[1])


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """Two cells that went well, one with options of its own, and one that could not be set up."""
    folder = tmp_path_factory.mktemp("runs")
    cell = small_cell(tmp_path_factory.mktemp("recordings"))
    assert run_cell(cell, folder) == "ok"
    assert run_cell(dataclasses.replace(cell, optimizer="least_squares", report=()), folder) == "ok"
    broken = dataclasses.replace(cell, options={"mass_spring": {"dt": -1.0}})
    assert run_cell(broken, folder) == "error"
    return folder


def test_page_shows_what_was_run(results):
    page = write_page(results)
    text, _ = checked(page)
    assert page == results / "report.html"
    assert text.count("<script>") == 1
    assert text.count("plotly.js v") == 1
    for word in ("small", "mass_spring", "least_squares", "node_error", "N/m", "95 % interval", "k₁", "mm"):
        assert word in text
    assert page.stat().st_size < 6_000_000
    assert not list(results.glob(".report*"))


def test_why_a_search_ended_stands_in_rows_table_and_page(results):
    """A search at its budget might have gone on, one that converged not; failed cells keep their own reason."""
    store = Store(results)
    said = {row["optimizer"]: row["reason"] for row in store.rows() if row["status"] == "ok"}
    assert said["ga"] == "budget spent"
    assert set(said) == {"ga", "least_squares"}
    assert all(said.values())
    rows = [row for row in store.rows() if row["status"] == "ok"]
    shown = Console(width=120, record=True, file=io.StringIO())
    shown.print(error_table("s", rows))
    assert " s; budget spent)" in shown.export_text()
    page = leaderboard(rows)
    assert "search ended" in page
    assert "<td>budget spent</td>" in page
    assert "search ended" not in leaderboard([{**row, "reason": ""} for row in rows])  # as older versions left them


def test_failed_cells_are_visible_with_their_reason(results):
    text, _ = checked(write_page(results))
    assert "1 cell has no complete result" in text
    assert text.count("dt is -1.0, expected a number above 0") >= 2


def of_one_cell(*statuses):
    about = {"suite": "s", "case": "c", "recording": "r", "model": "m", "effects": "", "optimizer": "o", "key": "k"}
    return [{**about, "metric": f"m{k}", "status": s, "reason": f"why {k}"} for k, s in enumerate(statuses)]


@pytest.mark.parametrize(
    ("statuses", "told", "counted"),
    [
        (("skipped", "error"), "why 1", "1 failed"),
        (("skipped", "timeout", "diverged", "error", "error"), "why 3", "1 failed"),
        (("ok", "skipped"), "why 1", "1 finished well"),
        (("skipped", "skipped"), "why 0", "1 skipped"),
        (("ok", "diverged"), "why 1", "1 failed"),
    ],
)
def test_the_worst_of_a_cell_is_told_and_it_is_skipped_only_if_all_of_it_is(statuses, told, counted):
    rows = of_one_cell(*statuses)
    assert [row["reason"] for row in failures(rows)] == [told]
    assert told in failure_list(rows)
    assert what_was_run(rows).split("<p>")[1].startswith(f"1 cell, {counted}, 1 case,")


def test_failed_cells_that_would_be_called_the_same_are_told_apart():
    (one,) = of_one_cell("error")
    rows = [{**one, "key": k, "seed": 1, "budget": 9, "settings": k * 6} for k in ("a", "b")]
    rows.append({**one, "key": "c", "model": "n", "seed": 1})
    assert places(failures(rows)) == [
        "c · m · o · m0 · r · seed 1 · budget 9 · settings aaaaaa",
        "c · m · o · m0 · r · seed 1 · budget 9 · settings bbbbbb",
        "c · n · o · m0 · r",
    ]
    assert "s · c · m · o · m0 · r · seed 1 · budget 9 · settings bbbbbb: why 0" in failure_list(rows)


def test_pictures_open_at_their_own_size_and_say_what_they_show(tmp_path):
    """Captions had been names of files, "1 held out medium held_out"."""
    picture = tmp_path / "1 held out medium held_out.png"
    picture.write_bytes(b"")
    html = strip([picture], drape_called([{"recording": "medium/held_out"}, {"recording": None}]), "outlines of drapes")
    assert "<figcaption>medium/held_out, held out</figcaption>" in html
    assert 'alt="medium/held_out, held out: outlines of drapes"' in html
    assert '<details class="picture"><summary><img' in html
    assert drape_called([])("0 fitted a b") == "a b, fitted"
    assert step_called("2 outliers") == "step 2: outliers"


def test_text_is_escaped_everywhere(results):
    text, _ = checked(write_page(results))
    assert "cotton &lt;b&gt;" in text
    assert "cotton <b>" not in text
    assert [p["title"] for p in panels(text)] == [
        "small · cotton <b> · node_error",
        "small · cotton <b> · relative_error",
    ]


def test_figures_hold_every_cell_and_recording(results):
    own, other = panels(checked(write_page(results))[0])
    assert [entry[0] for entry in own["legend"]] == ["mass_spring · ga", "mass_spring · least_squares"]
    assert own["errors"]["layout"]["xaxis"]["title"]["text"].startswith("error [mm]")
    assert own["errors"]["layout"]["yaxis"]["ticktext"] == ["swing-22", "swing-1"]
    assert {d.get("meta") for d in own["errors"]["data"]} == {
        None,
        "mass_spring · ga",
        "mass_spring · least_squares",
    }
    best = own["convergence"]["data"][0]["y"]
    assert best == sorted(best, reverse=True)
    assert set(own["traces"]) == {"swing-1 (fit)", "swing-22 (held out)"}
    assert len(own["traces"]["swing-1 (fit)"]["data"][0]["x"]) == 11
    assert other["convergence"] is None


def test_a_bound_that_was_hit_is_marked():
    row = {"key": "ab", "case": "linen", "model": "m", "effects": "", "optimizer": "ga", "seed": 0}
    k = {"key": "ab", "name": "k", "symbol": "k", "unit": "N/m", "meaning": "stiffness", "value": 2.0}
    inside = {**k, "low": 1.5, "high": 2.5, "at_bound": False}
    assert "at its bound" not in parameters([row], [inside])
    shown = parameters([row], [{**inside, "at_bound": True}])
    for word in ("at its bound", "1.5 … 2.5", "k [N/m]", "stiffness"):
        assert word in shown


def test_every_parameter_stands_below_its_own_heading():
    """Cells of one model may have different parameters: a suite fixes some of them in some of its cases."""
    about = {"effects": "", "model": "m", "optimizer": "ga", "seed": 0}
    rows = [{**about, "key": "ab", "case": "a"}, {**about, "key": "cd", "case": "b"}]
    p = {"unit": "N/m", "meaning": "stiffness", "low": None, "high": None, "at_bound": False}
    fitted = [
        {**p, "key": "ab", "name": "k", "symbol": "k", "value": 2.0},
        {**p, "key": "cd", "name": "k", "symbol": "k", "value": 3.0},
        {**p, "key": "cd", "name": "d", "symbol": "d", "value": 7.0},
    ]
    shown = parameters(rows, fitted)
    head = re.findall(r"<th [^>]*>(.*?)</th>", shown)
    assert head == ["case", "optimizer", "seed", "k [N/m]", "d [N/m]", "cell"]
    lines = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in re.findall(r"<tr>(<td.*?)</tr>", shown)]
    assert [line[3:5] for line in lines] == [["2", "–"], ["3", "7"]]


def test_parameters_of_one_symbol_are_told_apart():
    row = {"key": "ab", "case": "a", "effects": "", "model": "m", "optimizer": "ga", "seed": 0}
    p = {"key": "ab", "symbol": "τ", "unit": "s", "value": 1.0, "low": None, "high": None, "at_bound": False}
    about = {"memory.lag": "how long it lasts", "clock.shift": "how late it is"}
    shown = parameters([row], [{**p, "name": name, "meaning": meaning} for name, meaning in about.items()])
    assert re.findall(r"<th [^>]*>(.*?)</th>", shown)[3:5] == ["memory.lag [s]", "clock.shift [s]"]
    for name, meaning in about.items():
        assert f"<dt>τ</dt><dd>{name} [s]: {meaning}</dd>" in shown


def test_a_line_that_does_not_fit_its_heading_is_no_table():
    assert "<td>1</td>" in table(["a", "b"], [["1", "2"], ["a heading across all"]], set())
    with pytest.raises(ValueError, match="3 cells below a heading of 2"):
        table(["a", "b"], [["1", "2", "3"]], set())


def test_empty_store_says_what_to_run(tmp_path):
    text, checker = checked(write_page(tmp_path / "nothing"))
    assert "clothbench run +suite=static_dynamic" in text
    assert checker.scripts == 1  # tables and anchors


def test_only_failed_cells_make_a_page_without_figures(tmp_path):
    broken = dataclasses.replace(small_cell(tmp_path), options={"mass_spring": {"dt": -1.0}})
    run_cell(broken, tmp_path / "runs")
    text, checker = checked(write_page(tmp_path / "runs"))
    assert "dt is -1.0" in text
    assert checker.scripts == 1  # tables and anchors
    assert "Nothing was fitted" in text


def test_failed_page_leaves_the_old_one(results, monkeypatch):
    before = write_page(results).read_bytes()
    monkeypatch.setattr("clothbench.report.page.page_html", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_page(results)
    assert (results / "report.html").read_bytes() == before
    assert not list(results.glob(".report*"))


def test_best_so_far_skips_what_could_not_be_computed():
    assert best_so_far(np.array([np.nan, 5.0, 7.0, 3.0, np.nan])) == ([2, 4, 5], [5.0, 3.0, 3.0])
    assert best_so_far(np.array([np.nan])) == ([], [])
    assert best_so_far(np.array([])) == ([], [])


def test_ticks_of_a_logarithmic_axis_are_written_in_full():
    """plotly's own had been 0.1, 2, 3 … 9, 1."""
    wide = log_axis([0.1, 1.2])
    assert wide["ticktext"][:4] == ["0.1", "0.2", "0.5", "1"]
    assert all(
        sum(least <= tick <= 5.01 * least for tick in log_axis([least, 5.01 * least])["tickvals"]) > 1
        for least in (1.01, 2.01, 5.01)
    )
    assert {"0.5", "1"} <= set(log_axis([0.9, 0.9])["ticktext"])
    assert log_axis([])["type"] == "log"


@pytest.mark.parametrize("values", [[1.05, 1.45], [3400.0, 8000.0]])
def test_ticks_of_a_logarithmic_axis_with_values_close_together_are_plotlys(values):
    """Those at 1, 2 and 5 had left an axis from 1.05 to 1.45 without any; plotly's stand there as on a linear one."""
    assert log_axis(values) == {"type": "log", "zeroline": False}


def test_powers_in_units_are_raised_as_in_figures():
    assert [unit({"unit": word}) for word in ("m^-4 s^2", "N/m", "1", "m^2/s")] == ["m⁻⁴ s²", "N/m", "–", "m²/s"]
    assert [unit({"unit": word}) for word in ("N^0.5", "N^10.5", "N^1/2")] == ["N^0.5", "N^10.5", "N^1/2"]  # not N⁰.5


def test_thinned_keeps_means_and_gaps():
    time, value = thinned(np.arange(6.0), np.array([1.0, 3.0, np.nan, np.nan, np.nan, 4.0]), 3)
    assert time == [0.5, 2.5, 4.5]
    assert value == [2.0, None, 4.0]
