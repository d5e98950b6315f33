"""The static site of submissions: verified first, graded by verdicts that lie elsewhere, sortable, for everybody."""

import json

import pytest
from browser_page import Page, started
from conftest import swinging_recording
from test_submissions import simulated

from clothbench import ClothbenchError, write_recording
from clothbench.plugins.discovery import catalogue
from clothbench.submissions.site import write_site
from clothbench.submissions.submission import FILE, pack
from clothbench.submissions.verdicts import find_verdict, verdict_on, write_verdict

MEASURED = [swinging_recording("sway-1"), swinging_recording("sway-2", split="held_out")]
UNPUBLISHED = {
    "metric": "node_error", "objective": "node_error", "split": "held_out", "unit": "mm", "recording": None,
    "value": 2.5, "low": 2.4, "high": 2.6, "floor": 1.6,
}  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Five submissions, one of them forged, one verified, one with a verdict on what it was before."""
    folder = tmp_path_factory.mktemp("place")
    for number, name in enumerate(("first", "second", "third", "forged", "changed")):
        mine = folder / "submissions" / name
        for recording in MEASURED:
            write_recording(simulated(recording, away=0.003 + 0.001 * number), mine / f"{recording.name}.nc")
        about = {"name": f"{name} <i>", "by": "somebody", "about": "a plate", "suite": "sway"}
        pack(mine, MEASURED, ["node_error"], catalogue(), **about)
    for name in ("second", "changed"):
        mine = folder / "submissions" / name
        more = {"seed": 7, "cells": ["ab"], "unpublished": [UNPUBLISHED], "network": "cut off"}
        write_verdict(folder / "verdicts", verdict_on(mine, name, "verified", **more), mine)
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
    names = ("changed", "first", "forged", "second", "third")
    assert pages == ["index.html", "mine.txt", *(f"submissions/{name}.html" for name in names)]


def test_grades_come_from_verdicts_on_the_very_submission(place):
    found = write_site(place / "submissions", place / "again", MEASURED, place / "verdicts", catalogue())
    grades = {one.folder.name: "refused" if one.reason else one.grade for one in found}
    assert grades == {
        "first": "recomputed", "second": "verified", "third": "recomputed", "forged": "refused", "changed": "recomputed"
    }  # fmt: skip
    without = write_site(place / "submissions", place / "again", MEASURED, None, catalogue())
    assert {one.grade for one in without} == {"recomputed"}


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
    write_verdict(tmp_path, verdict_on(mine, "first", "verified", unpublished=[UNPUBLISHED]), mine)
    write_verdict(tmp_path, verdict_on(mine, "first", "reproduced", seed=3, cells=["ab"]), mine)
    found = find_verdict(tmp_path, mine)
    assert (found.grade, found.seed, found.unpublished) == ("verified", 3, [UNPUBLISHED])
    write_verdict(tmp_path, verdict_on(mine, "first", "verified", unpublished=[UNPUBLISHED]), mine)
    assert find_verdict(tmp_path, mine).cells == ["ab"]


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
