"""The suite `shake` in small, as a user runs it: depth frames in, parameters, pictures and the paper's figures out."""

from __future__ import annotations

import json

import pytest

from clothbench.cli.run import composed
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import catalogue

SMALL = ("suite.select=[damped/shake-2,damped/shake-4]", "optimizer=[nelder_mead]", "budget=6")


@pytest.mark.slow
def test_the_protocol_end_to_end(clothbench, tmp_path):
    out = clothbench("run", "+suite=shake_alpha", *SMALL)
    assert out.returncode == 0, out.stderr
    assert "1.5" in out.stdout  # the truth, beside the amount
    rows = {(r["metric"], r["split"]): r for r in json.loads(clothbench("leaderboard", "--json").stdout)}
    assert rows["relative_error", "held_out"]["value"] < 8
    assert rows["relative_error_from_camera", "held_out"]["value"] < 0.2 * rows["relative_error", "held_out"]["value"]
    page = (tmp_path / "runs" / "report.html").read_text()
    for word in ("Beside the paper", "paper: largest", "What the tracker made of the images", "data:image/png;base64,"):
        assert word in page
    (cell,) = (tmp_path / "runs" / "cells").iterdir()
    names = sorted(p.name for p in (cell / "tracker").glob("*.png"))
    assert names == ["0 colour.png", "1 depth.png", "2 after plane.png", "3 after outliers.png", "4 after colour.png",
                     "5 mesh.png"]  # fmt: skip
    tracked = list((tmp_path / "runs" / "tracked").glob("*.nc"))
    assert len(tracked) == 2
    stamps = [p.stat().st_mtime_ns for p in tracked]
    again = clothbench("run", "+suite=shake_alpha", *SMALL[:2], "budget=5")
    assert again.returncode == 0, again.stderr
    assert [p.stat().st_mtime_ns for p in tracked] == stamps  # images are tracked once


@pytest.mark.slow
def test_improve_asks_about_each_fabric_by_itself(clothbench, tmp_path):
    out = clothbench(
        "run", "+suite=shake_improve", "recordings=builtin:shake_nodes", "tracker=markers", "suite.candidates=lift",
        "suite.resolution=5", "timeout=1",
    )  # fmt: skip
    assert out.returncode in (0, 1), out.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert {r["case"] for r in rows} == {"damped"}


@pytest.mark.parametrize(
    ("settings", "found"),
    [
        (("+suite=shake_alpha", "scene.start=thrown"), "'scene.start' is 'thrown', expected one of rest, measured"),
        (("+suite=shake_alpha", "+suite.published={relative_error: {paper: much}}"), "published.relative_error.paper"),
        (("+suite=shake_alpha", "+options.depth_mesh.method=conformal"), "expected one of isometric, harmonic"),
        (("+suite=shake_alpha", "tracker=markers"), "does not read; take tracker=cloud_template or depth_mesh"),
        (("+suite=shake_improve", "tracker=markers"), "does not read; take tracker=cloud_template or depth_mesh"),
        (("+suite=shake_alpha", "recordings=builtin:shake_nodes"), "found kind 'nodes', which the tracker"),
        (("+suite=shake_improve", "suite.select=[silk/*]"), "matches none of 20 recordings"),
        (("+suite=shake_improve", "suite.case=weather"), "setting 'suite.case' is 'weather', expected fabric"),
        (("+suite=shake_improve", "model=[kirchhoff_love]", "scene.start=measured"), "model 'kirchhoff_love'"),
    ],
)  # fmt: skip
def test_wrong_settings_are_one_line(clothbench, settings, found):
    out = clothbench("run", *settings)
    assert out.returncode == 2
    assert found in out.stderr
    assert out.stderr.count("\n") == 1


def test_the_sheet_that_shears_is_planned_as_the_docs_have_it():
    words = ["+suite=shake", "suite.select='damped/*'", "model=[mass_spring,baraff_witkin]", "effects=[linear_drag]",
             "bounds.linear_drag.coefficient=[0,5]", "optimizer=[nelder_mead]"]  # fmt: skip
    assert [cell.model for cell in plan(composed(words), catalogue())] == ["mass_spring", "baraff_witkin"]


def test_a_bound_that_nothing_has_is_refused_before_anything_is_tracked(clothbench, tmp_path):
    out = clothbench("run", "+suite=shake_improve", "bounds.theta=[0,1]", "suite.select=[damped/*]")
    assert out.returncode == 2
    assert "setting 'bounds': no parameter 'theta'; there are: " in out.stderr
    assert not (tmp_path / "runs").exists()


def test_a_fit_is_kept_where_a_further_metric_cannot_be_computed(clothbench):
    """Recordings of nodes know no camera; the whole search had been thrown away for the suite's other metric."""
    out = clothbench(
        "run", "+suite=shake_alpha", "recordings=builtin:shake_nodes", "tracker=markers", "optimizer=[nelder_mead]",
        "suite.select=[damped/*]", "budget=2",
    )  # fmt: skip
    assert out.returncode == 0, out.stderr
    assert "the recording does not say where it stood" in out.stdout
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    known = {(row["metric"], row["status"], row["value"] is not None) for row in rows}
    assert known == {
        ("relative_error", "ok", True), ("relative_error_from_camera", "skipped", False), ("node_error", "ok", True)
    }  # fmt: skip
    assert all(row["floor"] is row["low"] is None for row in rows if row["status"] == "skipped")


def test_a_model_that_starts_from_rest_only_is_skipped_with_the_reason(clothbench):
    out = clothbench(
        "run", "+suite=shake_alpha", "recordings=builtin:shake_nodes", "tracker=markers", "report=[node_error]",
        "model=[kirchhoff_love]", "optimizer=[nelder_mead]", "budget=2",
    )  # fmt: skip
    assert "skipped" in out.stdout
    assert "kirchhoff_love" in out.stdout
