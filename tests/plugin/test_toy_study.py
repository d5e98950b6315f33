"""A study joins by one folder and one registration: it is planned, run, kept, and shows on terminal and page."""

from __future__ import annotations

import html
import json
import shutil
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture
def toss(tmp_path, clothbench):
    """The command where the toy study's folder is installed, as a wheel would do it."""
    site = tmp_path / "site"
    shutil.copytree(HERE / "clothbench_toss", site / "clothbench_toss")
    about = site / "clothbench_toss-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: clothbench-toss\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[clothbench]\ntoss = clothbench_toss\n")
    return lambda *words: clothbench(*words, PYTHONPATH=str(site))


def test_a_toy_study_joins_by_one_folder_and_one_registration(toss, tmp_path):
    words = ("run", "study=toss", "model=[mass_spring,mujoco]", "+suite.coins=40", "seed=3")
    out = toss(*words)
    assert out.returncode == 0, out.stderr
    assert "mass_spring: 52% of the coins fell heads up" in out.stdout
    assert "[2/2] ok: 40 coins for" in out.stderr
    rows = json.loads(toss("leaderboard", "--json").stdout)
    assert [(r["suite"], r["model"], r["metric"]) for r in rows] == [
        ("toss", "mass_spring", "heads"), ("toss", "mujoco", "heads"),
    ]  # fmt: skip
    page = (tmp_path / "runs" / "report.html").read_text()
    for word in ("Cloth models against chance", '<h2 id="coins-2">Coins</h2>', 'id="coins">', "plotly.js v"):
        assert word in page
    assert "kept: 40 coins for mass_spring" in toss(*words).stderr


def test_its_settings_are_checked_like_any_other(toss):
    out = toss("run", "study=toss", "model=mass_spring", "+suite.coins=none")
    assert (out.returncode, "setting 'suite.coins' is 'none'" in out.stderr) == (2, True)
    out = toss("run", "study=toss", "model=mass_spring", "+suite.tests=all")
    assert (out.returncode, "setting of 'suite' 'tests' is not known" in out.stderr) == (2, True)
    out = toss("run", "study=tos", "model=mass_spring")
    assert (out.returncode, "no study named 'tos'; did you mean 'toss'?" in out.stderr) == (2, True)


def test_it_stands_beside_other_studies_in_one_folder(toss, tmp_path):
    quick = ("+suite=physical_validation", "model=[mass_spring]", "suite.meshes=[5]", "suite.tests=[free_fall]")
    assert toss("run", *quick).returncode == 0
    assert toss("run", "study=toss", "model=mass_spring").returncode == 0
    page = (tmp_path / "runs" / "report.html").read_text()
    assert "Cloth models against mechanics and chance" in page
    assert page.count("plotly.js v") == 1
    said = toss("leaderboard").stdout
    assert "models against references" in said
    assert "of the coins fell heads up" in said


def test_its_rows_are_refused_in_one_line_where_it_is_broken(toss, tmp_path):
    assert toss("run", "study=toss", "model=mass_spring").returncode == 0
    (tmp_path / "site" / "clothbench_toss" / "study.py").write_text("raise RuntimeError('no coins')\n")
    shown = toss("leaderboard")
    assert shown.returncode == 2
    assert shown.stderr == "clothbench: study 'toss' (clothbench-toss) is broken: RuntimeError: no coins\n"


@pytest.mark.slow
def test_its_rows_are_left_out_where_it_is_not_there_and_others_are(toss, tmp_path):
    assert toss("run", "study=toss", "model=mass_spring").returncode == 0
    (tmp_path / "site" / "clothbench_toss" / "study.py").write_text("raise RuntimeError('no coins')\n")
    quick = ("+suite=physical_validation", "model=[mass_spring]", "suite.meshes=[5]", "suite.tests=[free_fall]")
    told = "cells left out, since what they are of cannot be shown: 1; study 'toss' (clothbench-toss) is broken"
    assert toss("run", *quick).returncode == 0
    assert told in html.unescape((tmp_path / "runs" / "report.html").read_text())
    shown = toss("leaderboard")
    assert (shown.returncode, told in shown.stderr) == (0, True)
    assert "models against references" in shown.stdout
