"""Drapes as a user calibrates them: from silhouettes to the front, the pictures and the page."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest

from clothbench import Silhouettes, read_silhouettes, write_recording, write_silhouettes

PIXEL, PLATE, DISC = 2.0e-3, 0.09, 0.15


def shadow(folds, phase):
    """A picture of an outline with so many folds."""
    x, y = np.meshgrid(np.arange(180) - 89.5, 89.5 - np.arange(180))
    turn = np.arctan2(y, x)
    radius = 0.122 + 0.012 * np.cos(folds * turn + phase)
    return np.where(np.hypot(x, y) * PIXEL <= radius, 0, 255).astype(np.uint8)


@pytest.fixture
def drapes(tmp_path):
    """Eight captures of four specimens to fit, four of two held out."""
    folder = tmp_path / "drapes"
    for split, counts in (("fit", (7, 8, 7, 7, 8, 7, 7, 6)), ("held_out", (7, 7, 8, 7))):
        write_silhouettes(
            Silhouettes(
                name=f"petals/{split}", fabric="petals", split=split, sample=np.arange(len(counts)) // 2,
                image=np.stack([shadow(n, k) for k, n in enumerate(counts)]), side=np.zeros(len(counts)),
                pixel_size=PIXEL, disc_radius=DISC, plate_radius=PLATE, areal_density=0.2,
            ),
            folder / f"{split}.nc",
        )  # fmt: skip
    return folder


RUN = ("model=mass_spring", "metric=drape", "tracker=drape", "scene.spacing=0.025", "scene.starts=2", "budget=24")


@pytest.mark.slow
def test_a_front_is_searched_shown_and_kept(clothbench, drapes, tmp_path):
    assert clothbench("validate", "drapes").returncode == 0
    done = clothbench("run", *RUN, "optimizer=hybrid_ea", "recordings=drapes")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "several objectives: the fit, and the least of each on the front" in done.stdout
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    total = {r["split"]: r for r in rows if r["recording"] is None}
    assert total["fit"]["unit"] == "sd"
    assert total["fit"]["low"] <= total["fit"]["value"] <= total["fit"]["high"]
    assert 0 < total["held_out"]["floor"] < 3
    cell = tmp_path / "runs" / "cells" / rows[0]["key"]
    front, history = pd.read_parquet(cell / "front.parquet"), pd.read_parquet(cell / "history.parquet")
    assert set(front["objective"]) == {"drape_coefficient", "folds", "depth", "unevenness"}
    assert front[front["chosen"]]["value"].iloc[0] == pytest.approx(history["value"].min())
    assert [c for c in history if c.startswith("objective:")]
    assert {p.name for p in (cell / "drapes").iterdir()} == {
        "0 fitted petals fit.png", "1 held out petals held_out.png"
    }  # fmt: skip
    assert (cell / "fit.rrd").stat().st_size > 10_000
    page = (tmp_path / "runs" / "report.html").read_text()
    assert "Drapes, captured and simulated" in page
    assert ">Fronts</h2>" in page
    figures = json.loads(page.split('id="fronts">')[1].split("</script>")[0])
    assert len(figures) == 7  # parallel coordinates, and four objectives in pairs
    assert sum(line["line"]["width"] > 1 for line in figures[0]["data"]) == 1
    assert "What the tracker made of the images" in page


@pytest.mark.slow
def test_another_choice_is_another_cell(clothbench, drapes):
    for choice in ("nearest", "knee"):
        done = clothbench("run", *RUN, "optimizer=simple_ea", "recordings=drapes", f"choice={choice}", "rerun=false")
        assert done.returncode == 0, done.stdout + done.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert len({r["key"] for r in rows}) == 2


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (("tracker=markers",), "take tracker=drape"),
        (("metric=node_error",), "take metric=drape"),
        (("choice=best",), "expected one of nearest, knee"),
        (("scene.start=measured",), "says nothing to recordings of kind 'silhouette'"),
        (("+options.drape.center=[89,89]",), "no option 'center'"),
        (("+options.drape.starts=0",), "starts is 0"),
        (("+options.drape.centre=left",), "centre is 'left'"),
    ],
)
def test_what_does_not_fit_together_is_one_line(clothbench, drapes, settings, says):
    done = clothbench("run", *RUN, "optimizer=cma_es", "recordings=drapes", *settings)
    assert done.returncode == 2, done.stdout + done.stderr
    assert says in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_metric_and_tracker_of_one_name_get_their_own_options(clothbench, drapes):
    own = ("+options.drape.starts=2", "+options.drape.quantities=[folds,depth]", "+options.drape.centre=[89.5,89.5]")
    done = clothbench("run", *RUN, "optimizer=simple_ea", "recordings=drapes", *own, "rerun=false")
    assert done.returncode == 0, done.stdout + done.stderr
    (front,) = (pd.read_parquet(path) for path in drapes.parent.glob("**/front.parquet"))
    assert set(front["objective"]) == {"folds", "depth"}


def test_the_metric_refuses_sheets(clothbench, recording, tmp_path):
    write_recording(recording, tmp_path / "sheet.nc")
    sheet = clothbench("run", "model=mass_spring", "metric=drape", "optimizer=cma_es", "recording=sheet.nc")
    assert sheet.returncode == 2
    assert "points of a sheet, which the metric 'drape' does not compare" in sheet.stderr


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (("model=mass_spring",), "take tracker=drape"),
        (("model=linear_stretch", "tracker=drape"), "expected one that can be cut to a disc and takes effects"),
        (("model=mass_spring", "tracker=drape", "candidates=clock_offset"), "a drape tells none; take it out"),
        (("model=mass_spring", "tracker=drape", "candidates=steady_wind"), "a drape tells none; take it out"),
        (("model=mass_spring", "tracker=drape", "scene.start=measured"), "begin from several first shapes"),
    ],
)
def test_improve_refuses_what_means_nothing_to_drapes(clothbench, drapes, settings, says):
    done = clothbench("improve", "recordings=drapes", *settings)
    assert done.returncode == 2, done.stdout + done.stderr
    assert says in done.stderr
    assert "Traceback" not in done.stderr


def test_improve_refuses_drapes_of_two_fabrics_and_films_among_them(clothbench, drapes, recording, tmp_path):
    settings = ("model=mass_spring", "tracker=drape", "recordings=drapes")
    other = dataclasses.replace(read_silhouettes(drapes / "fit.nc"), name="other/fit", fabric="other", path="")
    write_silhouettes(other, drapes / "other.nc")
    mixed = clothbench("improve", *settings)
    assert mixed.returncode == 2
    assert "found other, petals among 3 recordings, expected one fabric" in mixed.stderr
    write_recording(recording, drapes / "sheet.nc")
    among = clothbench("improve", *settings)
    assert among.returncode == 2
    assert "found kind 'nodes' among others, expected one kind in a folder" in among.stderr


@pytest.mark.slow
def test_improve_asks_what_drapes_hide(clothbench, drapes, tmp_path):
    done = clothbench(
        "improve", "recordings=drapes", "model=mass_spring", "tracker=drape", "candidates=rest_curvature",
        "resolution=11", "out=found",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    verdict = json.loads((tmp_path / "found" / "verdict.json").read_text())
    assert (verdict["kind"], verdict["error"]["unit"]) == ("silhouette", "sd")
    assert verdict["error_mm"]["fit"]["before"] is None
    assert len(verdict["error"]["held_out"]["per_recording"]) == 2  # specimens
    assert set(verdict["parameters"]) == {"k2"}  # of what a drape coefficient tells
    page = (tmp_path / "found" / "index.html").read_text()
    assert "Drapes, side by side" in page
    assert "clothbench view" not in page  # there is no Rerun file of a drape
    table = pd.read_parquet(tmp_path / "found" / "tables" / "drapes.parquet")
    assert set(table["quantity"]) == {"drape_coefficient", "elongation"}
