"""The pages: what they link to and show is there."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from conftest import ROOT

PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
ELSEWHERE = ("http://", "https://", "mailto:")
SOURCE = re.compile(r"`((?:clothbench|tools|tests|results|suites|examples|docs|plugins)/[\w./-]+)`")


def prose(page: Path) -> str:
    return FENCE.sub("", page.read_text())


def anchors(page: Path) -> set[str]:
    """The fragments by which the page's headings are linked to, as GitHub makes them."""
    heads = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_images_resolve(page):
    for link in LINK.findall(prose(page)):
        if link.startswith(ELSEWHERE):
            continue
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        assert target.exists(), f"{page.name} links to {link}"
        assert target.resolve().is_relative_to(ROOT), f"{page.name} links to {link}, outside of the project"
        assert not anchor or anchor in anchors(target), f"{page.name} links to {link}, no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_are_named_are_there(page):
    for name in SOURCE.findall(prose(page)):
        assert (ROOT / name).exists(), f"{page.name} names {name}"


def test_every_page_is_linked_from_the_first():
    linked = {link.partition("#")[0] for link in LINK.findall(prose(ROOT / "README.md"))}
    assert {f"docs/{page.name}" for page in PAGES[2:]} <= linked


def test_every_tool_answers_help_before_it_begins():
    begin = {path.name: path.read_text() for path in (ROOT / "tools").glob("*.py")}
    silent = {name for name, text in begin.items() if "__main__" in text and "parse_args()" not in text}
    assert silent == {"fuzz_child.py"}  # which the fuzzer starts


@pytest.mark.slow
def test_the_suite_of_ones_own_recordings_runs_as_the_page_says(clothbench, recordings_folder, tmp_path):
    text = (ROOT / "docs" / "recordings.md").read_text()
    (suite,) = re.findall(r"^```yaml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    (command,) = re.findall(r"^clothbench (run --config-dir .*)$", text, re.MULTILINE)
    (tmp_path / "my-suites" / "suite").mkdir(parents=True)
    (tmp_path / "my-suites" / "suite" / "swings.yaml").write_text(suite)
    quick = ("budget=3", "jobs=1", "rerun=false", "model=mass_spring", "options.mass_spring.resolution=5")
    done = clothbench(*command.split(), *quick)
    assert done.returncode == 0, done.stderr
    (row, *_) = json.loads(clothbench("leaderboard", "--json").stdout)
    assert (row["suite"], row["model"], row["status"]) == ("swings", "mass_spring", "ok")
