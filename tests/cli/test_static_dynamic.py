"""The suite `static_dynamic` in small, as a user runs it: trial by trial, with its tables at the end."""

import json

import pytest


@pytest.mark.slow
def test_the_protocol_end_to_end(clothbench, tmp_path):
    """Linen's two static trials: it is the stiffest fabric, so its simulations are the quickest."""
    small = ("suite.select=[linen/static-*]", "budget=24", "analysis.variability.cases=['*/static-2']")
    out = clothbench("run", "+suite=static_dynamic", *small)
    assert out.returncode == 0, out.stderr
    for word in ("trial by trial", "E1 + E2", "✓", "truth", "variability"):
        assert word in out.stdout
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert {r["case"] for r in rows} == {"linen/static-1", "linen/static-2"}
    assert {r["status"] for r in rows} == {"ok"}
    assert {(r["recording"], r["split"]) for r in rows if r["case"] == "linen/static-1" and r["recording"]} == {
        ("linen/static-1", "fit"), ("linen/static-2", "held_out"),
    }  # fmt: skip
    fold = {(r["case"], r["split"]): r["value"] for r in rows if r["metric"] == "fold" and not r["recording"]}
    assert fold["linen/static-2", "fit"] < 20
    page = (tmp_path / "runs" / "report.html").read_text()
    assert "Trial by trial" in page
    assert not list((tmp_path / "runs").glob("journal/*/*"))


def test_an_unknown_budget_is_one_line(clothbench):
    out = clothbench("run", "+suite=static_dynamic", "budget=vast")
    assert out.returncode == 2
    assert out.stderr.strip() == (
        "clothbench: setting 'budget' is 'vast', expected a whole number, at least 1, or one of the suite's: paper"
    )


def test_a_recording_without_video_cannot_be_tracked_by_stripes(clothbench, recordings_folder):
    out = clothbench(
        "run", f"recordings={recordings_folder}", "model=mass_spring", "optimizer=ga", "metric=fold", "tracker=stripes"
    )
    assert out.returncode == 2
    assert "found no video, which the tracker 'stripes' needs; take tracker=markers" in out.stderr
    assert out.stderr.count("\n") == 1
