"""The static site of submissions: verified first, graded by verdicts that lie elsewhere, sortable, for everybody."""

import dataclasses
import json
import re
import shutil

import pytest
from browser_page import Page, started
from conftest import swinging_recording
from test_submissions import simulated, with_fits

from clothbench import ClothbenchError, write_recording
from clothbench.plugins.discovery import catalogue
from clothbench.submissions.kept import rows_of
from clothbench.submissions.site import Standing, means, write_site
from clothbench.submissions.submission import FILE, pack
from clothbench.submissions.verdicts import find_verdict, verdict_on, write_verdict
from clothbench.submissions.verification import verify

MEASURED = [swinging_recording("sway-1"), swinging_recording("sway-2", split="held_out")]
UNPUBLISHED = {
    "metric": "node_error", "objective": "node_error", "split": "held_out", "unit": "mm", "recording": None,
    "value": 2.5, "low": 2.4, "high": 2.6, "floor": 1.6,
}  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Six submissions: one forged, one verified, one that failed later, one with a verdict on what it was before."""
    folder = tmp_path_factory.mktemp("place")
    for number, name in enumerate(("first", "second", "third", "forged", "changed", "failed")):
        mine = folder / "submissions" / name
        for recording in MEASURED:
            write_recording(simulated(recording, away=0.003 + 0.001 * number), mine / f"{recording.name}.nc")
        about = {"name": f"{name} <i>", "by": "somebody", "about": "a plate", "suite": "sway"}
        pack(mine, MEASURED, ["node_error"], catalogue(), **about)
    for name in ("second", "changed"):
        mine = folder / "submissions" / name
        more = {"seed": 7, "cells": ["ab"], "unpublished": [UNPUBLISHED], "network": "cut off"}
        write_verdict(folder / "verdicts", verdict_on(mine, name, **more), mine)
    mine = folder / "submissions" / "failed"
    write_verdict(folder / "verdicts", verdict_on(mine, "failed", seed=7, cells=["ab"], network="open"), mine)
    write_verdict(folder / "verdicts", verdict_on(mine, "failed", seed=8, faults={"ab": ["cell ab: is another"]}), mine)
    forge(folder / "submissions" / "forged", lambda s: s["entries"][0]["scores"].update(node_error=1.0))
    forge(folder / "submissions" / "changed", lambda s: s.update(about="better now"))
    return folder


def forge(folder, change):
    stated = json.loads((folder / FILE).read_text())
    change(stated)
    (folder / FILE).write_text(json.dumps(stated))


@pytest.fixture(scope="module")
def site(place):
    (place / "site" / "submissions").mkdir(parents=True)
    (place / "site" / "submissions" / "withdrawn.html").write_text("was here once")
    (place / "site" / "mine.txt").write_text("somebody else's")
    write_site(place / "submissions", place / "site", MEASURED, place / "verdicts", catalogue())
    return place / "site"


def test_every_submission_has_a_page_and_what_was_withdrawn_has_none(site):
    pages = sorted(path.relative_to(site).as_posix() for path in site.rglob("*.*"))
    names = ("changed", "failed", "first", "forged", "second", "third")
    assert pages == ["index.html", "mine.txt", *(f"submissions/{name}.html" for name in names)]


def test_grades_come_from_verdicts_on_the_very_submission(place):
    found = write_site(place / "submissions", place / "again", MEASURED, place / "verdicts", catalogue())
    grades = {one.folder.name: one.grade for one in found}
    assert grades == {
        "first": "recomputed", "second": "verified", "third": "recomputed", "forged": "refused",
        "changed": "recomputed", "failed": "refused",
    }  # fmt: skip
    without = write_site(place / "submissions", place / "again", MEASURED, None, catalogue())
    assert {one.grade for one in without} == {"recomputed", "refused"}


def test_a_copy_is_refused_whatever_it_is_called(place, tmp_path):
    """The one with a verdict stands, though it comes second by name."""
    shutil.copytree(place / "submissions" / "second", tmp_path / "all" / "second")
    shutil.copytree(place / "submissions" / "second", tmp_path / "all" / "again")
    forge(tmp_path / "all" / "again", lambda s: s.update(name="mine", by="somebody else"))
    found = write_site(tmp_path / "all", tmp_path / "site", MEASURED, place / "verdicts", catalogue())
    assert {one.folder.name: (one.grade, one.reason) for one in found} == {
        "again": ("refused", "holds the same positions as second"), "second": ("verified", ""),
    }  # fmt: skip
    assert "holds the same positions as second" in (tmp_path / "site" / "index.html").read_text()


def test_each_row_has_the_grade_that_it_was_shown_to_have(place, site):
    found = write_site(place / "submissions", place / "again", MEASURED, place / "verdicts", catalogue())
    (second,) = (one for one in found if one.folder.name == "second")
    assert {row["split"]: row["grade"] for row in means(second)} == {
        "fit": "recomputed", "held_out": "recomputed", "unpublished": "verified"
    }  # fmt: skip
    unpublished, held_out = (site / "index.html").read_text().split("<h2 id=")[2:4]
    assert unpublished.count(">verified<") == 1
    assert ">verified<" not in held_out
    page = (site / "submissions" / "second.html").read_text()
    scores = page.partition('<h2 id="every-score"')[2].partition("<h2")[0]
    assert scores.count(">recomputed<") == 2


def test_a_mean_is_reproduced_if_all_its_fits_are(place):
    mine = place / "submissions" / "first"
    found = verify(mine, MEASURED, catalogue())
    fits = [dataclasses.replace(one, cell=fit) for one in found.found for fit in ("ab", "cd")]
    found = dataclasses.replace(found, found=tuple(fits))
    some = Standing(mine, found, verdict_on(mine, "first", seed=1, cells=["ab"]))
    assert {(row["grade"], row["said"]) for row in means(some)} == {("recomputed", "1 of 2 fits reproduced")}
    all_of_them = Standing(mine, found, verdict_on(mine, "first", seed=1, cells=["ab", "cd"]))
    assert {(row["grade"], row["said"]) for row in means(all_of_them)} == {("reproduced", "")}


def test_places_go_by_a_metric_that_all_have_whatever_a_submission_states_first(tmp_path):
    """One lacks what the first by name states first; without a shared one, who lacks it has no place."""

    def handed_in(name, away, metrics):
        for recording in MEASURED:
            write_recording(simulated(recording, away), tmp_path / "all" / name / f"{recording.name}.nc")
        about = {"name": name, "by": "", "about": "", "suite": "sway"}
        pack(tmp_path / "all" / name, MEASURED, metrics, catalogue(), **about)

    def places():
        write_site(tmp_path / "all", tmp_path / "site", MEASURED, None, catalogue())
        board = (tmp_path / "site" / "index.html").read_text().split("<tbody>")[1].split("</tbody>")[0]
        cells = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in board.split("</tr>")[:-1]]
        return [(cell[0], re.search(r">([^<]*)</a>", cell[1])[1]) for cell in cells]

    handed_in("a", 0.009, ["relative_error", "node_error"])
    handed_in("b", 0.003, ["node_error"])
    handed_in("c", 0.006, ["relative_error", "node_error"])
    assert places() == [("1", "b"), ("2", "c"), ("3", "a")]
    shutil.rmtree(tmp_path / "all" / "c")
    handed_in("d", 0.006, ["relative_error"])
    assert places() == [("1", "b"), ("2", "a"), ("", "d")]


def test_means_over_other_recordings_are_not_ranked_together(tmp_path):
    """A question that calls the easy recording held out, and the other one fitted, has a table of its own."""
    for name, away in (("b", 0.003), ("a", 0.009)):
        for recording in MEASURED:
            write_recording(simulated(recording, away), tmp_path / "all" / name / f"{recording.name}.nc")
        about = {"name": name, "by": "", "about": "", "suite": "sway"}
        pack(tmp_path / "all" / name, MEASURED, ["node_error"], catalogue(), **about)
    with_fits(tmp_path / "all" / "b", "ab" * 8, split={"sway-1": "held_out", "sway-2": "fit"})
    found = write_site(tmp_path / "all", tmp_path / "site", MEASURED, None, catalogue())
    assert [one.reason for one in found] == ["", ""]
    page = (tmp_path / "site" / "index.html").read_text()
    boards = [part.partition("</table>")[0] for part in page.split("<h2 id=")[1:]]
    held_out = [board for board in boards if "sway · held out · 1 recording</h2>" in board]
    assert ["Over sway-2; not ranked" in held_out[0], "Over sway-1; not ranked" in held_out[1]] == [True, True]
    assert [board.partition("<tbody>")[2].count("<tr>") for board in held_out] == [1, 1]
    assert "holds out 1 that are to fit by their files" in held_out[1]
    assert "fitted to 1 that are held out by their files" in page


def test_each_recording_counts_once_in_a_mean_however_many_fits_simulated_it(place):
    found = verify(place / "submissions" / "first", MEASURED, catalogue()).found
    easy, hard = (
        dataclasses.replace(one, scores={"node_error": value}, fitted=False)
        for one, value in zip(found, (1.0, 9.0), strict=True)
    )
    many = [dataclasses.replace(easy, cell=f"{k:016x}") for k in range(50)]
    assert next(row for row in rows_of([*many, hard]) if row["recording"] is None)["value"] == 5.0


def test_one_that_failed_later_is_shown_as_refused(site):
    page = (site / "submissions" / "failed.html").read_text()
    assert "cell ab: is another" in page
    assert ">reproduced<" not in page.partition("What the grades say")[0]


def test_a_forged_one_is_shown_as_refused_with_the_reason_and_without_a_score(site, place):
    text = (site / "submissions" / "forged.html").read_text()
    assert "sway-1.nc: node_error is" in text
    assert "claimed were 1 mm" in text
    assert str(place) not in text + (site / "index.html").read_text()
    assert "Every score" not in text


def test_no_submission_and_a_damaged_verdict_are_one_line(place, tmp_path):
    with pytest.raises(ClothbenchError, match="found no submissions"):
        write_site(tmp_path, tmp_path / "site", MEASURED, None, catalogue())
    for path in (place / "verdicts").glob("*.json"):
        (tmp_path / path.name).write_text("{}")
    with pytest.raises(ClothbenchError, match="is no verdict"):
        write_site(place / "submissions", tmp_path / "site", MEASURED, tmp_path, catalogue())


def test_a_later_verdict_adds_to_an_earlier_one(place, tmp_path):
    mine = place / "submissions" / "first"
    write_verdict(tmp_path, verdict_on(mine, "first", unpublished=[UNPUBLISHED]), mine)
    assert find_verdict(tmp_path, mine).grade == "recomputed"  # unpublished recordings say nothing of its own scores
    write_verdict(tmp_path, verdict_on(mine, "first", seed=3, cells=["ab"]), mine)
    found = find_verdict(tmp_path, mine)
    assert (found.grade, found.seed, found.unpublished) == ("verified", 3, [UNPUBLISHED])
    write_verdict(tmp_path, verdict_on(mine, "first", seed=4, cells=["cd"]), mine)
    assert find_verdict(tmp_path, mine).cells == ["ab", "cd"]


def test_a_fault_stays_until_the_same_fit_is_run_again_without_one(place, tmp_path):
    mine = place / "submissions" / "first"

    def after(**found):
        write_verdict(tmp_path, verdict_on(mine, "first", **found), mine)
        return find_verdict(tmp_path, mine)

    assert after(seed=1, cells=["ab", "cd"], unpublished=[UNPUBLISHED]).grade == "verified"
    failed = after(seed=2, cells=["cd"], faults={"ab": ["cell ab: took longer"], "wheels": ["no network"]})
    assert (failed.grade, failed.cells) == ("refused", ["cd"])
    assert after(seed=3, cells=["cd"], network="open").faults == {"ab": ["cell ab: took longer"]}
    again = after(seed=2, cells=["ab"], network="open")
    assert (again.grade, again.cells) == ("verified", ["ab", "cd"])


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    yield from started(tmp_path_factory.mktemp("chromium"))


def test_it_works_from_a_disk_and_shuts_nobody_out(chromium, site):
    page = Page(chromium).open(site / "index.html")
    names = 'return [...document.querySelectorAll("h2")].map((h) => h.textContent)'
    assert page.run(names)[1:4] == ["sway · unpublished", "sway · held out", "sway · fit"]
    column = """const table = document.querySelectorAll("table")[1];
        table.tHead.rows[0].cells[1].querySelector("button").click();
        return [...table.tBodies[0].rows].map((row) => row.cells[1].querySelector("a").textContent);"""
    assert page.run(column) == ["changed <i>", "first <i>", "second <i>", "third <i>"]
    assert page.barriers() == []
    page.run('document.querySelector("a[href*=second]").click()')
    page.wait('document.querySelector("h1").textContent.includes("second <i>")')
    assert page.barriers() == []
    page.run('document.querySelector("a[href*=index]").click()')
    page.wait('document.querySelector("h1").textContent === "Leaderboard of submissions"')
    assert page.faults() == []
